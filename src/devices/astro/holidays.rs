//! The holiday of one relay (ASTRO-40 … ASTRO-42). Knows its registers and local times, no programs.

use chrono::{NaiveDate, NaiveDateTime, NaiveTime, TimeDelta};
use serde::{Deserialize, Serialize};

use super::clock::SECOND;
use super::map::Side;
use crate::image::Image;
use crate::map::Point;

/// State of a holiday that is off or over.
pub const OFF: u16 = 0;
/// State of a holiday that is still to come.
pub const AHEAD: u16 = 1;
/// State of a holiday that is on.
pub const ON: u16 = 2;

/// Holidays that are remembered for the events in them; the oldest is forgotten first.
const PAST_MAX: usize = 32;

/// What a relay remembers of its holidays beside their registers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Holiday {
    /// Local time at which the one in the registers was written.
    since: NaiveDateTime,
    /// Times in which events count as not happened, although the holiday is over (ASTRO-42).
    past: Vec<Span>,
}

/// A time from its first moment up to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Span {
    from: NaiveDateTime,
    to: NaiveDateTime,
}

impl Default for Holiday {
    fn default() -> Self {
        Self { since: crate::time::earliest(), past: Vec::new() }
    }
}

/// First and last date in the registers; `None` where they hold a date that does not exist.
fn dates(regs: &Image, side: &Side) -> Option<(NaiveDate, NaiveDate)> {
    let date = |points: [Point<u16>; 3]| {
        let [year, month, day] = points.map(|point| regs.get(point));
        NaiveDate::from_ymd_opt(2000 + i32::from(year), month.into(), day.into())
    };
    Some((date(side.start)?, date(side.end)?))
}

/// Whether a write carries a register of the holiday.
pub fn is_touched(side: &Side, touches: impl Fn(Point<u16>) -> bool) -> bool {
    touches(side.holiday) || side.start.iter().chain(&side.end).any(|point| touches(*point))
}

impl Holiday {
    /// The time that the holiday in the registers takes up, from when it was written.
    fn span(&self, regs: &Image, side: &Side) -> Option<Span> {
        let (start, end) = dates(regs, side)?;
        let start = start.and_time(NaiveTime::MIN).max(self.since);
        Some(Span { from: start, to: (end + TimeDelta::days(1)).and_time(NaiveTime::MIN) })
    }

    /// The state follows the clock's date (ASTRO-40). `reached` is the latest time whose events have happened. Tells
    /// whether anything has changed.
    pub fn follow(&mut self, regs: &mut Image, side: &Side, date: NaiveDate, reached: NaiveDateTime) -> bool {
        let was = regs.get(side.holiday);
        let Some((start, end)) = dates(regs, side).filter(|_| was != OFF) else { return false };
        let state = match () {
            () if date < start => AHEAD,
            () if date > end => OFF,
            () => ON,
        };
        if state == was {
            return false;
        }
        if state != ON {
            let span = self.span(regs, side);
            self.remember(span, reached);
        }
        regs.set(side.holiday, state);
        true
    }

    /// The running clock went from 2099 to 2000 (ASTRO-14): a holiday that is on is over, and what was is long ago.
    pub fn century_over(&mut self, regs: &mut Image, side: &Side, local: NaiveDateTime) {
        if regs.get(side.holiday) == ON {
            regs.set(side.holiday, OFF);
        }
        self.clock_set(local);
    }

    /// The registers have been written; `before` is what they were, `reached` the latest time whose events have happened.
    pub fn written(&mut self, before: &Image, side: &Side, reached: NaiveDateTime) {
        if before.get(side.holiday) == ON {
            let span = self.span(before, side);
            self.remember(span, reached);
        }
        self.since = reached;
    }

    fn remember(&mut self, span: Option<Span>, reached: NaiveDateTime) {
        let Some(span) = span.map(|span| Span { to: span.to.min(reached + SECOND), ..span }) else { return };
        if span.from >= span.to {
            return;
        }
        if self.past.len() == PAST_MAX {
            self.past.remove(0);
        }
        self.past.push(span);
    }

    /// The clock was put to `local`: what lies ahead of it has not been.
    pub fn clock_set(&mut self, local: NaiveDateTime) {
        self.since = self.since.min(local);
        for span in &mut self.past {
            span.to = span.to.min(local);
        }
        self.past.retain(|span| span.from < span.to);
    }

    /// Whether an event at this time has happened (ASTRO-42).
    pub fn spares(&self, at: NaiveDateTime) -> bool {
        !self.past.iter().any(|span| span.from <= at && at < span.to)
    }
}
