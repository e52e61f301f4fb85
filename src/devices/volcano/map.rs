//! The controller's tables: registers, coils, inputs and options, in the order of the manual (VOL-1). Limits that
//! depend on the unit of temperature or on another register stand here as wide as they ever are; `rules` narrows them.

use crate::line::{Line, LineOffer, Parity};
use crate::map::{Point, Row, coil, command, discrete, holding, input, ro, rw};
use crate::options::{BOOT_MS, OptionRange, OptionRow};
use crate::world::Input;
use crate::{inputs, registers};

registers! { LINE at holding(0);
    /// Speed on the bus, in tens of bits a second; another one restarts the device.
    +0 BAUDRATE: u16 = rw().one_of(&[480, 960, 1920, 3840]).default(960).unit("10 bit/s").eeprom().cite("VOL-3");
    /// Parity: 101 'e' even and 111 'o' odd with one stop bit, 110 'n' none with two; another one restarts the device.
    +1 PARITY_MODE: u16 = rw().one_of(&[0x65, 0x6F, 0x6E]).default(0x65).eeprom().cite("VOL-3");
    /// Unit number on the bus; another one restarts the device.
    +2 SLAVE_ADDR: u16 = rw().within(1, 247).default(1).eeprom().cite("VOL-3");
}

registers! { SENSOR at holding(3);
    /// Correction that is added to the measured temperature: -800 to 800 in °C, -1440 to 1440 in °F.
    +0 NTC_1_CORRECT: i16 = rw().within(-1440, 1440).unit("°C/°F").scale(2).eeprom().cite("VOL-40");
    /// Time from one measurement to the next; 0 stops measuring.
    +1 NTC_PERIOD: u16 = rw().default(10).unit("s").scale(1).eeprom().cite("VOL-40");
}

registers! { CLOCK at holding(5);
    /// Day of the week, a counter of its own: 0 Monday to 6 Sunday.
    +0 RTC_WEEK_DAY: u16 = rw().within(0, 6).cite("VOL-22");
    /// Year; 0 is 2000.
    +1 RTC_YEAR: u16 = rw().within(0, 99).cite("VOL-20");
    /// Month.
    +2 RTC_MONTH: u16 = rw().within(1, 12).default(1).cite("VOL-20");
    /// Day of the month, up to the month's last.
    +3 RTC_DAY: u16 = rw().within(1, 31).default(1).cite("VOL-20");
    /// Hour.
    +4 RTC_HOUR: u16 = rw().within(0, 23).unit("h").cite("VOL-1");
    /// Minute.
    +5 RTC_MINUTE: u16 = rw().within(0, 59).unit("min").cite("VOL-1");
    /// Second; a write starts it anew.
    +6 RTC_SECOND: u16 = rw().within(0, 59).unit("s").cite("VOL-1");
}

registers! { FAN at holding(12);
    /// Voltage that the fan gets now; a write is blocked.
    +0 FAN_ACTUAL_POWER_VOLT: u16 = ro().within(0, 1000).unit("V").scale(2).cite("VOL-43");
    /// Inactive: kept until the next restart, without effect.
    +1 FAN_POWER_1_VOLT: u16 = rw().within(0, 1000).default(400).unit("V").scale(2).cite("VOL-1");
    /// Inactive: kept until the next restart, without effect.
    +2 FAN_POWER_2_VOLT: u16 = rw().within(0, 1000).default(700).unit("V").scale(2).cite("VOL-1");
    /// Inactive: kept until the next restart, without effect.
    +3 FAN_POWER_3_VOLT: u16 = rw().within(0, 1000).default(1000).unit("V").scale(2).cite("VOL-1");
    /// Voltage that is added to the fan's while it runs.
    +4 FAN_ADDITIONAL_VOLT: u16 = rw().within(0, 400).unit("V").scale(2).eeprom().cite("VOL-43");
}

const fn temperature(least: i64, most: i64, factory: i64) -> Row {
    rw().within(least, most).default(factory).unit("°C/°F").scale(2).eeprom()
}

