//! What a write must obey beside the rows' own ranges, and what it draws after it: rounding, limits that depend on the
//! unit and on other registers, registers that follow (VOL-2, VOL-10 … VOL-21, VOL-42).

use super::clock::days_in_month;
use super::map::*;
use super::units::{HALF_DEGREE, Unit};
use crate::image::{Image, Origin, Rule, Txn};
use crate::map::{Bank, Point, Value};

/// The rules between registers, judged on the whole write.
pub const RULES: &[Rule] = &[
    Rule { says: "registers 0 to 3 are written one to a message", cite: "VOL-2", holds: single_register_is_alone },
    Rule { says: "ntc_1_correct is -800 to 800 in °C, -1440 to 1440 in °F", cite: "VOL-1", holds: correction_fits },
    Rule { says: "zone_temperature_eco is 200 to 2200 in °C, 3600 to 7200 in °F", cite: "VOL-10", holds: eco_fits },
    Rule {
        says: "zone_temperature_min is at least 500 in °C, 4100 in °F, and zone_temperature_max at most 4000 in °C, \
               10400 in °F, with 500 in °C, 900 in °F between them",
        cite: "VOL-14",
        holds: target_limits_fit,
    },
    Rule {
        says: "zone_temperature_target lies from zone_temperature_min to zone_temperature_max",
        cite: "VOL-10",
        holds: target_fits,
    },
    Rule { says: "each period of the schedule starts before it stops", cite: "VOL-15", holds: periods_are_in_order },
    Rule { says: "the month has no such day", cite: "VOL-20", holds: day_exists },
    Rule { says: "zone_available_mode has no such zone_mode", cite: "VOL-42", holds: mode_is_available },
];

/// Rounds what was sent and moves what follows it.
pub fn shape(txn: &mut Txn) {
    let half_degrees = [
        ZONE_TEMPERATURE_TARGET,
        ZONE_TEMPERATURE_ECO,
        ZONE_TEMPERATURE_DELTA,
        ZONE_TEMPERATURE_MIN,
        ZONE_TEMPERATURE_MAX,
    ];
    for point in half_degrees {
        round_down(txn, point, HALF_DEGREE);
    }
    for (start, stop) in PERIODS.into_iter().flatten() {
        round_down(txn, start, 15);
        round_down(txn, stop, 15);
    }
    if txn.sent(ZONE_FAN_SPEED).is_some_and(|percent| percent < 15) {
        txn.set(ZONE_FAN_SPEED, 0);
    }
    if txn.touches(ZONE_TEMPERATURE_MIN) || txn.touches(ZONE_TEMPERATURE_MAX) {
        let target = within_limits(txn.after, txn.get(ZONE_TEMPERATURE_TARGET));
        txn.set(ZONE_TEMPERATURE_TARGET, target);
    }
    if txn.touches(ZONE_AVAILABLE_MODE) && !txn.touches(ZONE_MODE) {
        match txn.get(ZONE_AVAILABLE_MODE) {
            1 => txn.set(ZONE_MODE, 0),
            2 => txn.set(ZONE_MODE, 1),
            _ => {}
        }
    }
    if (txn.touches(RTC_MONTH) || txn.touches(RTC_YEAR)) && !txn.touches(RTC_DAY) {
        let last = days_in_month(txn.get(RTC_YEAR), txn.get(RTC_MONTH));
        txn.set(RTC_DAY, txn.get(RTC_DAY).min(last));
    }
}

/// The target nearest to `target` that the registers allow (VOL-13, VOL-50).
pub fn within_limits(regs: &Image, target: u16) -> u16 {
    target.max(regs.get(ZONE_TEMPERATURE_MIN)).min(regs.get(ZONE_TEMPERATURE_MAX))
}

fn round_down(txn: &mut Txn, point: Point<u16>, step: u16) {
    if let Some(value) = txn.sent(point) {
        txn.set(point, value - value % step);
    }
}

/// The value that a write sends to a point, before rounding, or the one that stays there.
fn as_sent<T: Value>(txn: &Txn, point: Point<T>) -> T {
    txn.sent(point).unwrap_or_else(|| txn.get(point))
}

fn single_register_is_alone(txn: &Txn) -> bool {
    let single = |bank, addr| bank == Bank::Holding && addr <= NTC_1_CORRECT.addr();
    txn.origin != Origin::Bus || txn.writes.len() == 1 || !txn.writes.iter().any(|write| single(write.bank, write.addr))
}

fn correction_fits(txn: &Txn) -> bool {
    let most = Unit::of(txn.after).degrees().correction_max;
    txn.sent(NTC_1_CORRECT).is_none_or(|correction| (-most..=most).contains(&correction))
}

fn eco_fits(txn: &Txn) -> bool {
    let (least, most) = Unit::of(txn.after).degrees().eco;
    txn.sent(ZONE_TEMPERATURE_ECO).is_none_or(|eco| (least..=most).contains(&eco))
}

fn target_limits_fit(txn: &Txn) -> bool {
    if !txn.touches(ZONE_TEMPERATURE_MIN) && !txn.touches(ZONE_TEMPERATURE_MAX) {
        return true;
    }
    let degrees = Unit::of(txn.after).degrees();
    let (min, max) = (as_sent(txn, ZONE_TEMPERATURE_MIN), as_sent(txn, ZONE_TEMPERATURE_MAX));
    min >= degrees.target.0 && max <= degrees.target.1 && max >= min.saturating_add(degrees.gap)
}

fn target_fits(txn: &Txn) -> bool {
    let (min, max) = (as_sent(txn, ZONE_TEMPERATURE_MIN), as_sent(txn, ZONE_TEMPERATURE_MAX));
    txn.sent(ZONE_TEMPERATURE_TARGET).is_none_or(|target| min <= target && target <= max)
}

fn periods_are_in_order(txn: &Txn) -> bool {
    let mut written = PERIODS.into_iter().flatten().filter(|(start, stop)| txn.touches(*start) || txn.touches(*stop));
    written.all(|(start, stop)| txn.get(start) < txn.get(stop))
}

fn day_exists(txn: &Txn) -> bool {
    let last = days_in_month(txn.get(RTC_YEAR), txn.get(RTC_MONTH));
    txn.sent(RTC_DAY).is_none_or(|day| day <= last)
}

fn mode_is_available(txn: &Txn) -> bool {
    !txn.touches(ZONE_MODE) || is_available(txn.after)
}

/// Whether the mode that is set is one that the installation has (VOL-42).
pub fn is_available(regs: &Image) -> bool {
    let mode_bit = if regs.get(ZONE_MODE) == 0 { 1 } else { 2 };
    regs.get(ZONE_AVAILABLE_MODE) & mode_bit != 0
}
