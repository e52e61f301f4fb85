//! What the controller does about a temperature: two-state control with hysteresis (VOL-41), protection (VOL-45) and
//! the fan (VOL-43). Knows temperatures as the registers count them, no time and no room.

use super::map::*;
use super::rules::is_available;
use super::schedule::is_working;
use super::units::Unit;
use crate::image::Image;

/// What the controller's terminals carry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Valve H1 is open.
    pub heating: bool,
    /// Valve H2 is open.
    pub cooling: bool,
    /// The fan's voltage, in hundredths of a volt.
    pub fan: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Cooling,
    Heating,
}

/// The memory of the two-state control: what it was doing decides inside the hysteresis. Judging twice without a change
/// in between gives the same, so it does not matter how often that is done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Thermostat {
    demand: Option<Mode>,
    is_protecting: bool,
}

/// The fan's highest voltage, 100 %, in hundredths of a volt.
const FULL_FAN: i32 = 1000;

/// The least that a fan runs with where the speed is not the user's alone, 15 %.
const LEAST_FAN: i32 = 150;

impl Thermostat {
    /// What to do at a temperature; `None` is a broken sensor, which stops everything (VOL-48).
    pub fn judge(&mut self, reading: Option<i16>, program_state: u16, regs: &Image) -> Outputs {
        let Some(reading) = reading.map(i32::from) else {
            *self = Self::default();
            return Outputs::default();
        };
        self.protect(reading, regs);
        self.control(reading, program_state, regs);
        let wanted = self.demand.map_or(0, |mode| fan_of_control(mode, reading, regs));
        let protection = if self.is_protecting { fan_of_protection(regs) } else { 0 };
        Outputs {
            heating: self.is_protecting || self.demand == Some(Mode::Heating),
            cooling: self.demand == Some(Mode::Cooling),
            fan: wanted.max(protection),
        }
    }

    fn protect(&mut self, reading: i32, regs: &Image) {
        let eco = i32::from(regs.get(ZONE_TEMPERATURE_ECO));
        let end = eco + Unit::of(regs).degrees().protection_band;
        let was_protecting = self.is_protecting;
        self.is_protecting = regs.get(ZONE_ECO_FROST_MODE) != 0 && (reading < eco || was_protecting && reading < end);
    }

    fn control(&mut self, reading: i32, program_state: u16, regs: &Image) {
        let mode = if regs.get(ZONE_MODE) == 0 { Mode::Cooling } else { Mode::Heating };
        let is_blocked = mode == Mode::Cooling && self.is_protecting;
        if !regs.get(POWER_ON_OFF) || !is_available(regs) || !is_working(program_state) || is_blocked {
            self.demand = None;
            return;
        }
        let target = i32::from(regs.get(ZONE_TEMPERATURE_TARGET));
        let delta = i32::from(regs.get(ZONE_TEMPERATURE_DELTA));
        let wanting = wanting(mode, reading, target);
        let is_on = wanting >= delta || wanting > 0 && self.demand == Some(mode);
        self.demand = is_on.then_some(mode);
    }
}

/// How far the temperature is from the target on the side where the mode has work to do; not positive on the other.
fn wanting(mode: Mode, reading: i32, target: i32) -> i32 {
    match mode {
        Mode::Cooling => reading - target,
        Mode::Heating => target - reading,
    }
}

fn fan_of_control(mode: Mode, reading: i32, regs: &Image) -> u16 {
    if regs.get(FAN_REGULATION_MODE) == 0 {
        return with_additional(i32::from(regs.get(ZONE_FAN_SPEED)) * 10, regs);
    }
    let distance = wanting(mode, reading, i32::from(regs.get(ZONE_TEMPERATURE_TARGET)));
    let full = Unit::of(regs).degrees().full_fan;
    let nearest = (distance * FULL_FAN + full / 2) / full;
    with_additional(nearest.clamp(LEAST_FAN, FULL_FAN), regs)
}

fn fan_of_protection(regs: &Image) -> u16 {
    match regs.get(ZONE_ECO_FROST_MODE) {
        2 => with_additional((i32::from(regs.get(ZONE_FAN_SPEED)) * 10).max(LEAST_FAN), regs),
        _ => 0,
    }
}

fn with_additional(fan: i32, regs: &Image) -> u16 {
    (fan + i32::from(regs.get(FAN_ADDITIONAL_VOLT))).clamp(0, FULL_FAN) as u16
}
