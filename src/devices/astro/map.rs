//! The register tables of both models, in the manual's order (ASTRO-1), and the inputs.

use crate::map::{Point, Row, command, holding, ro, rw};
use crate::registers;

/// The word that a command register takes (ASTRO-68, ASTRO-80, ASTRO-81).
pub const COMMAND: u16 = 0x55AA;

/// Programs that a kael-astro-01 holds.
pub const CAPACITY_01: u16 = 24;
/// Programs that a kael-astro-03 holds.
pub const CAPACITY_03: u16 = 100;

registers! { HEADER at holding(0x0000);
    /// Country code.
    +0 COUNTRY_CODE: u16 = ro().default(869).cite("ASTRO-1");
    /// Company code.
    +1 COMPANY_CODE: u16 = ro().default(7436).cite("ASTRO-1");
    /// Product code.
    +2 PRODUCT_CODE: u32 = ro().default(88294).cite("ASTRO-1");
    /// Check digit of the bar code.
    +4 BARCODE_CHECK: u16 = ro().default(6).cite("ASTRO-1");
    /// Version of the Modbus interface, 0x0100 for 1.00.
    +5 COMMUNICATION_VERSION: u16 = ro().default(0x0100).cite("ASTRO-1");
    /// The user's own number of the device, high word.
    +6 USER_DEVICE_NUMBER_H: u16 = rw().eeprom().cite("ASTRO-1");
    /// The user's own number of the device, low word.
    +7 USER_DEVICE_NUMBER_L: u16 = rw().eeprom().cite("ASTRO-1");
}

registers! { CLOCK at holding(0x0010);
    /// Year of the clock, counted from 2000.
    +0 RTC_YEAR: u16 = rw().within(0, 99).cite("ASTRO-10");
    /// Month of the clock.
    +1 RTC_MONTH: u16 = rw().within(1, 12).default(1).cite("ASTRO-10");
    /// Day of the clock.
    +2 RTC_DAY: u16 = rw().within(1, 31).default(1).cite("ASTRO-10");
    /// Hour of the clock.
    +3 RTC_HOUR: u16 = rw().within(0, 23).cite("ASTRO-10");
    /// Minute of the clock.
    +4 RTC_MINUTE: u16 = rw().within(0, 59).cite("ASTRO-10");
    /// Second of the clock.
    +5 RTC_SECOND: u16 = rw().within(0, 59).cite("ASTRO-10");
    /// Day of the week, which follows from the date: 1 Monday to 7 Sunday.
    +6 RTC_WEEKDAY: u16 = ro().default(6).cite("ASTRO-10");
}

registers! { PLACE at holding(0x0020);
    /// District that the place is taken from; reads 0 where the place is the user's own.
    +0 DISTRICT: u16 = rw().within(1, 135).default(72).eeprom().cite("ASTRO-30");
    /// 0 south, 1 north.
    +1 LATITUDE_HEMISPHERE: u16 = rw().within(0, 1).default(1).eeprom().cite("ASTRO-31");
    /// Degrees of the latitude.
    +2 LATITUDE_DEGREES: u16 = rw().within(0, 89).default(41).unit("°").eeprom().cite("ASTRO-31");
    /// Minutes of the latitude.
    +3 LATITUDE_MINUTES: u16 = rw().within(0, 59).default(1).unit("'").eeprom().cite("ASTRO-31");
    /// 0 east, 1 west.
    +4 LONGITUDE_HEMISPHERE: u16 = rw().within(0, 1).eeprom().cite("ASTRO-31");
    /// Degrees of the longitude.
    +5 LONGITUDE_DEGREES: u16 = rw().within(0, 179).default(28).unit("°").eeprom().cite("ASTRO-31");
    /// Minutes of the longitude.
    +6 LONGITUDE_MINUTES: u16 = rw().within(0, 59).default(57).unit("'").eeprom().cite("ASTRO-31");
    /// Local time less UTC, without summer time.
    +7 UTC_OFFSET_MINUTES: i16 = rw().within(-720, 720).step(30).default(120).unit("min").eeprom().cite("ASTRO-32");
}

