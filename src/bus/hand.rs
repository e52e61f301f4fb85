//! What a hand may do to a bus beside talking to it: change its devices and its clock, break it, keep it and bring it
//! back, and look into its journal.

use chrono::NaiveDateTime;

use super::journal::Journal;
use super::watch::Watch;
use super::{Bus, Counters, Output};
use crate::faults::{Fault, Faults};
use crate::station::{self, Station};
use crate::time::{Instant, Moment, SimClock, civil_difference_us};

/// A bus as it was: devices, EEPROM, inputs, faults and clock. Its journal and counts are no part of it.
#[derive(Clone, Debug)]
pub struct Snapshot {
    clock: SimClock,
    rate: f64,
    /// The stations' own elapsed time.
    now: Instant,
    lives: Vec<station::Live>,
    last_replies: Vec<Vec<u8>>,
    faults: Faults,
}

impl Bus {
    /// Lets a station be changed at `now`: it has lived up to it, and what the change leaves is handed out after it.
    pub fn with_station<R>(&mut self, now: Instant, index: usize, act: impl FnOnce(&mut Station, Moment) -> R) -> R {
        self.live_to(now);
        let segment = &mut self.segment;
        let moment = segment.clock.at(segment.now);
        let result = act(&mut segment.stations[index], moment);
        segment.stations[index].settle_restart(moment.elapsed);
        segment.persist_changed();
        segment.route();
        result
    }

    /// Lives up to `now` without waiting for a request: for what looks at the stations.
    pub fn live_to(&mut self, now: Instant) {
        self.segment.set_now(now);
        self.segment.live_to(self.segment.now);
    }

    /// From `now` on the clock runs at `rate` simulated seconds a real second.
    pub fn set_rate(&mut self, now: Instant, rate: f64) {
        self.live_to(now);
        self.segment.clock.set_rate(self.segment.now, rate);
    }

    /// Lets simulated time pass at once; everything in between happens, in order.
    pub fn advance_clock(&mut self, now: Instant, us: i64) {
        self.live_to(now);
        self.segment.clock.advance(self.segment.now, us);
        self.live_to(now);
    }

    /// Moves the civil clock; nothing happens in between.
    pub fn jump_clock(&mut self, now: Instant, civil: NaiveDateTime) {
        self.live_to(now);
        let segment = &mut self.segment;
        let before = segment.clock.at(segment.now);
        segment.clock.jump(segment.now, civil);
        let after = segment.clock.at(segment.now);
        let by_us = civil_difference_us(after.civil, before.civil);
        for station in &mut segment.stations {
            station.clock_jumped(by_us, after);
        }
        segment.persist_changed();
        segment.route();
    }

    /// Stops the clock until [`Bus::resume`], so that several buses can be brought to one moment; gives that at which it
    /// stands. [`Bus::rate`] goes on telling the rate that it will have again.
    pub fn hold(&mut self, now: Instant) -> Moment {
        let rate = self.rate();
        self.set_rate(now, 0.0);
        self.segment.held_rate = Some(rate);
        self.moment(now)
    }

    /// Brings a clock that is held to the moment `at`, which is not before its own: what lies between happens now.
    /// `at.elapsed` is not after `now`.
    pub fn align(&mut self, now: Instant, at: Moment) {
        self.anchor(now, at, 0.0);
    }

    /// Lets a clock that is held run again at `rate` from the moment `from`, as [`Bus::align`] does.
    pub fn resume(&mut self, now: Instant, from: Moment, rate: f64) {
        self.segment.held_rate = None;
        self.anchor(now, from, rate);
    }

    fn anchor(&mut self, now: Instant, from: Moment, rate: f64) {
        self.live_to(now);
        let segment = &mut self.segment;
        let behind_us = from.running_us - segment.clock.at(segment.now).running_us;
        if behind_us > 0 {
            segment.clock.advance(segment.now, behind_us);
            segment.live_to(segment.now);
        }
        let anchor = Moment { elapsed: segment.inner(from.elapsed), ..from };
        segment.clock = SimClock::anchored(anchor, rate);
        self.live_to(now);
    }

    /// Keeps everything as it is at `now`, with the rate that the clock has when it is not held.
    pub fn snapshot(&mut self, now: Instant) -> Snapshot {
        self.live_to(now);
        let segment = &self.segment;
        Snapshot {
            clock: segment.clock.clone(),
            rate: self.rate(),
            now: segment.now,
            lives: segment.stations.iter().map(Station::live).collect(),
            last_replies: segment.last_replies.clone(),
            faults: segment.faults.clone(),
        }
    }

    /// Brings a snapshot back, so that it is `now` what it was then, also for protocol delays; what was being answered is
    /// forgotten. A snapshot that was made while the clock was held is held again.
    pub fn restore(&mut self, now: Instant, snapshot: &Snapshot) {
        let segment = &mut self.segment;
        segment.set_now(now);
        let outer = segment.outer(segment.now);
        segment.clock = snapshot.clock.clone();
        segment.held_rate = (segment.clock.rate() != snapshot.rate).then_some(snapshot.rate);
        segment.skew_us = outer.since_us(snapshot.now);
        (segment.now, segment.lived_at, segment.saved_at) = (snapshot.now, snapshot.now, snapshot.now);
        segment.abandon("what was kept was brought back before the reply left", |_| true);
        segment.undo.clear();
        for (station, live) in segment.stations.iter_mut().zip(&snapshot.lives) {
            station.restore(live.clone());
        }
        segment.last_replies.clone_from(&snapshot.last_replies);
        segment.faults = snapshot.faults.clone();
        segment.persist_all();
        segment.route();
        for door in &mut self.doors {
            door.heard_at = snapshot.now;
        }
    }

    /// Empties journal and counts, as at the start.
    pub fn forget(&mut self) {
        self.segment.counters = Counters::default();
        self.segment.outputs.retain(|output| !matches!(output, Output::Exchange(_)));
        if let Some(journal) = &mut self.segment.journal {
            *journal = Journal::default();
        }
    }

    /// From now on requests are kept in a journal.
    pub fn keep_journal(&mut self) {
        self.segment.journal.get_or_insert_default();
    }

    /// The journal, where one is kept.
    pub fn journal(&self) -> Option<&Journal> {
        self.segment.journal.as_ref()
    }

    /// Forgets the requests that the journal has kept.
    pub fn clear_journal(&mut self) {
        if let Some(journal) = &mut self.segment.journal {
            journal.clear();
        }
    }

    /// From now on changes of the devices are handed out, or not.
    pub fn watch(&mut self, is_watched: bool) {
        let segment = &mut self.segment;
        segment.watch = is_watched.then(|| Watch::new(&segment.stations));
    }

    /// Its faults, and how often each has hit.
    pub fn faults(&self) -> &Faults {
        &self.segment.faults
    }

    /// Whether a fault's count and time are not used up at `now`.
    pub fn is_fault_active(&self, now: Instant, id: u64) -> bool {
        let now = self.segment.inner(now);
        self.segment.faults.list().iter().any(|active| active.fault().id == id && active.is_active(now))
    }

    /// From `now` on there is one more fault.
    pub fn add_fault(&mut self, now: Instant, fault: Fault) {
        self.segment.set_now(now);
        self.segment.faults.add(fault, self.segment.now);
    }

    /// Takes a fault away; `false` where there is none of that number.
    pub fn remove_fault(&mut self, id: u64) -> bool {
        self.segment.faults.remove(id)
    }

    /// Takes all faults away.
    pub fn clear_faults(&mut self) {
        self.segment.faults.clear();
    }
}
