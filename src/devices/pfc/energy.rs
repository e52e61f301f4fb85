//! Meters: energies and hours, added up exactly in whole numbers, and the calendar by which the energies start anew
//! (PFC-14, PFC-15).

use chrono::{Datelike, Days, Months, NaiveDate, NaiveDateTime, NaiveTime};
use serde::{Deserialize, Serialize};

use super::map::{
    ACTIVE_ENERGY_TOTAL, CAPACITIVE_ENERGY_RATIO, CAPACITIVE_ENERGY_RATIO_WHOLE, CAPACITIVE_ENERGY_TOTAL,
    INDUCTIVE_ENERGY_RATIO, INDUCTIVE_ENERGY_TOTAL, STEP_N_HOURS_IN, STEPS,
};
use crate::image::Image;
use crate::map::{Point, UnsignedWholeAndDecimals};

/// Decimal digits in which a meter counts; no option asks for more.
const METER_DIGITS: u8 = 4;

/// Microseconds in an hour: a milliwatt hour is that many milliwatt microseconds.
const HOUR_US: u64 = 3_600_000_000;

/// Milliwatts for a microsecond that make up the last digit of an energy, 0.0001 kWh or kvarh.
pub const ENERGY_TICKS: u64 = 100 * HOUR_US;

/// Microseconds that make up the last digit of an hour.
pub const HOUR_TICKS: u64 = HOUR_US / 10_000;

/// A count that only grows, exact however its time is cut into pieces. `TICKS` of what is added make up its last digit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meter<const TICKS: u64> {
    /// Counts of the last of [`METER_DIGITS`] digits.
    count: u64,
    /// Ticks beyond them.
    ticks: u64,
    /// The number that its register was last given, so that one put there past the device is noticed.
    #[serde(skip)]
    shown: u64,
}

impl<const TICKS: u64> Meter<TICKS> {
    /// Adds `rate` ticks a microsecond for `us` microseconds.
    pub fn run(&mut self, rate: u64, us: u64) {
        let ticks = u128::from(self.ticks) + u128::from(rate) * u128::from(us);
        self.count = self.count.wrapping_add((ticks / u128::from(TICKS)) as u64);
        self.ticks = (ticks % u128::from(TICKS)) as u64;
    }

    fn total(&self) -> u128 {
        u128::from(self.count) * u128::from(TICKS) + u128::from(self.ticks)
    }

    /// Puts it into its register; beyond 65535 and its decimals the display starts anew.
    fn show(&mut self, point: Point<UnsignedWholeAndDecimals>, digits: u8, regs: &mut Image) {
        self.shown = self.count / last_digit(digits) % (65_536 * 10_u64.pow(u32::from(digits)));
        regs.set(point, pair(self.shown, digits));
    }

    /// Takes over a number that was put into its register past the device.
    fn adopt(&mut self, point: Point<UnsignedWholeAndDecimals>, digits: u8, regs: &Image) {
        let pair = regs.get(point);
        let raw = u64::from(pair.whole) * 10_u64.pow(u32::from(digits)) + u64::from(pair.decimals);
        if raw != self.shown {
            *self = Self { count: raw * last_digit(digits), ticks: 0, shown: raw };
        }
    }
}

/// How many counts of a meter make up the last digit displayed.
fn last_digit(digits: u8) -> u64 {
    10_u64.pow(u32::from(METER_DIGITS.saturating_sub(digits)))
}

fn pair(raw: u64, digits: u8) -> UnsignedWholeAndDecimals {
    let unit = 10_u64.pow(u32::from(digits));
    UnsignedWholeAndDecimals { whole: (raw / unit) as u16, decimals: (raw % unit) as u16 }
}

type Energy = Meter<ENERGY_TICKS>;

/// All meters of the relay.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meters {
    active: Energy,
    inductive: Energy,
    capacitive: Energy,
    hours: [Meter<HOUR_TICKS>; STEPS],
}

/// Powers as the meters count them, in milliwatts and millivars.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rates {
    active: u64,
    inductive: u64,
    capacitive: u64,
}

impl Rates {
    /// The rates of total powers. Active power that is fed back is no consumption and counts nothing.
    pub fn of(active_kw: f64, reactive_kvar: f64) -> Self {
        // A float that is negative becomes 0.
        let milli = |kilo: f64| (kilo * 1e6).round() as u64;
        Self { active: milli(active_kw), inductive: milli(reactive_kvar), capacitive: milli(-reactive_kvar) }
    }
}

impl Meters {
    /// Lets time pass at constant powers with these steps in.
    pub fn run(&mut self, rates: &Rates, connected: &[bool; STEPS], us: u64) {
        self.active.run(rates.active, us);
        self.inductive.run(rates.inductive, us);
        self.capacitive.run(rates.capacitive, us);
        for (hours, _) in self.hours.iter_mut().zip(connected).filter(|(_, is_in)| **is_in) {
            hours.run(1, us);
        }
    }

    /// The energies start anew.
    pub fn reset_energies(&mut self) {
        (self.active, self.inductive, self.capacitive) = Default::default();
    }