registers! { ZONE at holding(17);
    /// Temperature on the display: 0 the target, 1 the room's.
    +0 ZONE_DISPLAYED_TEMP: u16 = rw().within(0, 1).default(1).eeprom().cite("VOL-1");
    /// What the installation can do: 1 only cool, 2 only heat, 3 both.
    +1 ZONE_AVAILABLE_MODE: u16 = rw().within(1, 3).default(3).eeprom().cite("VOL-42");
    /// 0 always at work, 1 by the schedule.
    +2 ZONE_PROGRAM: u16 = rw().within(0, 1).eeprom().cite("VOL-44");
    /// Protection: 0 off, 1 AntiFrost opens the valve, 2 ECO runs the fan too.
    +3 ZONE_ECO_FROST_MODE: u16 = rw().within(0, 2).eeprom().cite("VOL-45");
    /// 0 cooling, 1 heating.
    +4 ZONE_MODE: u16 = rw().within(0, 1).eeprom().cite("VOL-42");
    /// Fan in manual mode; 0 to 14 becomes 0. The factory value is 1, as printed.
    +5 ZONE_FAN_SPEED: u16 = rw().within(0, 100).default(1).unit("%").eeprom().cite("VOL-12");
    /// Target, from zone_temperature_min to zone_temperature_max, rounded down to half a degree.
    +6 ZONE_TEMPERATURE_TARGET: u16 = temperature(500, 10_400, 2200).cite("VOL-10");
    /// Temperature below which the protection steps in: 200 to 2200 in °C, 3600 to 7200 in °F, rounded down to half a
    /// degree.
    +7 ZONE_TEMPERATURE_ECO: u16 = temperature(200, 7200, 1800).cite("VOL-10");
    /// Hysteresis of the two-state control, the same number in °C and °F, rounded down to half a degree.
    +8 ZONE_TEMPERATURE_DELTA: u16 = temperature(50, 200, 50).cite("VOL-10");
    /// Lowest target: 500 to the highest less 500 in °C, 4100 to the highest less 900 in °F, rounded down to half a
    /// degree.
    +9 ZONE_TEMPERATURE_MIN: u16 = temperature(500, 9500, 500).cite("VOL-14");
    /// Highest target: the lowest and 500 to 4000 in °C, the lowest and 900 to 10400 in °F, rounded down to half a
    /// degree.
    +10 ZONE_TEMPERATURE_MAX: u16 = temperature(1000, 10_400, 4000).cite("VOL-14");
}

const fn minute(factory: i64) -> Row {
    rw().within(0, 1425).default(factory).unit("min").eeprom().cite("VOL-11")
}

registers! { SCHEDULE at holding(28);
    /// Monday to Friday: the first period starts; minutes of the day, rounded down to a quarter of an hour.
    +0 ZONE_SCHEDULE_MON_FRI_WORK_1_START: u16 = minute(480);
    /// Monday to Friday: the first period stops.
    +1 ZONE_SCHEDULE_MON_FRI_WORK_1_STOP: u16 = minute(780);
    /// Monday to Friday: the second period starts.
    +2 ZONE_SCHEDULE_MON_FRI_WORK_2_START: u16 = minute(840);
    /// Monday to Friday: the second period stops.
    +3 ZONE_SCHEDULE_MON_FRI_WORK_2_STOP: u16 = minute(1080);
    /// Saturday: the first period starts.
    +4 ZONE_SCHEDULE_SAT_WORK_1_START: u16 = minute(480);
    /// Saturday: the first period stops.
    +5 ZONE_SCHEDULE_SAT_WORK_1_STOP: u16 = minute(780);
    /// Saturday: the second period starts.
    +6 ZONE_SCHEDULE_SAT_WORK_2_START: u16 = minute(840);
    /// Saturday: the second period stops.
    +7 ZONE_SCHEDULE_SAT_WORK_2_STOP: u16 = minute(1080);
    /// Sunday: the first period starts.
    +8 ZONE_SCHEDULE_SUN_WORK_1_START: u16 = minute(480);
    /// Sunday: the first period stops.
    +9 ZONE_SCHEDULE_SUN_WORK_1_STOP: u16 = minute(780);
    /// Sunday: the second period starts.
    +10 ZONE_SCHEDULE_SUN_WORK_2_START: u16 = minute(840);
    /// Sunday: the second period stops.
    +11 ZONE_SCHEDULE_SUN_WORK_2_STOP: u16 = minute(1080);
}

registers! { REGULATION at holding(40);
    /// Fan: 0 manual, 1 by the distance from the target.
    +0 FAN_REGULATION_MODE: u16 = rw().within(0, 1).eeprom().cite("VOL-43");
}

registers! { MEASURED at input(0);
    /// Temperature of the room, correction included; -32768 while the sensor in use is broken.
    +0 ZONE_TEMPERATURE_ACTUAL: i16 = ro().unit("°C/°F").scale(2).cite("VOL-40");
    /// Where the schedule stands: 0 no schedule, 1 first period, 2 between, 3 second period, 4 after it and before the
    /// first.
    +1 ZONE_ACTUAL_PROGRAM_STATE: u16 = ro().within(0, 4).cite("VOL-44");
}

registers! { SENSORS at discrete(0);
    /// The built-in sensor is sound.
    +0 NTC_1_ACTIVE: bool = ro().cite("VOL-40");
    /// An external sensor is connected and sound.
    +1 NTC_2_ACTIVE: bool = ro().cite("VOL-40");
}