registers! { SUMMER_TIME at holding(0x0030);
    /// Summer time: 0 off, 1 automatic, 2 custom.
    +0x0 DST_MODE: u16 = rw().within(0, 2).default(1).eeprom().cite("ASTRO-20");
    /// Month in which the clock goes forward.
    +0x1 SUMMER_MONTH: u16 = rw().within(1, 12).default(3).eeprom().cite("ASTRO-21");
    /// Which such weekday of the month: 1 to 4 counted, 5 the last.
    +0x2 SUMMER_WEEK: u16 = rw().within(1, 5).default(5).eeprom().cite("ASTRO-21");
    /// Day of the week on which the clock goes forward, 1 Monday to 7 Sunday.
    +0x3 SUMMER_WEEKDAY: u16 = rw().within(1, 7).default(7).eeprom().cite("ASTRO-21");
    /// Hour of the clock at which it goes forward.
    +0x4 SUMMER_HOUR: u16 = rw().within(0, 23).default(3).eeprom().cite("ASTRO-21");
    /// Minute of the clock at which it goes forward.
    +0x5 SUMMER_MINUTE: u16 = rw().within(0, 59).eeprom().cite("ASTRO-21");
    /// Month in which the clock goes back.
    +0x6 WINTER_MONTH: u16 = rw().within(1, 12).default(10).eeprom().cite("ASTRO-21");
    /// Which such weekday of the month: 1 to 4 counted, 5 the last.
    +0x7 WINTER_WEEK: u16 = rw().within(1, 5).default(5).eeprom().cite("ASTRO-21");
    /// Day of the week on which the clock goes back, 1 Monday to 7 Sunday.
    +0x8 WINTER_WEEKDAY: u16 = rw().within(1, 7).default(7).eeprom().cite("ASTRO-21");
    /// Hour of the clock at which it goes back.
    +0x9 WINTER_HOUR: u16 = rw().within(0, 23).default(4).eeprom().cite("ASTRO-21");
    /// Minute of the clock at which it goes back.
    +0xA WINTER_MINUTE: u16 = rw().within(0, 59).eeprom().cite("ASTRO-21");
    /// 0 winter, 1 summer.
    +0xB SEASON: u16 = ro().cite("ASTRO-23");
}

registers! { HOLIDAYS at holding(0x0040);
    /// Holiday of relay A: written 0 off, 1 on; reads 1 before it, 2 in it, 0 after it.
    +0x0 HOLIDAY_A_STATUS: u16 = rw().within(0, 1).eeprom().cite("ASTRO-40");
    /// First day of relay A's holiday: year from 2000.
    +0x1 HOLIDAY_A_START_YEAR: u16 = rw().within(0, 99).default(14).eeprom().cite("ASTRO-41");
    /// First day of relay A's holiday: month.
    +0x2 HOLIDAY_A_START_MONTH: u16 = rw().within(1, 12).default(1).eeprom().cite("ASTRO-41");
    /// First day of relay A's holiday: day.
    +0x3 HOLIDAY_A_START_DAY: u16 = rw().within(1, 31).default(1).eeprom().cite("ASTRO-41");
    /// Last day of relay A's holiday: year from 2000.
    +0x4 HOLIDAY_A_END_YEAR: u16 = rw().within(0, 99).default(14).eeprom().cite("ASTRO-41");
    /// Last day of relay A's holiday: month.
    +0x5 HOLIDAY_A_END_MONTH: u16 = rw().within(1, 12).default(1).eeprom().cite("ASTRO-41");
    /// Last day of relay A's holiday: day.
    +0x6 HOLIDAY_A_END_DAY: u16 = rw().within(1, 31).default(1).eeprom().cite("ASTRO-41");
    /// Holiday of relay B: written 0 off, 1 on; reads 1 before it, 2 in it, 0 after it.
    +0x7 HOLIDAY_B_STATUS: u16 = rw().within(0, 1).eeprom().cite("ASTRO-40");
    /// First day of relay B's holiday: year from 2000.
    +0x8 HOLIDAY_B_START_YEAR: u16 = rw().within(0, 99).default(14).eeprom().cite("ASTRO-41");
    /// First day of relay B's holiday: month.
    +0x9 HOLIDAY_B_START_MONTH: u16 = rw().within(1, 12).default(1).eeprom().cite("ASTRO-41");
    /// First day of relay B's holiday: day.
    +0xA HOLIDAY_B_START_DAY: u16 = rw().within(1, 31).default(1).eeprom().cite("ASTRO-41");
    /// Last day of relay B's holiday: year from 2000.
    +0xB HOLIDAY_B_END_YEAR: u16 = rw().within(0, 99).default(14).eeprom().cite("ASTRO-41");
    /// Last day of relay B's holiday: month.
    +0xC HOLIDAY_B_END_MONTH: u16 = rw().within(1, 12).default(1).eeprom().cite("ASTRO-2");
    /// Last day of relay B's holiday: day.
    +0xD HOLIDAY_B_END_DAY: u16 = rw().within(1, 31).default(1).eeprom().cite("ASTRO-2");
}

