//! The charger at work: battery, power stage, heat and relays in steps of a fixed length (TRC-15). Knows the registers
//! that it obeys and shows, and no bus.

use super::battery::Battery;
use super::heat::Heat;
use super::map::*;
use super::rectifier::{Flow, Rectifier};
use super::relays::{Limits, Watch};
use super::site::Site;
use crate::image::Image;
use crate::map::Point;
use crate::time::SECOND_US;

/// The charger at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Where it stands.
    pub site: Site,
    /// What it obeys.
    pub settings: Settings,
    /// Its battery, wired or not.
    pub battery: Battery,
    /// Temperature and fan.
    pub heat: Heat,
    /// What flows now, and goes on flowing until the next step or the next change.
    flow: Flow,
    /// The relays with a memory.
    watch: Watch,
    /// The contactor has opened on an empty battery and waits for the mains (TRC-11).
    is_cut_off: bool,
}

/// What the holding registers tell it to keep to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    rectifier: Rectifier,
    mains: Limits,
    output: Limits,
    fan_on_c: i64,
    fan_off_c: i64,
}

impl Settings {
    /// The settings that the registers hold.
    pub fn of(regs: &Image) -> Self {
        let number = |point: Point<u16>| i64::from(regs.get(point));
        let tenths = |point: Point<u16>| f64::from(regs.get(point)) / 10.0;
        Self {
            rectifier: Rectifier {
                charge_voltage_v: tenths(CHARGE_VOLTAGE_LIMIT),
                charge_current_a: tenths(CHARGE_CURRENT_LIMIT),
                output_current_a: tenths(OUTPUT_CURRENT_LIMIT),
            },
            mains: Limits { high: number(AC_HIGH_LIMIT), low: number(AC_LOW_LIMIT) },
            output: Limits { high: number(DC_HIGH_LIMIT), low: number(DC_LOW_LIMIT) },
            fan_on_c: number(FAN_ON_TEMPERATURE),
            fan_off_c: number(FAN_OFF_TEMPERATURE),
        }
    }
}

impl Plant {
    /// Length of a step, in microseconds of simulated time.
    pub const STEP_US: i64 = SECOND_US;

    /// A charger that was just switched on: relays and fan remember nothing.
    pub fn switched_on(site: Site, settings: Settings, battery: Battery, temperature_c: f64) -> Self {
        let heat = Heat::cold(temperature_c);
        let (flow, watch) = (Flow::default(), Watch::default());
        let mut plant = Self { site, settings, battery, heat, flow, watch, is_cut_off: false };
        plant.settle();
        plant
    }

    /// Lives from one running time to another, by whole steps that end where the running time is a multiple of their
    /// length. Gives the end of the last one.
    pub fn live(&mut self, from_us: i64, to_us: i64) -> i64 {
        let mut at_us = from_us;
        loop {
            let end_us = (at_us.div_euclid(Self::STEP_US) + 1) * Self::STEP_US;
            if end_us > to_us {
                return at_us;
            }
            let is_whole = end_us - at_us == Self::STEP_US;
            let before = (self.battery, self.heat);
            self.pass(end_us - at_us);
            self.settle();
            at_us = end_us;
            if is_whole && before == (self.battery, self.heat) {
                // Nothing moves any more, so the steps that are left do nothing either.
                return at_us + (to_us - at_us) / Self::STEP_US * Self::STEP_US;
            }
        }
    }

    /// Lets `us` microseconds pass with what flows now: the charge moves by its integral.
    pub fn pass(&mut self, us: i64) {
        self.battery.take(self.flow.battery_a, us);
        self.heat.pass(self.flow.output_a, self.site.ambient_c, us);
    }

    /// Finds what flows, and moves the relays, for site, settings, charge and temperature as they are now.
    pub fn settle(&mut self) {
        let Self { site, settings, battery, .. } = *self;
        let rectifier = settings.rectifier;
        self.watch.look_at_mains(self.mains(), settings.mains);
        let mains = self.watch.mains_is_good();
        self.is_cut_off &= !mains;
        self.flow = match (site.short_circuit, mains) {
            (true, _) => rectifier.shorted(mains),
            (false, true) => rectifier.with_mains(site.load_a, self.has_contact().then_some(&battery)),
            (false, false) => {
                let flow = rectifier.without_mains(site.load_a, self.has_contact().then_some(&battery));
                self.is_cut_off |= self.has_contact() && flow.voltage_v < Battery::CUT_OFF_V;
                if self.is_cut_off { Flow::default() } else { flow }
            }
        };
        self.watch.look_at_output(tenths(self.flow.voltage_v), settings.output);
        self.heat.switch_fan(settings.fan_on_c, settings.fan_off_c);
    }

    /// Puts coils and measurements into the registers.
    pub fn show(&self, regs: &mut Image) {
        let Self { site, settings, flow, watch, .. } = self;
        let is_overloaded = !site.short_circuit && site.load_a > settings.rectifier.output_current_a;
        let faults = [
            (RELAY4_SHORT_CIRCUIT, site.short_circuit),
            (RELAY5_OVERLOAD, is_overloaded),
            (RELAY6_DC_LEAK_NEGATIVE, site.dc_leak_negative),
            (RELAY7_DC_LEAK_POSITIVE, site.dc_leak_positive),
            (RELAY8_AC_HIGH, watch.ac_high),
            (RELAY9_AC_LOW, watch.ac_low),
            (RELAY10_DC_HIGH, watch.dc_high),
            (RELAY11_DC_LOW, watch.dc_low),
        ];
        for (relay, is_on) in faults {
            regs.set(relay, is_on);
        }
        regs.set(RELAY1_ALARM, faults.iter().any(|fault| fault.1) && !site.alarm_silenced);
        regs.set(RELAY2_FAN, self.heat.fan);
        regs.set(RELAY3_BATTERY_CONTACTOR, self.has_contact());
        let output = tenths(flow.output_a);
        // Two roundings must not add up to more than the limit.
        let battery = tenths(flow.battery_a).min(tenths(settings.rectifier.output_current_a) - output);
        regs.set(AC_VOLTAGE, self.mains() as u32);
        regs.set(OUTPUT_VOLTAGE, tenths(flow.voltage_v) as u32);
        regs.set(OUTPUT_CURRENT, output as i32);
        regs.set(BATTERY_CURRENT, battery as i32);
        regs.set(TEMPERATURE, self.heat.measured_c() as i32);
    }

    /// The mains voltage as measured, in whole volts.
    fn mains(&self) -> i64 {
        self.site.ac_voltage_v.round() as i64
    }

    /// Whether the contactor joins battery and output.
    fn has_contact(&self) -> bool {
        self.site.battery_connected && !self.site.short_circuit && !self.is_cut_off
    }
}

/// A measured value in tenths.
fn tenths(value: f64) -> i64 {
    (value * 10.0).round() as i64
}