    /// Puts all meters and the ratios into their registers.
    pub fn show(&mut self, digits: u8, regs: &mut Image) {
        self.active.show(ACTIVE_ENERGY_TOTAL, digits, regs);
        self.inductive.show(INDUCTIVE_ENERGY_TOTAL, digits, regs);
        self.capacitive.show(CAPACITIVE_ENERGY_TOTAL, digits, regs);
        for (step, hours) in self.hours.iter_mut().enumerate() {
            hours.show(STEP_N_HOURS_IN.nth(step), digits, regs);
        }
        regs.set(INDUCTIVE_ENERGY_RATIO, self.ratio(&self.inductive, digits));
        let capacitive = self.ratio(&self.capacitive, digits);
        regs.set(CAPACITIVE_ENERGY_RATIO, capacitive);
        regs.set(CAPACITIVE_ENERGY_RATIO_WHOLE, capacitive.whole);
    }

    /// Takes over what was put into the meters' registers past the device.
    pub fn adopt(&mut self, digits: u8, regs: &Image) {
        self.active.adopt(ACTIVE_ENERGY_TOTAL, digits, regs);
        self.inductive.adopt(INDUCTIVE_ENERGY_TOTAL, digits, regs);
        self.capacitive.adopt(CAPACITIVE_ENERGY_TOTAL, digits, regs);
        for (step, hours) in self.hours.iter_mut().enumerate() {
            hours.adopt(STEP_N_HOURS_IN.nth(step), digits, regs);
        }
    }

    /// Reactive energy in % of the active energy, 0 while that is 0; more than fits stands at the end of its register.
    fn ratio(&self, reactive: &Energy, digits: u8) -> UnsignedWholeAndDecimals {
        let active = self.active.total();
        if active == 0 {
            return UnsignedWholeAndDecimals::default();
        }
        let unit = 10_u128.pow(u32::from(digits));
        let raw = reactive.total().saturating_mul(100 * unit).saturating_add(active / 2) / active;
        pair(raw.min(65_536 * unit - 1) as u64, digits)
    }
}

/// How often the energies start anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ResetPeriod {
    /// Never.
    #[default]
    Never,
    /// Every so many days.
    Days(u16),
    /// Every so many months.
    Months(u16),
    /// Every so many years.
    Years(u16),
}

impl ResetPeriod {
    /// The period that registers stand for.
    pub fn new(period: u16, unit: u16) -> Self {
        match (period, unit) {
            (0, _) => Self::Never,
            (days, 0) => Self::Days(days),
            (months, 1) => Self::Months(months),
            (years, _) => Self::Years(years),
        }
    }

    /// The first midnight of the n-th day, month or year after the last reset; where the clock was past it before the
    /// relay could see it, the next midnight (PFC-15).
    pub fn due(self, last: NaiveDateTime, now: NaiveDateTime) -> Option<NaiveDateTime> {
        let day = last.date();
        let due = match self {
            Self::Never => return None,
            Self::Days(days) => day.checked_add_days(Days::new(u64::from(days))),
            Self::Months(months) => day.with_day(1)?.checked_add_months(Months::new(u32::from(months))),
            Self::Years(years) => NaiveDate::from_ymd_opt(day.year() + i32::from(years), 1, 1),
        };
        let due = due?.and_time(NaiveTime::MIN);
        if due > now { Some(due) } else { Some(now.date().succ_opt()?.and_time(NaiveTime::MIN)) }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[track_caller]
    fn check_due(period: u16, unit: u16, last: &str, now: &str, due: Option<&str>) {
        let due = due.map(|due| due.parse().unwrap());
        assert_eq!(ResetPeriod::new(period, unit).due(last.parse().unwrap(), now.parse().unwrap()), due);
    }

    #[test]
    fn pfc_15_the_energies_start_anew_at_the_first_midnight_of_the_nth_day_month_or_year() {
        let (last, now) = ("2014-10-27T14:22:08", "2014-10-27T15:00:00");
        check_due(0, 0, last, now, None);
        check_due(1, 0, last, now, Some("2014-10-28T00:00:00"));
        check_due(5, 0, last, now, Some("2014-11-01T00:00:00"));
        check_due(1, 1, last, now, Some("2014-11-01T00:00:00"));
        check_due(3, 1, last, now, Some("2015-01-01T00:00:00"));
        check_due(2, 2, last, now, Some("2016-01-01T00:00:00"));
        check_due(1, 1, "2015-01-31T00:00:00", "2015-01-31T00:00:00", Some("2015-02-01T00:00:00"));
    }

    #[test]
    fn pfc_15_a_reset_that_was_missed_comes_at_the_next_midnight() {
        check_due(1, 0, "2014-10-27T14:22:08", "2014-10-30T12:00:00", Some("2014-10-31T00:00:00"));
        check_due(1, 0, "2014-10-27T14:22:08", "2014-10-28T00:00:00", Some("2014-10-29T00:00:00"));
    }

    #[test]
    fn pfc_15_energy_adds_up_exactly_however_the_time_is_cut() {
        // 12.345678 kW for an hour and a microsecond's share of it a million times over.
        let mut whole = Energy::default();
        whole.run(12_345_678, HOUR_US);
        let mut pieces = Energy::default();
        for _ in 0..1_000_000 {
            pieces.run(12_345_678, HOUR_US / 1_000_000);
        }
        assert_eq!(whole, pieces);
        assert_eq!(whole.count, 123_456, "12.3456 kWh, and the rest in ticks");
        assert_eq!(whole.ticks, 78 * HOUR_US, "0.000078 kWh are 78 milliwatt hours");
    }
}