registers! { RELAYS at holding(0x0050);
    /// Language of the panel: 0 Turkish, 1 English.
    +0 LANGUAGE: u16 = rw().within(0, 1).eeprom().cite("ASTRO-1");
    /// 1 holds relay A as it is.
    +1 LOCK_A: u16 = rw().within(0, 1).eeprom().cite("ASTRO-53");
    /// 1 holds relay B as it is.
    +2 LOCK_B: u16 = rw().within(0, 1).eeprom().cite("ASTRO-53");
    /// Manual mode of relay A (bits 2 and 1: 0 off, 1 permanent, 2 temporary) and its position (bit 0).
    +3 MANUAL_SELECT_A: u16 = rw().within(0, 5).eeprom().cite("ASTRO-50");
    /// Manual mode of relay B (bits 2 and 1: 0 off, 1 permanent, 2 temporary) and its position (bit 0).
    +4 MANUAL_SELECT_B: u16 = rw().within(0, 5).eeprom().cite("ASTRO-50");
    /// Manual mode of relay A: 0 off, 1 permanent, 2 temporary.
    +5 MANUAL_MODE_A: u16 = ro().cite("ASTRO-50");
    /// Manual mode of relay B: 0 off, 1 permanent, 2 temporary.
    +6 MANUAL_MODE_B: u16 = ro().cite("ASTRO-50");
    /// Relay A: 0 off, 1 on.
    +7 RELAY_A: u16 = ro().cite("ASTRO-52");
    /// Relay B: 0 off, 1 on.
    +8 RELAY_B: u16 = ro().cite("ASTRO-52");
}

registers! { LINE at holding(0x0060);
    /// Unit number on the bus.
    +0 MODBUS_UNIT: u16 = rw().within(1, 255).default(1).eeprom().cite("BUS-13");
    /// Speed: 0 to 5 for 2400, 9600, 19200, 38400, 57600, 115200 bits a second.
    +1 MODBUS_BAUD: u16 = rw().within(0, 5).default(5).eeprom().cite("BUS-13");
    /// Parity: 0 none, 1 odd, 2 even.
    +2 MODBUS_PARITY: u16 = rw().within(0, 2).eeprom().cite("BUS-13");
    /// Stop bits: 0 to 3 for 0.5, 1, 1.5, 2.
    +3 MODBUS_STOP_BITS: u16 = rw().within(0, 3).default(1).eeprom().cite("BUS-13");
}

