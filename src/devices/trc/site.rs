//! The place where the rectifier stands: mains, load, battery and room, as far as nothing in the device moves them.

use crate::inputs;
use crate::world::{Input, World};

inputs! {
    /// Mains voltage; 0 is an outage.
    AC_VOLTAGE: f64 = Input::number(0.0, 500.0, 230.0).unit("V").cite("TRC-10");
    /// Current that the load asks for.
    LOAD_CURRENT: f64 = Input::number(0.0, 100.0, 2.0).unit("A").cite("TRC-10");
    /// Temperature of the room.
    AMBIENT_TEMPERATURE: f64 = Input::number(-40.0, 100.0, 25.0).unit("°C").cite("TRC-12");
    /// Whether a battery is wired to the rectifier.
    BATTERY_CONNECTED: bool = Input::flag(true).cite("TRC-10");
    /// What the battery holds when full.
    BATTERY_CAPACITY: f64 = Input::number(0.1, 10_000.0, 7.0).unit("Ah").cite("TRC-10");
    /// Share of its capacity that the battery holds: 0 empty, 1 full. It moves as the battery charges and discharges.
    BATTERY_CHARGE: f64 = Input::number(0.0, 1.0, 0.9).cite("TRC-10, TRC-20");
    /// Whether the output is short-circuited.
    SHORT_CIRCUIT: bool = Input::flag(false).cite("TRC-14");
    /// Whether the positive pole leaks to earth.
    DC_LEAK_POSITIVE: bool = Input::flag(false).cite("TRC-1");
    /// Whether the negative pole leaks to earth.
    DC_LEAK_NEGATIVE: bool = Input::flag(false).cite("TRC-1");
    /// Whether someone has silenced the alarm.
    ALARM_SILENCED: bool = Input::flag(false).cite("TRC-1");
}

/// The site at one moment, without the battery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// Mains voltage in volts.
    pub ac_voltage_v: f64,
    /// What the load asks for, in ampere.
    pub load_a: f64,
    /// Temperature of the room in °C.
    pub ambient_c: f64,
    /// Whether a battery is wired to the rectifier.
    pub battery_connected: bool,
    /// Whether the output is short-circuited.
    pub short_circuit: bool,
    /// Whether the positive pole leaks to earth.
    pub dc_leak_positive: bool,
    /// Whether the negative pole leaks to earth.
    pub dc_leak_negative: bool,
    /// Whether someone has silenced the alarm.
    pub alarm_silenced: bool,
}

impl Site {
    /// The site as the inputs say.
    pub fn of(world: &World) -> Self {
        Self {
            ac_voltage_v: world.number(AC_VOLTAGE),
            load_a: world.number(LOAD_CURRENT),
            ambient_c: world.number(AMBIENT_TEMPERATURE),
            battery_connected: world.flag(BATTERY_CONNECTED),
            short_circuit: world.flag(SHORT_CIRCUIT),
            dc_leak_positive: world.flag(DC_LEAK_POSITIVE),
            dc_leak_negative: world.flag(DC_LEAK_NEGATIVE),
            alarm_silenced: world.flag(ALARM_SILENCED),
        }
    }
}
