//! Rules that tie registers together: dates must exist, and a holiday does not end before it starts.

use super::map::{RTC_DAY, RTC_MONTH, RTC_YEAR, SIDES};
use crate::image::{Rule, Txn};
use crate::map::Point;

/// The rules of both models.
pub const RULES: &[Rule] = &[
    Rule { says: "the date of the clock must exist", cite: "ASTRO-11", holds: |txn| exists(txn, CLOCK_DATE) },
    Rule { says: "the first day of holiday A must exist", cite: "ASTRO-41", holds: |txn| exists(txn, SIDES[0].start) },
    Rule { says: "the last day of holiday A must exist", cite: "ASTRO-41", holds: |txn| exists(txn, SIDES[0].end) },
    Rule { says: "the first day of holiday B must exist", cite: "ASTRO-41", holds: |txn| exists(txn, SIDES[1].start) },
    Rule { says: "the last day of holiday B must exist", cite: "ASTRO-41", holds: |txn| exists(txn, SIDES[1].end) },
    Rule { says: "holiday A must not start after its end", cite: "ASTRO-41", holds: |txn| is_ordered(txn, 0) },
    Rule { says: "holiday B must not start after its end", cite: "ASTRO-41", holds: |txn| is_ordered(txn, 1) },
];

const CLOCK_DATE: [Point<u16>; 3] = [RTC_YEAR, RTC_MONTH, RTC_DAY];

/// Days of a month in the device's calendar, where every fourth year is a leap year (ASTRO-11).
const fn days_in(year: u16, month: u16) -> u16 {
    match month {
        2 if year.is_multiple_of(4) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Whether a date would exist after the write, if the write has to do with it.
fn exists(txn: &Txn, date: [Point<u16>; 3]) -> bool {
    let [year, month, day] = date.map(|point| txn.get(point));
    !date.iter().any(|point| txn.touches(*point)) || day <= days_in(year, month)
}

fn is_ordered(txn: &Txn, side: usize) -> bool {
    let (start, end) = (SIDES[side].start, SIDES[side].end);
    let is_touched = start.iter().chain(&end).any(|point| txn.touches(*point));
    !is_touched || start.map(|point| txn.get(point)) <= end.map(|point| txn.get(point))
}
