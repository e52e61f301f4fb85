//! When programs fire (ASTRO-60) and which of them put a relay where it is (ASTRO-52): a list of events for every date that
//! is asked about, made once. Knows dates and local times, not the running clock.

use std::collections::BTreeMap;

use chrono::{Datelike, NaiveDate, NaiveDateTime, NaiveTime, TimeDelta};

use super::clock::SECOND;
use super::dst::{HOUR, Rules, Seasons};
use super::programs::{ASTRO, ON, Program, RELAY_A, SUNRISE, Slots};
use super::sun::{Place, Sun, standard};

/// How far back an event still counts (ASTRO-52).
const MEMORY: TimeDelta = TimeDelta::days(7);

/// Dates that are kept; asking about one more drops those before its week.
const DATES_MAX: usize = 24;

const MINUTES_A_DAY: i32 = 1440;

/// A program that fires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The local time that the clock then shows.
    pub at: NaiveDateTime,
    /// The program's slot.
    slot: usize,
    /// 0 for relay A, 1 for relay B.
    pub side: usize,
    /// The relay's position from then on.
    pub is_on: bool,
}

impl Event {
    /// The first local time at which it lies too far back to count.
    pub fn forgotten_at(&self) -> NaiveDateTime {
        self.at + MEMORY + SECOND
    }
}

/// What the times of programs depend on beside the programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Basis {
    /// Where sun rises and sets.
    pub place: Place,
    /// When seasons change.
    pub rules: Rules,
    /// The end of a skipped hour that the clock runs through all the same.
    pub lived_skip: Option<NaiveDateTime>,
}

/// The events of the dates that have been asked about.
#[derive(Clone, Debug)]
pub struct Agenda {
    basis: Basis,
    suns: BTreeMap<NaiveDate, Sun>,
    days: BTreeMap<NaiveDate, Vec<Event>>,
}

impl Agenda {
    /// An empty agenda.
    pub fn new(basis: Basis) -> Self {
        Self { basis, suns: BTreeMap::new(), days: BTreeMap::new() }
    }

    /// Forgets what no longer holds.
    pub fn rest_on(&mut self, basis: Basis) {
        if self.basis == basis {
            return;
        }
        if self.basis.place != basis.place {
            self.suns.clear();
        }
        self.days.clear();
        self.basis = basis;
    }

    /// The programs have changed.
    pub fn programs_changed(&mut self) {
        self.days.clear();
    }

    /// Sunrise and sunset of a date in minutes of the local time that the clock shows when they happen, modulo a day
    /// (ASTRO-33).
    pub fn sun(&mut self, date: NaiveDate) -> Sun {
        let seasons = self.basis.rules.around(date.year());
        self.sun_in(date, &seasons)
    }

    fn sun_in(&mut self, date: NaiveDate, seasons: &Seasons) -> Sun {
        trim(&mut self.suns, date);
        let sun = *self.suns.entry(date).or_insert_with(|| self.basis.place.sun(date));
        let local = |minutes: i32| {
            let summer =
                if seasons.is_summer_at_standard(standard(date, minutes)) { HOUR.num_minutes() as i32 } else { 0 };
            (minutes + summer).rem_euclid(MINUTES_A_DAY)
        };
        Sun { rise: sun.rise.map(local), set: sun.set.map(local) }
    }

    /// The events whose time is on a date, in order; of two at the same second the higher slot comes later.
    fn day(&mut self, date: NaiveDate, slots: &Slots) -> &[Event] {
        trim(&mut self.days, date);
        if !self.days.contains_key(&date) {
            let events = self.events_of(date, slots);
            self.days.insert(date, events);
        }
        self.days.get(&date).map_or(&[], Vec::as_slice)
    }

    fn events_of(&mut self, date: NaiveDate, slots: &Slots) -> Vec<Event> {
        let seasons = self.basis.rules.around(date.year());
        let mut events = Vec::new();
        // An offset can carry an event into the next date or into the one before.
        for day in [date.pred_opt(), Some(date), date.succ_opt()].into_iter().flatten() {
            let active: Vec<(usize, Program)> = (slots.all().iter().copied().enumerate())
                .filter_map(|(slot, program)| Some((slot, program.filter(|program| program.is_active(day))?)))
                .collect();
            // The sun is worked out for those who ask for it only.
            let needs_sun = active.iter().any(|(_, program)| program.has(ASTRO));
            let sun = if needs_sun { self.sun_in(day, &seasons) } else { Sun::default() };
            for (slot, program) in active {
                let Some(time) = time_of(&program, day, sun) else { continue };
                let at = match seasons.skipped_to(time) {
                    // It fires at the jump, when the clock shows the end of the hour that it skips (ASTRO-60).
                    Some(end) if self.basis.lived_skip != Some(end) => end,
                    _ => time,
                };
                let side = if program.has(RELAY_A) { 0 } else { 1 };
                events.push(Event { at, slot, side, is_on: program.has(ON) });
            }
        }
        events.retain(|event| event.at.date() == date);
        events.sort_by_key(|event| (event.at, event.slot));
        events
    }

    /// The next time on `date` behind `reached` at which a program fires.
    pub fn next(&mut self, date: NaiveDate, reached: NaiveDateTime, slots: &Slots) -> Option<NaiveDateTime> {
        let day = self.day(date, slots);
        day.get(day.partition_point(|event| event.at <= reached)).map(|event| event.at)
    }

    /// The relays whose programs fire at a time.
    pub fn fires(&mut self, at: NaiveDateTime, slots: &Slots) -> [bool; 2] {
        let day = self.day(at.date(), slots);
        let first = day.partition_point(|event| event.at < at);
        let now = day[first..].iter().take_while(|event| event.at == at);
        now.fold([false; 2], |mut sides, event| {
            sides[event.side] = true;
            sides
        })
    }

    /// The event that puts a relay where it is at `reached`: the most recent one, at most seven days back, that counts
    /// (ASTRO-52).
    pub fn last(
        &mut self,
        side: usize,
        reached: NaiveDateTime,
        slots: &Slots,
        counts: impl Fn(NaiveDateTime) -> bool,
    ) -> Option<Event> {
        let mut date = Some(reached.date());
        for _ in 0..=MEMORY.num_days() {
            let day = self.day(date?, slots);
            let due = day[..day.partition_point(|event| event.at <= reached)].iter();
            let last = due.rev().find(|event| event.side == side && counts(event.at));
            if let Some(event) = last {
                return (reached < event.forgotten_at()).then_some(*event);
            }
            date = date?.pred_opt();
        }
        None
    }
}

/// When a program of a day fires by the clock, should no season change; an astro program on a date without its sunrise or
/// sunset does not (ASTRO-34).
fn time_of(program: &Program, day: NaiveDate, sun: Sun) -> Option<NaiveDateTime> {
    if program.has(ASTRO) {
        let minutes = if program.has(SUNRISE) { sun.rise } else { sun.set }?;
        return Some(standard(day, minutes + i32::from(program.offset_minutes)));
    }
    let time = NaiveTime::from_hms_opt(program.hour.into(), program.minute.into(), program.second.into())?;
    Some(day.and_time(time))
}

/// Keeps a cache small: drops what lies before the week that ends at `date`, or all where that does not help.
fn trim<T>(cache: &mut BTreeMap<NaiveDate, T>, date: NaiveDate) {
    if cache.len() < DATES_MAX {
        return;
    }
    let week = date - MEMORY - TimeDelta::days(2);
    cache.retain(|kept, _| *kept >= week && *kept <= date);
    if cache.len() >= DATES_MAX {
        cache.clear();
    }
}