registers! { INFO at holding(0x0070);
    /// Hour of today's sunrise; 255 where there is none.
    +0 SUNRISE_HOUR: u16 = ro().cite("ASTRO-33");
    /// Minute of today's sunrise; 255 where there is none.
    +1 SUNRISE_MINUTE: u16 = ro().cite("ASTRO-33");
    /// Hour of today's sunset; 255 where there is none.
    +2 SUNSET_HOUR: u16 = ro().cite("ASTRO-33");
    /// Minute of today's sunset; 255 where there is none.
    +3 SUNSET_MINUTE: u16 = ro().cite("ASTRO-33");
    /// Programs that the device can hold.
    +4 PROGRAM_CAPACITY: u16 = ro().default(24).cite("ASTRO-64");
    /// Programs that it holds.
    +5 PROGRAM_COUNT: u16 = ro().default(4).cite("ASTRO-64");
    /// 1 while the clock's battery is being charged.
    +6 CHARGING: u16 = ro().cite("ASTRO-1");
}

registers! { PROGRAMS at holding(0x0080);
    /// Programs that the device can hold, again.
    +0x0 PROGRAM_CAPACITY_AGAIN: u16 = ro().default(24).cite("ASTRO-64");
    /// Programs that it holds, again.
    +0x1 PROGRAM_COUNT_AGAIN: u16 = ro().default(4).cite("ASTRO-64");
    /// 1 when programs have changed; the reader writes 0.
    +0x2 PROGRAM_UPDATE: u16 = rw().within(0, 0).cite("ASTRO-69");
    /// Slot that edit, clear and read work on.
    +0x3 PROGRAM_INPUT_ORDER: u16 = rw().within(1, 24).default(1).cite("ASTRO-61");
    /// Written 1 starts the process; reads 0 while it works, then 2 done or 6 done with error.
    +0x4 PROCESS_START: u16 = command().within(1, 1).cite("ASTRO-61");
    /// What the process does: 1 edit, 2 clear, 4 new, 8 read; bits 7 to 4 read which of them failed.
    +0x5 PROCESS_CONFIGURATION: u16 = rw().within(0, 8).cite("ASTRO-61");
    /// Slot that the last successful process worked on.
    +0x6 PROCESSED_ORDER: u16 = ro().cite("ASTRO-62");
    /// The record: bit 0 astro, bit 1 sunrise, bit 2 relay A, bit 3 on; 255 an empty slot.
    +0x7 RECORD_SETTINGS: u16 = rw().within(0, 0xFF).cite("ASTRO-60");
    /// The record: hour of a time program.
    +0x8 RECORD_HOUR: u16 = rw().within(0, 23).cite("ASTRO-60");
    /// The record: minute of a time program.
    +0x9 RECORD_MINUTE: u16 = rw().within(0, 59).cite("ASTRO-60");
    /// The record: second of a time program.
    +0xA RECORD_SECOND: u16 = rw().within(0, 59).cite("ASTRO-60");
    /// The record: what an astro program adds to sunrise or sunset.
    +0xB RECORD_OFFSET_MINUTES: i16 = rw().within(-720, 720).unit("min").cite("ASTRO-60");
    /// The record: active days, bit 0 Monday to bit 6 Sunday.
    +0xC RECORD_ACTIVE_DAYS: u16 = rw().within(0, 0x7F).cite("ASTRO-60");
    /// Written 0x55AA empties every slot.
    +0xD DELETE_ALL_PROGRAMS: u16 = command().within(0x55AA, 0x55AA).cite("ASTRO-68");
}

registers! { RESET at holding(0x0090);
    /// Written 0x55AA restarts the device.
    +0 REMOTE_RESET: u16 = command().within(0x55AA, 0x55AA).cite("ASTRO-80");
    /// Written 0x55AA returns the device to its factory settings and restarts it.
    +1 FACTORY_RESET: u16 = command().within(0x55AA, 0x55AA).cite("ASTRO-81");
}

