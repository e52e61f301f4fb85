//! The controller's own clock (VOL-20 … VOL-22): a difference to the simulation's clock and a weekday that counts for
//! itself. Its battery keeps it running while the device is off (VOL-50).

use chrono::{Datelike, NaiveDate, NaiveDateTime, NaiveTime, Timelike};
use serde::{Deserialize, Serialize};

use super::map::*;
use crate::image::{Change, Image, Origin};
use crate::time::{civil_difference_us, civil_plus_us, into_century};

/// What makes the device's clock of the simulation's (BUS-22).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clock {
    /// How far it is ahead of the simulation's clock, in microseconds.
    ahead_us: i64,
    /// How many days the weekday is ahead of its date's.
    weekday_ahead: u8,
}

/// A moment of the week, as far as the schedule asks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WeekTime {
    /// 0 Monday to 6 Sunday.
    pub weekday: u16,
    /// Minutes since midnight.
    pub minute: u16,
    /// Microseconds until the next quarter of an hour.
    pub quarter_ends_in_us: i64,
}

const QUARTER_US: i64 = 15 * 60 * 1_000_000;

impl Clock {
    /// What it shows when the simulation's clock shows `civil`; the century is folded away only where a year is read.
    fn at(&self, civil: NaiveDateTime) -> NaiveDateTime {
        civil_plus_us(civil, self.ahead_us)
    }

    fn weekday(&self, shown: NaiveDateTime) -> u16 {
        let of_date = shown.weekday().num_days_from_monday();
        ((of_date + u32::from(self.weekday_ahead)) % 7) as u16
    }

    /// Weekday and time of day for the schedule.
    pub fn week_time(&self, civil: NaiveDateTime) -> WeekTime {
        let shown = self.at(civil);
        let of_day_us = i64::from(shown.num_seconds_from_midnight()) * 1_000_000 + i64::from(shown.nanosecond() / 1000);
        WeekTime {
            weekday: self.weekday(shown),
            minute: (of_day_us / 60_000_000) as u16,
            quarter_ends_in_us: QUARTER_US - of_day_us % QUARTER_US,
        }
    }

    /// Puts date, time and weekday into the registers.
    pub fn show(&self, civil: NaiveDateTime, regs: &mut Image) {
        let shown = self.at(civil);
        let folded = into_century(shown);
        let numbers = [
            (folded.year() - 2000) as u16,
            folded.month() as u16,
            folded.day() as u16,
            folded.hour() as u16,
            folded.minute() as u16,
            folded.second() as u16,
        ];
        for (point, number) in RTC_TIME.into_iter().zip(numbers) {
            regs.set(point, number);
        }
        regs.set(RTC_WEEK_DAY, self.weekday(shown));
    }

    /// Takes over what a write sent to the clock's registers; gives whether it sent anything there.
    pub fn take(&mut self, change: &Change, civil: NaiveDateTime, regs: &Image) -> bool {
        let is_set = RTC_TIME.into_iter().any(|point| change.touches(point));
        let weekday = change.sent(RTC_WEEK_DAY);
        if is_set {
            let shown = self.at(civil);
            let fraction_ns = if change.touches(RTC_SECOND) { 0 } else { shown.nanosecond() % 1_000_000_000 };
            let kept_weekday = self.weekday(shown);
            if let Some(set) = registers_say(regs, fraction_ns) {
                self.ahead_us = civil_difference_us(set, civil);
            }
            // A start value is where the clock comes from: there the weekday fits the date (VOL-22).
            if change.origin != Origin::Start {
                self.set_weekday(kept_weekday, civil);
            }
        }
        if let Some(weekday) = weekday {
            self.set_weekday(weekday, civil);
        }
        is_set || weekday.is_some()
    }

    fn set_weekday(&mut self, weekday: u16, civil: NaiveDateTime) {
        let of_date = self.at(civil).weekday().num_days_from_monday() as u16;
        self.weekday_ahead = ((weekday + 7 - of_date) % 7) as u8;
    }
}

fn registers_say(regs: &Image, fraction_ns: u32) -> Option<NaiveDateTime> {
    let [year, month, day, hour, minute, second] = RTC_TIME.map(|point| u32::from(regs.get(point)));
    let date = NaiveDate::from_ymd_opt(2000 + year as i32, month, day)?;
    let time = NaiveTime::from_hms_nano_opt(hour, minute, second, fraction_ns)?;
    Some(date.and_time(time))
}

/// The last day of a month; year 0 is 2000 (VOL-20).
pub fn days_in_month(year: u16, month: u16) -> u16 {
    match month {
        2 if year.is_multiple_of(4) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}
