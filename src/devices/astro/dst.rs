//! Summer time (ASTRO-20 … ASTRO-23): which moments of the clock change the season, and what that does to the times of a
//! day. Knows the rules and local times, not the running clock.

use chrono::{Datelike, NaiveDate, NaiveDateTime, TimeDelta};

use super::map::{
    DST_MODE, SUMMER_HOUR, SUMMER_MINUTE, SUMMER_MONTH, SUMMER_WEEK, SUMMER_WEEKDAY, WINTER_HOUR, WINTER_MINUTE,
    WINTER_MONTH, WINTER_WEEK, WINTER_WEEKDAY,
};
use crate::image::{Image, Txn};
use crate::map::Point;

/// How far the clock moves when the season changes.
pub const HOUR: TimeDelta = TimeDelta::hours(1);

/// The registers of the summer instant: month, week, weekday, hour, minute.
const SUMMER: [Point<u16>; 5] = [SUMMER_MONTH, SUMMER_WEEK, SUMMER_WEEKDAY, SUMMER_HOUR, SUMMER_MINUTE];
/// The registers of the winter instant.
const WINTER: [Point<u16>; 5] = [WINTER_MONTH, WINTER_WEEK, WINTER_WEEKDAY, WINTER_HOUR, WINTER_MINUTE];
/// What automatic mode has in them.
const AUTOMATIC: [(Point<u16>, u16); 10] = [
    (SUMMER_MONTH, 3),
    (SUMMER_WEEK, 5),
    (SUMMER_WEEKDAY, 7),
    (SUMMER_HOUR, 3),
    (SUMMER_MINUTE, 0),
    (WINTER_MONTH, 10),
    (WINTER_WEEK, 5),
    (WINTER_WEEKDAY, 7),
    (WINTER_HOUR, 4),
    (WINTER_MINUTE, 0),
];

const MODE_AUTOMATIC: u16 = 1;
const MODE_CUSTOM: u16 = 2;

/// Whether a write carries a rule or the mode.
pub fn is_touched(touches: impl Fn(Point<u16>) -> bool) -> bool {
    touches(DST_MODE) || AUTOMATIC.iter().any(|(point, _)| touches(*point))
}

/// Mode and rules follow each other, as if the registers were written one by one (ASTRO-21, ASTRO-22).
pub fn stage(txn: &mut Txn) {
    if txn.sent(DST_MODE) == Some(MODE_AUTOMATIC) {
        for (point, value) in AUTOMATIC {
            if !txn.touches(point) {
                txn.set(point, value);
            }
        }
    }
    if AUTOMATIC.iter().any(|(point, _)| txn.touches(*point)) {
        txn.set(DST_MODE, MODE_CUSTOM);
    }
}

/// A moment of every year: the n-th such weekday of a month, at a time of the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Yearly {
    month: u32,
    week: u32,
    weekday: u32,
    hour: u32,
    minute: u32,
}

impl Yearly {
    fn read(regs: &Image, points: [Point<u16>; 5]) -> Self {
        let [month, week, weekday, hour, minute] = points.map(|point| u32::from(regs.get(point)));
        Self { month, week, weekday, hour, minute }
    }

    /// When it is in a year; `None` where a register holds what nobody may write.
    fn in_year(self, year: i32) -> Option<NaiveDateTime> {
        let first = NaiveDate::from_ymd_opt(year, self.month, 1)?;
        let to_weekday = (self.weekday + 7).checked_sub(first.weekday().number_from_monday())? % 7;
        let nth = |week: u32| NaiveDate::from_ymd_opt(year, self.month, 1 + to_weekday + 7 * week.checked_sub(1)?);
        // Week 5 is the last such weekday, and that may be the fourth (ASTRO-20).
        let date = nth(self.week).or_else(|| nth(self.week.checked_sub(1)?))?;
        date.and_hms_opt(self.hour, self.minute, 0)
    }
}

/// The rules as the registers hold them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rules {
    /// Summer and winter instant; `None` in mode 0.
    instants: Option<(Yearly, Yearly)>,
}

impl Rules {
    /// The rules in the registers.
    pub fn read(regs: &Image) -> Self {
        let instants = (regs.get(DST_MODE) != 0).then(|| (Yearly::read(regs, SUMMER), Yearly::read(regs, WINTER)));
        Self { instants }
    }

    /// The season's changes around a year.
    pub fn around(self, year: i32) -> Seasons {
        let mut seasons = Seasons { changes: Vec::with_capacity(6) };
        let Some((summer, winter)) = self.instants else { return seasons };
        let mut instants = Vec::with_capacity(6);
        for year in year - 1..=year + 1 {
            instants.extend(summer.in_year(year).map(|at| Change { at, to_summer: true }));
            instants.extend(winter.in_year(year).map(|at| Change { at, to_summer: false }));
        }
        instants.sort_by_key(|change| (change.at, !change.to_summer));
        for change in instants {
            match seasons.changes.last() {
                // Weeks counted from both ends of a month can bring the same instant twice in a row.
                Some(last) if last.to_summer == change.to_summer => {}
                // A summer that ends within the hour that its start skips is none: both changes cancel out.
                Some(last) if last.to_summer && change.at - last.at <= HOUR => {
                    seasons.changes.pop();
                }
                _ => seasons.changes.push(change),
            }
        }
        seasons
    }
}

/// A moment of the clock at which the season changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Local time that is reached, before the clock moves.
    pub at: NaiveDateTime,
    /// Whether summer begins and the clock goes forward.
    pub to_summer: bool,
}

/// The changes of a year and of its neighbours, in order and by turns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seasons {
    changes: Vec<Change>,
}

impl Seasons {
    /// Whether a local time that the clock is set to lies in summer: the hour that is skipped does, and so does the one
    /// that is repeated (ASTRO-23).
    pub fn is_summer(&self, local: NaiveDateTime) -> bool {
        self.last_to(|change| change.at <= local)
    }

    /// Whether it is summer at a moment given in standard time, the winter's.
    pub fn is_summer_at_standard(&self, standard: NaiveDateTime) -> bool {
        self.last_to(|change| if change.to_summer { change.at <= standard } else { change.at - HOUR <= standard })
    }

    fn last_to(&self, has_come: impl Fn(&Change) -> bool) -> bool {
        match self.changes.iter().rev().find(|change| has_come(change)) {
            Some(change) => change.to_summer,
            None => self.changes.first().is_some_and(|first| !first.to_summer),
        }
    }

    /// The next change behind `local` for a clock that shows this season.
    pub fn next(&self, local: NaiveDateTime, is_summer: bool) -> Option<Change> {
        self.changes.iter().copied().find(|change| change.at > local && change.to_summer != is_summer)
    }

    /// Where `local` lies in the hour that spring skips: the time to which the clock jumps.
    pub fn skipped_to(&self, local: NaiveDateTime) -> Option<NaiveDateTime> {
        let skips = |change: &&Change| change.to_summer && change.at <= local && local < change.at + HOUR;
        self.changes.iter().find(skips).map(|change| change.at + HOUR)
    }

    /// Whether `local` lies in the hour that autumn repeats.
    pub fn is_repeated(&self, local: NaiveDateTime) -> bool {
        self.changes.iter().any(|change| !change.to_summer && change.at - HOUR <= local && local < change.at)
    }
}