registers! { INFRARED at holding(0x00A0);
    /// 1 lets the CON-3 remote control in.
    +0 INFRARED_ENABLE: u16 = rw().within(0, 1).default(1).eeprom().cite("ASTRO-1");
    /// 1 while the remote control transfers data.
    +1 INFRARED_TRANSFER: u16 = ro().cite("ASTRO-1");
}

/// The points that belong to one of the two relays.
#[derive(Clone, Copy, Debug)]
pub struct Side {
    /// Its lock.
    pub lock: Point<u16>,
    /// What manual mode was chosen.
    pub manual_select: Point<u16>,
    /// The manual mode that holds.
    pub manual_mode: Point<u16>,
    /// Its position.
    pub relay: Point<u16>,
    /// State of its holiday.
    pub holiday: Point<u16>,
    /// Year, month and day on which its holiday starts.
    pub start: [Point<u16>; 3],
    /// Year, month and day on which its holiday ends.
    pub end: [Point<u16>; 3],
}

/// Relay A's points and relay B's.
pub const SIDES: [Side; 2] = [
    Side {
        lock: LOCK_A,
        manual_select: MANUAL_SELECT_A,
        manual_mode: MANUAL_MODE_A,
        relay: RELAY_A,
        holiday: HOLIDAY_A_STATUS,
        start: [HOLIDAY_A_START_YEAR, HOLIDAY_A_START_MONTH, HOLIDAY_A_START_DAY],
        end: [HOLIDAY_A_END_YEAR, HOLIDAY_A_END_MONTH, HOLIDAY_A_END_DAY],
    },
    Side {
        lock: LOCK_B,
        manual_select: MANUAL_SELECT_B,
        manual_mode: MANUAL_MODE_B,
        relay: RELAY_B,
        holiday: HOLIDAY_B_STATUS,
        start: [HOLIDAY_B_START_YEAR, HOLIDAY_B_START_MONTH, HOLIDAY_B_START_DAY],
        end: [HOLIDAY_B_END_YEAR, HOLIDAY_B_END_MONTH, HOLIDAY_B_END_DAY],
    },
];

/// Rows as the model with room for `capacity` programs has them.
const fn sized<const N: usize>(rows: &[Row], capacity: u16) -> [Row; N] {
    let mut sized = [rows[0]; N];
    let mut index = 0;
    while index < N {
        sized[index] = rows[index];
        let addr = rows[index].addr;
        if addr == PROGRAM_CAPACITY.addr() || addr == PROGRAM_CAPACITY_AGAIN.addr() {
            sized[index].default = capacity as i64;
        }
        if addr == PROGRAM_INPUT_ORDER.addr() {
            sized[index].max = capacity as i64;
        }
        index += 1;
    }
    sized
}

const INFO_03: &[Row] = &sized::<{ INFO.len() }>(INFO, CAPACITY_03);
const PROGRAMS_03: &[Row] = &sized::<{ PROGRAMS.len() }>(PROGRAMS, CAPACITY_03);

/// The tables of kael-astro-01.
pub const MAP_01: &[&[Row]] =
    &[HEADER, CLOCK, PLACE, SUMMER_TIME, HOLIDAYS, RELAYS, LINE, INFO, PROGRAMS, RESET, INFRARED];

/// The tables of kael-astro-03.
pub const MAP_03: &[&[Row]] =
    &[HEADER, CLOCK, PLACE, SUMMER_TIME, HOLIDAYS, RELAYS, LINE, INFO_03, PROGRAMS_03, RESET, INFRARED];

/// The inputs, which have the names of the registers that show them.
pub mod world {
    use crate::inputs;
    use crate::world::Input;

    inputs! {
        /// The clock's battery is being charged.
        CHARGING: bool = Input::flag(false).cite("ASTRO-1");
        /// The CON-3 remote control is transferring data.
        INFRARED_TRANSFER: bool = Input::flag(false).cite("ASTRO-1");
    }
}