registers! { COILS at coil(0);
    /// Heating valve H1 is open; a write is blocked.
    +0 STATE_OUTPUT_1: bool = ro().cite("VOL-41");
    /// Cooling valve H2 is open; a write is blocked.
    +1 STATE_OUTPUT_2: bool = ro().cite("VOL-41");
    /// The controller is on.
    +2 POWER_ON_OFF: bool = rw().default(1).eeprom().cite("VOL-46");
    /// A 1 restores the factory settings and restarts the device; it reads 0.
    +3 GO_TO_DEFAULT: bool = command().cite("VOL-47");
    /// The keys are locked.
    +4 LOCK_KEYPAD: bool = rw().eeprom().cite("VOL-1");
    /// Unit of all temperatures: 0 °C, 1 °F.
    +5 TEMP_UNIT: bool = rw().eeprom().cite("VOL-30");
    /// Clock on the display: 0 of 24 hours, 1 of 12.
    +6 CLOCK_FORMAT: bool = rw().eeprom().cite("VOL-1");
}

/// All tables.
pub const MAP: &[&[Row]] = &[LINE, SENSOR, CLOCK, FAN, ZONE, SCHEDULE, REGULATION, MEASURED, SENSORS, COILS];

/// A period of the schedule: the points of its start and stop.
pub type Period = (Point<u16>, Point<u16>);

/// The schedule by kind of day: Monday to Friday, Saturday, Sunday; two periods each.
pub const PERIODS: [[Period; 2]; 3] = [
    [
        (ZONE_SCHEDULE_MON_FRI_WORK_1_START, ZONE_SCHEDULE_MON_FRI_WORK_1_STOP),
        (ZONE_SCHEDULE_MON_FRI_WORK_2_START, ZONE_SCHEDULE_MON_FRI_WORK_2_STOP),
    ],
    [
        (ZONE_SCHEDULE_SAT_WORK_1_START, ZONE_SCHEDULE_SAT_WORK_1_STOP),
        (ZONE_SCHEDULE_SAT_WORK_2_START, ZONE_SCHEDULE_SAT_WORK_2_STOP),
    ],
    [
        (ZONE_SCHEDULE_SUN_WORK_1_START, ZONE_SCHEDULE_SUN_WORK_1_STOP),
        (ZONE_SCHEDULE_SUN_WORK_2_START, ZONE_SCHEDULE_SUN_WORK_2_STOP),
    ],
];

/// The clock's registers from the year to the second.
pub const RTC_TIME: [Point<u16>; 6] = [RTC_YEAR, RTC_MONTH, RTC_DAY, RTC_HOUR, RTC_MINUTE, RTC_SECOND];

/// Line settings on offer (VOL-3); stop bits follow from the parity.
pub const OFFER: LineOffer = LineOffer {
    unit: SLAVE_ADDR,
    units: (1, 247),
    baud: BAUDRATE,
    bauds: &[(4800, 480), (9600, 960), (19_200, 1920), (38_400, 3840)],
    formats: &[
        (Parity::Even, 1, &[(PARITY_MODE, 0x65)]),
        (Parity::Odd, 1, &[(PARITY_MODE, 0x6F)]),
        (Parity::None, 2, &[(PARITY_MODE, 0x6E)]),
    ],
    factory: Line { baud: 9600, parity: Parity::Even, stop_bits: 1 },
};

inputs! {
    /// Temperature of the room: a start value, which the physics moves.
    ROOM_TEMPERATURE: f64 = Input::number(-40.0, 80.0, 20.0).unit("°C").cite("VOL-49");
    /// Temperature outside, to which the room drifts.
    OUTSIDE_TEMPERATURE: f64 = Input::number(-50.0, 60.0, 5.0).unit("°C").cite("VOL-49");
    /// The built-in sensor is broken.
    NTC_1_FAULT: bool = Input::flag(false).cite("VOL-40");
    /// An external sensor is connected; it is the one that is measured.
    NTC_2_CONNECTED: bool = Input::flag(false).cite("VOL-40");
    /// The external sensor is broken.
    NTC_2_FAULT: bool = Input::flag(false).cite("VOL-40");
    /// Temperature of the water behind the heating valve.
    WATER_TEMPERATURE: f64 = Input::number(0.0, 130.0, 60.0).unit("°C").cite("VOL-49");
    /// Temperature of the water behind the cooling valve.
    CHILLED_WATER_TEMPERATURE: f64 = Input::number(0.0, 40.0, 7.0).unit("°C").cite("VOL-49");
}

/// The option that takes the manual literally: target and eco temperature are not kept.
pub const VOLATILE_SETPOINTS: OptionRow = OptionRow {
    name: "volatile_setpoints",
    about: "target and eco temperature are at their factory values after every restart",
    range: OptionRange::Flag(false),
    cite: "VOL-50",
};

/// The model's own options.
pub const OPTIONS: &[OptionRow] = &[BOOT_MS, VOLATILE_SETPOINTS];
