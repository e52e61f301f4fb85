//! The last requests of a bus, and counts of all of them. What readers make of it is not known here.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use super::exchange::{Exchange, Form};
use crate::faults::Hit;
use crate::station::Outcome;

/// How many requests are kept.
pub const RECORDS_MAX: usize = 10_000;

/// A request that was kept.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its number on this bus, ascending from 1.
    pub id: u64,
    /// The request and what became of it.
    pub exchange: Arc<Exchange>,
}

/// The last requests of a bus.
#[derive(Clone, Debug, Default)]
pub struct Journal {
    records: VecDeque<Record>,
    last_id: u64,
    tally: Tally,
}

impl Journal {
    /// Keeps one more; the oldest makes room. Bytes that are no request are not kept.
    pub fn push(&mut self, exchange: Arc<Exchange>) {
        self.tally.count(&exchange);
        if exchange.form == Form::Damaged && exchange.reply.is_empty() {
            return;
        }
        if self.records.len() == RECORDS_MAX {
            self.records.pop_front();
        }
        self.last_id += 1;
        self.records.push_back(Record { id: self.last_id, exchange });
    }

    /// What is kept, the oldest first.
    pub fn records(&self) -> impl DoubleEndedIterator<Item = &Record> {
        self.records.iter()
    }

    /// Forgets what is kept; the counts go on.
    pub fn clear(&mut self) {
        self.records.clear();
    }

    /// Counts since the start.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Counts a fault that hit no request.
    pub fn count_hit(&mut self, hit: Hit) {
        *self.tally.hits.entry(hit.kind).or_default() += 1;
    }
}

/// What a count of requests is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Subject {
    /// Index of the device, if the request reached one.
    pub station: Option<usize>,
    /// Function code.
    pub function: u8,
    /// [`outcome_name`] of it.
    pub outcome: &'static str,
    /// Exception code; 0 for none.
    pub code: u8,
}

/// Upper bounds of the reply times that are counted apart, in microseconds; what is above counts last.
pub const REPLY_BOUNDS_US: [u64; 10] =
    [1_000, 2_500, 5_000, 10_000, 25_000, 50_000, 100_000, 250_000, 500_000, 1_000_000];

/// Reply times of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplyTimes {
    /// Replies up to each of [`REPLY_BOUNDS_US`] and above the one before; the last counts those above all.
    pub counts: [u64; REPLY_BOUNDS_US.len() + 1],
    /// All reply times together, in microseconds.
    pub sum_us: u64,
}

/// Counts of all requests of a bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Requests.
    pub requests: BTreeMap<Subject, u64>,
    /// Reply times by index of the device.
    pub reply_times: BTreeMap<usize, ReplyTimes>,
    /// Hits of faults by what they do.
    pub hits: BTreeMap<&'static str, u64>,
}

impl Tally {
    fn count(&mut self, exchange: &Exchange) {
        for hit in &exchange.faults {
            *self.hits.entry(hit.kind).or_default() += 1;
        }
        if exchange.form == Form::Damaged && exchange.reply.is_empty() {
            return;
        }
        let subject = Subject {
            station: exchange.station,
            function: exchange.function(),
            outcome: outcome_name(&exchange.outcome),
            code: exchange.exception_code().unwrap_or(0),
        };
        *self.requests.entry(subject).or_default() += 1;
        if let (Some(station), false) = (exchange.station, matches!(exchange.outcome, Outcome::Silence(_))) {
            let times = self.reply_times.entry(station).or_default();
            let bound = REPLY_BOUNDS_US.iter().position(|bound| exchange.reply_us <= *bound);
            times.counts[bound.unwrap_or(REPLY_BOUNDS_US.len())] += 1;
            times.sum_us = times.sum_us.saturating_add(exchange.reply_us);
        }
    }
}

/// What journal, metrics and events call an outcome.
pub fn outcome_name(outcome: &Outcome) -> &'static str {
    match outcome {
        Outcome::Reply => "reply",
        Outcome::Exception(_) => "exception",
        Outcome::Silence(_) => "silence",
    }
}
