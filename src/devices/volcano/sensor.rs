//! The two temperature sensors and when they are looked at (VOL-40).

use super::map::*;
use super::units::Unit;
use crate::image::Image;
use crate::world::World;

/// The measurement: both sensors hang in the same room, so what is kept is the room's temperature when it was last
/// looked at, and whether the sensor in use is sound is seen at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// The last temperature measured, in °C.
    sample: Option<f64>,
    /// When the next one is due, in running microseconds; [`Sensor::NEVER`] while measuring is off.
    pub next_us: i64,
}

impl Sensor {
    /// A moment that does not come.
    pub const NEVER: i64 = i64::MAX;

    /// A sensor that has measured nothing yet.
    pub fn new() -> Self {
        Self { sample: None, next_us: Self::NEVER }
    }

    /// Looks at the room.
    pub fn measure(&mut self, world: &World) {
        if is_sound(world) {
            self.sample = Some(world.number(ROOM_TEMPERATURE));
        }
    }

    /// The next measurement comes one period after `from_us`, or never.
    pub fn schedule(&mut self, from_us: i64, regs: &Image) {
        self.next_us = match regs.get(NTC_PERIOD) {
            0 => Self::NEVER,
            tenths => from_us + i64::from(tenths) * 100_000,
        };
    }

    /// The temperature with its correction, as the registers count; `None` while the sensor in use is broken.
    pub fn reading(&self, world: &World, regs: &Image) -> Option<i16> {
        let celsius = self.sample.filter(|_| is_sound(world))?;
        let hundredths = Unit::of(regs).hundredths(celsius) + i32::from(regs.get(NTC_1_CORRECT));
        Some(hundredths.clamp(i32::from(i16::MIN) + 1, i32::from(i16::MAX)) as i16)
    }
}

/// Puts the state of each sensor into the registers.
pub fn show(world: &World, regs: &mut Image) {
    regs.set(NTC_1_ACTIVE, !world.flag(NTC_1_FAULT));
    regs.set(NTC_2_ACTIVE, world.flag(NTC_2_CONNECTED) && !world.flag(NTC_2_FAULT));
}

/// Whether the sensor in use is sound: an external one that is connected is the one in use.
fn is_sound(world: &World) -> bool {
    if world.flag(NTC_2_CONNECTED) { !world.flag(NTC_2_FAULT) } else { !world.flag(NTC_1_FAULT) }
}
