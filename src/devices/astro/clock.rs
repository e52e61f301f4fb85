//! The battery-backed clock (ASTRO-10 … ASTRO-14, ASTRO-23, ASTRO-82): the simulation's civil time, what the user has set
//! it to and what the seasons have moved it by. Knows when seasons change, not what happens then.

use chrono::{NaiveDateTime, TimeDelta};
use serde::{Deserialize, Serialize};

use super::dst::{Change, HOUR, Seasons};
use crate::time::{civil_difference_us, civil_plus_us, earliest, into_century};

/// Shifts that are remembered one by one; older ones count as set.
const SHIFTS_MAX: usize = 16;

/// A second.
pub const SECOND: TimeDelta = TimeDelta::seconds(1);

/// What survives a restart of the program (ASTRO-82, BUS-22).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setting {
    /// What the user has set the clock to, as microseconds ahead of the simulation's clock.
    difference_us: i64,
    /// What the seasons have moved it by since.
    shifts: Vec<Shift>,
    /// The end of a skipped hour that the clock runs through all the same: it or the rules were set so.
    #[serde(default)]
    lived_skip: Option<NaiveDateTime>,
}

/// A change of season that the running clock has come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Shift {
    /// The simulation's clock at that moment.
    at: NaiveDateTime,
    /// Whether it went forward.
    forward: bool,
}

impl Shift {
    fn us(self) -> i64 {
        let hour_us = HOUR.num_seconds() * crate::time::SECOND_US;
        if self.forward { hour_us } else { -hour_us }
    }
}

/// The clock.
#[derive(Clone, Debug)]
pub struct Clock {
    setting: Setting,
    /// The simulation's clock up to which this one has run.
    civil: NaiveDateTime,
    is_summer: bool,
}

impl Default for Clock {
    fn default() -> Self {
        Self { setting: Setting::default(), civil: earliest(), is_summer: false }
    }
}

impl Clock {
    /// A clock that goes on from what was kept.
    pub fn kept(setting: Setting) -> Self {
        Self { setting, ..Self::default() }
    }

    /// What is to be kept.
    pub fn setting(&self) -> &Setting {
        &self.setting
    }

    /// Local date and time; after 2099 comes 2000 (ASTRO-14).
    pub fn local(&self) -> NaiveDateTime {
        let shifts: i64 = self.setting.shifts.iter().map(|shift| shift.us()).sum();
        into_century(civil_plus_us(self.civil, self.setting.difference_us.saturating_add(shifts)))
    }

    /// The simulation's clock up to which it has run.
    pub fn civil(&self) -> NaiveDateTime {
        self.civil
    }

    /// The latest local time whose events have happened. In the hour that autumn repeats they all have (ASTRO-60).
    pub fn reached(&self) -> NaiveDateTime {
        let left = self.repeat_left();
        if left > TimeDelta::zero() { self.local() + left - SECOND } else { self.local() }
    }

    /// How much of an hour that it shows for the second time is left.
    fn repeat_left(&self) -> TimeDelta {
        match self.setting.shifts.last() {
            Some(shift) if !shift.forward => (HOUR - (self.civil - shift.at)).max(TimeDelta::zero()),
            _ => TimeDelta::zero(),
        }
    }

    /// Whether it shows summer time (ASTRO-23).
    pub fn is_summer(&self) -> bool {
        self.is_summer
    }

    /// The end of a skipped hour that the clock runs through all the same.
    pub fn lived_skip(&self) -> Option<NaiveDateTime> {
        self.setting.lived_skip
    }

    /// The simulation's clock when this one will show `local`, if no season changes on the way.
    pub fn civil_at(&self, local: NaiveDateTime) -> NaiveDateTime {
        self.civil + (local - self.local())
    }

    /// Runs on, through no change of season.
    pub fn run_to(&mut self, civil: NaiveDateTime) {
        self.civil = civil;
    }

    /// Goes forward or back at a change that it has reached (ASTRO-20).
    pub fn change_season(&mut self, change: Change) {
        self.is_summer = change.to_summer;
        if self.setting.shifts.len() >= SHIFTS_MAX {
            let oldest = self.setting.shifts.remove(0);
            self.setting.difference_us = self.setting.difference_us.saturating_add(oldest.us());
        }
        self.setting.shifts.push(Shift { at: self.civil, forward: change.to_summer });
    }

    /// Is set by the user.
    pub fn set(&mut self, local: NaiveDateTime, seasons: &Seasons) {
        self.setting = Setting { difference_us: civil_difference_us(local, self.civil), ..Setting::default() };
        self.judge_season(seasons);
    }

    /// The simulation's clock stands at `civil`, and nobody watched it get there: a start or a jump. The clock is not
    /// shifted (ASTRO-23), and a shift that lies ahead of the simulation's clock is still to come. Tells whether what is to
    /// be kept has changed.
    pub fn resume(&mut self, civil: NaiveDateTime, seasons: impl Fn(NaiveDateTime) -> Seasons) -> bool {
        self.civil = civil;
        let before = self.setting.clone();
        self.setting.shifts.retain(|shift| shift.at <= civil);
        let local = self.local();
        // An hour that was run through stays so, and one that lies ahead again is to be skipped.
        self.setting.lived_skip = self.setting.lived_skip.filter(|end| *end <= local);
        self.judge_season(&seasons(local));
        self.setting != before
    }

    /// Takes the season from the rules, and moves nothing (ASTRO-23).
    pub fn judge_season(&mut self, seasons: &Seasons) {
        let local = self.local();
        // Having gone back in this hour, it does not go back again.
        let went_back = self.repeat_left() > TimeDelta::zero() && seasons.is_repeated(local);
        self.is_summer = !went_back && seasons.is_summer(local);
        self.setting.lived_skip = seasons.skipped_to(local).or(self.setting.lived_skip);
    }
}
