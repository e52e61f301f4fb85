//! The two readings of time that a device is handed (BUS-18), and the clock that makes them.
//!
//! *Elapsed* time runs like real time whatever the rate and drives protocol delays only. *Simulated* time has a
//! start, a rate, can stand still and be moved; it comes as civil time for calendars and as a running count, which a
//! jump of the civil clock does not move, for physics. Nothing here reads the host's clock.

use chrono::{NaiveDate, NaiveDateTime, TimeDelta};

/// Microseconds in a second.
pub const SECOND_US: i64 = 1_000_000;

/// Elapsed time in microseconds since the program started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant(pub u64);

impl Instant {
    /// This instant and `ms` milliseconds.
    pub fn plus_ms(self, ms: u64) -> Self {
        self.plus_us(ms.saturating_mul(1000))
    }

    /// This instant and `us` microseconds.
    pub fn plus_us(self, us: u64) -> Self {
        Self(self.0.saturating_add(us))
    }

    /// Microseconds from `earlier` to this instant, 0 when it lies ahead.
    pub fn since_us(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

/// All readings of one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Real time since the start of the program.
    pub elapsed: Instant,
    /// Simulated time that has been lived through, in microseconds: monotonic, runs at the rate, unmoved by jumps.
    pub running_us: i64,
    /// Simulated local date and time: what a perfect clock on the wall shows; moved by jumps.
    pub civil: NaiveDateTime,
}

/// The simulation's clock: maps elapsed time to the simulated readings.
///
/// A plain value: every bus holds a copy and is told of changes, so nobody shares it.
#[derive(Clone, Debug, PartialEq)]
pub struct SimClock {
    anchor: Moment,
    rate: f64,
}

/// The first civil time that the simulation can show.
pub fn earliest() -> NaiveDateTime {
    civil(2000, 1, 1, 0, 0, 0)
}

/// The civil time that the simulation cannot reach.
pub fn latest() -> NaiveDateTime {
    civil(2100, 1, 1, 0, 0, 0)
}

/// A civil date and time from its numbers; a date that does not exist gives the start of 2000.
pub fn civil(year: i32, month: u32, day: u32, hour: u32, minute: u32, second: u32) -> NaiveDateTime {
    NaiveDate::from_ymd_opt(year, month, day)
        .and_then(|date| date.and_hms_opt(hour, minute, second))
        .unwrap_or_default()
}

/// The civil time `us` microseconds after `time`; far beyond the calendar it stays where it is.
pub fn civil_plus_us(time: NaiveDateTime, us: i64) -> NaiveDateTime {
    time.checked_add_signed(TimeDelta::microseconds(us)).unwrap_or(time)
}

/// Microseconds from `earlier` to `later`, negative when it lies behind.
pub fn civil_difference_us(later: NaiveDateTime, earlier: NaiveDateTime) -> i64 {
    (later - earlier).num_microseconds().unwrap_or(0)
}

/// Folds a civil time into 2000-01-01 … 2099-12-31, the century that the devices' clocks know (ASTRO-14).
pub fn into_century(time: NaiveDateTime) -> NaiveDateTime {
    let span_us = civil_difference_us(latest(), earliest());
    civil_plus_us(earliest(), civil_difference_us(time, earliest()).rem_euclid(span_us))
}

impl SimClock {
    /// The largest rate: a day a second.
    pub const RATE_MAX: f64 = 86_400.0;

    /// A clock that shows `start` at elapsed time 0 and runs `rate` simulated seconds a real second.
    pub fn new(start: NaiveDateTime, rate: f64) -> Self {
        let anchor = Moment { elapsed: Instant(0), running_us: 0, civil: start };
        Self { anchor, rate: rate.clamp(0.0, Self::RATE_MAX) }
    }

    /// A clock that shows the readings of `anchor` at its elapsed time, and runs on from there.
    pub fn anchored(anchor: Moment, rate: f64) -> Self {
        Self { anchor, rate: rate.clamp(0.0, Self::RATE_MAX) }
    }

    /// Simulated seconds a real second; 0 stands still.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// All readings at an elapsed time; before the last change of the clock, those of that change.
    pub fn at(&self, elapsed: Instant) -> Moment {
        let real_us = elapsed.since_us(self.anchor.elapsed);
        let us = (real_us as f64 * self.rate) as i64;
        Moment {
            elapsed: elapsed.max(self.anchor.elapsed),
            running_us: self.anchor.running_us.saturating_add(us),
            civil: civil_plus_us(self.anchor.civil, us),
        }
    }

    /// The first elapsed time at which `running_us` is reached; `None` while the clock stands still.
    pub fn when(&self, running_us: i64) -> Option<Instant> {
        let ahead = running_us - self.anchor.running_us;
        if ahead <= 0 {
            return Some(self.anchor.elapsed);
        }
        (self.rate > 0.0).then(|| self.anchor.elapsed.plus_us((ahead as f64 / self.rate).ceil() as u64))
    }

    /// From `now` on the clock runs at `rate`.
    pub fn set_rate(&mut self, now: Instant, rate: f64) {
        self.anchor = self.at(now);
        self.rate = rate.clamp(0.0, Self::RATE_MAX);
    }

    /// Moves the civil time to `civil`; nothing happens in between.
    pub fn jump(&mut self, now: Instant, civil: NaiveDateTime) {
        self.anchor = Moment { civil, ..self.at(now) };
    }

    /// Lets `us` simulated microseconds pass at once.
    pub fn advance(&mut self, now: Instant, us: i64) {
        let at = self.at(now);
        self.anchor = Moment { running_us: at.running_us.saturating_add(us), civil: civil_plus_us(at.civil, us), ..at };
    }
}
