//! The Astro against models of its own that know nothing of its code: the calendar, the sun, the programs, the relays and
//! the memory. What single requests do is told by the transcripts.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../bench/mod.rs"]
mod bench;
mod calendar;
mod memory;
mod slots;
mod sun;
mod switching;

use bench::{Bench, Plan};
use chrono::{Datelike, NaiveDateTime, Timelike};

/// Adds programs, each in the words of the record registers: settings, hour, minute, second, offset, active days.
pub fn add_programs(bench: &mut Bench, programs: &[[i16; 6]]) {
    for record in programs {
        assert_eq!(bench.write_many(1, 0x87, &record.map(|word| word as u16)), 0);
        assert_eq!(bench.write_many(1, 0x84, &[1, 4]), 0);
        bench.wait_ms(50);
        assert_eq!(bench.get("process_start"), 2, "{record:?}");
    }
}

/// One device, without programs.
pub fn empty(model: &str, start: &str) -> Bench {
    Plan::of(model, 1).clock(start, 1.0).register("delete_all_programs", 0x55AA).start()
}

/// Sets the clock with one write.
pub fn set_clock(bench: &mut Bench, to: NaiveDateTime) {
    let words = [to.year() as u32 - 2000, to.month(), to.day(), to.hour(), to.minute(), to.second()];
    assert_eq!(bench.write_many(1, 0x10, &words.map(|word| word as u16)), 0, "{to}");
}

/// What the clock's registers show, weekday last.
pub fn clock(bench: &mut Bench) -> (NaiveDateTime, u32) {
    let words = bench.read(1, 3, 0x10, 7).expect("the clock");
    let [year, month, day, hour, minute, second, weekday] = words[..] else { panic!("seven words") };
    let date = chrono::NaiveDate::from_ymd_opt(2000 + i32::from(year), month.into(), day.into()).expect("a date");
    (date.and_hms_opt(hour.into(), minute.into(), second.into()).expect("a time"), weekday.into())
}
