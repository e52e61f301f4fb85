//! The registers of the TRC as its manual prints them (TRC-1), its line settings and its options.

use crate::line::{Line, LineOffer, Parity};
use crate::map::{Row, coil, holding, input, ro, rw};
use crate::options::{CRC_ERROR_REPLY, OptionRange, OptionRow};
use crate::registers;

registers! { RELAYS at coil(0);
    /// Relay 1, audible warning: one of the relays 4 to 11 is on and the alarm is not silenced.
    +0 RELAY1_ALARM: bool = ro().cite("TRC-1");
    /// Relay 2: the fan runs.
    +1 RELAY2_FAN: bool = ro().cite("TRC-1, TRC-12");
    /// Relay 3: the battery is connected to the output.
    +2 RELAY3_BATTERY_CONTACTOR: bool = ro().cite("TRC-1, TRC-11");
    /// Relay 4: the output is short-circuited.
    +3 RELAY4_SHORT_CIRCUIT: bool = ro().cite("TRC-1, TRC-14");
    /// Relay 5, overload: the load asks for more than the output current limit.
    +4 RELAY5_OVERLOAD: bool = ro().cite("TRC-1, TRC-14");
    /// Relay 6: the negative pole leaks to earth.
    +5 RELAY6_DC_LEAK_NEGATIVE: bool = ro().cite("TRC-1");
    /// Relay 7: the positive pole leaks to earth.
    +6 RELAY7_DC_LEAK_POSITIVE: bool = ro().cite("TRC-1");
    /// Relay 8: the mains voltage is above its high limit.
    +7 RELAY8_AC_HIGH: bool = ro().cite("TRC-1, TRC-13");
    /// Relay 9: the mains voltage is below its low limit.
    +8 RELAY9_AC_LOW: bool = ro().cite("TRC-1, TRC-13");
    /// Relay 10: the output voltage is above its high limit.
    +9 RELAY10_DC_HIGH: bool = ro().cite("TRC-1, TRC-13");
    /// Relay 11: the output voltage is below its low limit.
    +10 RELAY11_DC_LOW: bool = ro().cite("TRC-1, TRC-13");
}

registers! { MEASUREMENTS at input(0);
    /// Mains voltage.
    +0 AC_VOLTAGE: u32 = ro().unit("V").cite("TRC-1");
    /// Output voltage.
    +2 OUTPUT_VOLTAGE: u32 = ro().unit("V").scale(1).cite("TRC-1");
    /// Current of the load, from mains or battery.
    +4 OUTPUT_CURRENT: i32 = ro().unit("A").scale(1).cite("TRC-1, TRC-10");
    /// Current of the battery, positive while it charges.
    +6 BATTERY_CURRENT: i32 = ro().unit("A").scale(1).cite("TRC-1, TRC-10");
    /// Temperature of the rectifier.
    +8 TEMPERATURE: i32 = ro().unit("°C").cite("TRC-1, TRC-12");
}

registers! { SETTINGS at holding(0);
    /// Unit number on the bus.
    +0 UNIT: u16 = rw().within(1, 255).default(1).eeprom().cite("TRC-1, TRC-6");
    /// Speed of the line: 0 is 4800, 1 is 7200, 2 is 9600, 3 is 14400, 4 is 19200, 5 is 38400 baud.
    +1 BAUD: u16 = rw().within(0, BAUD_MAX).default(2).eeprom().cite("TRC-1, TRC-4");
    /// Stop bits: 0 is one, 1 is two.
    +2 STOP_BITS: u16 = rw().within(0, 1).default(0).eeprom().cite("TRC-1, TRC-4");
    /// Voltage that charging holds once it is reached.
    +3 CHARGE_VOLTAGE_LIMIT: u16 = rw().within(215, 290).default(275).unit("V").scale(1).eeprom().cite("TRC-1, TRC-10");
    /// Most current into the battery.
    +4 CHARGE_CURRENT_LIMIT: u16 = rw().within(1, 30).default(20).unit("A").scale(1).eeprom().cite("TRC-1, TRC-10");
    /// Most current out of the rectifier, load and battery together.
    +5 OUTPUT_CURRENT_LIMIT: u16 = rw().within(1, 200).default(190).unit("A").scale(1).eeprom().cite("TRC-1, TRC-10");
    /// Mains voltage above which relay 8 comes and the rectifier stops.
    +6 AC_HIGH_LIMIT: u16 = rw().within(230, 270).default(250).unit("V").eeprom().cite("TRC-1, TRC-13");
    /// Mains voltage below which relay 9 comes and the rectifier stops.
    +7 AC_LOW_LIMIT: u16 = rw().within(150, 210).default(180).unit("V").eeprom().cite("TRC-1, TRC-13");
    /// Output voltage above which relay 10 comes.
    +8 DC_HIGH_LIMIT: u16 = rw().within(240, 290).default(285).unit("V").scale(1).eeprom().cite("TRC-1, TRC-13");
    /// Output voltage below which relay 11 comes.
    +9 DC_LOW_LIMIT: u16 = rw().within(200, 225).default(210).unit("V").scale(1).eeprom().cite("TRC-1, TRC-13");
    /// Temperature from which on the fan runs.
    +10 FAN_ON_TEMPERATURE: u16 = rw().within(20, 60).default(40).unit("°C").eeprom().cite("TRC-1, TRC-12");
    /// Temperature down to which the fan runs.
    +11 FAN_OFF_TEMPERATURE: u16 = rw().within(15, 45).default(30).unit("°C").eeprom().cite("TRC-1, TRC-12");
}

/// All tables of the device.
pub const MAP: &[&[Row]] = &[RELAYS, MEASUREMENTS, SETTINGS];

/// The largest number that stands for a speed.
pub const BAUD_MAX: i64 = 5;

/// Where the line settings live, and what they offer: six speeds, no parity, one or two stop bits (TRC-1).
pub const LINE: LineOffer = LineOffer {
    unit: UNIT,
    units: (1, 255),
    baud: BAUD,
    bauds: &[(4800, 0), (7200, 1), (9600, 2), (14_400, 3), (19_200, 4), (38_400, 5)],
    formats: &[(Parity::None, 1, &[(STOP_BITS, 0)]), (Parity::None, 2, &[(STOP_BITS, 1)])],
    factory: Line { baud: 9600, parity: Parity::None, stop_bits: 1 },
};

/// The option that decides what a speed beyond the last one does.
pub const BAUD_OUT_OF_RANGE: OptionRow = OptionRow {
    name: "baud_out_of_range",
    about: "what a baud number above 5 does: wrap to its rest by 5, or be refused",
    range: OptionRange::Choice(&["wrap", "reject"]),
    cite: "TRC-4",
};

/// The option that decides what a value beyond its range does.
pub const RANGE_CHECK: OptionRow = OptionRow {
    name: "range_check",
    about: "what a value outside the manual's range does: be refused, or be stored",
    range: OptionRange::Choice(&["reject", "accept"]),
    cite: "TRC-5",
};

/// The options of the device.
pub const OPTIONS: &[OptionRow] = &[CRC_ERROR_REPLY, BAUD_OUT_OF_RANGE, RANGE_CHECK];
