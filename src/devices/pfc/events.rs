//! The event log: the last eight events with value, phase and time, the newest first (PFC-17).

use chrono::{Datelike, NaiveDateTime, Timelike};
use serde::{Deserialize, Serialize};

use super::display::unsigned_pair;
use super::map::{
    EVENT_N_DAY, EVENT_N_HOUR, EVENT_N_KIND, EVENT_N_MINUTE, EVENT_N_MONTH, EVENT_N_PHASE, EVENT_N_SECOND,
    EVENT_N_VALUE, EVENT_N_YEAR, EVENTS,
};
use crate::image::Image;

/// What happened; the numbers are the registers'.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A phase voltage above its limit.
    Overvoltage = 1,
    /// A phase voltage below its limit.
    Undervoltage = 2,
    /// A phase current above its limit.
    Overcurrent = 3,
    /// The distortion of the currents above its limit.
    HarmonicDistortion = 4,
    /// The temperature above its limit.
    HighTemperature = 5,
    /// Digital input 2 rose.
    DigitalInput = 6,
    /// The supply was lost.
    PowerLoss = 7,
}

/// A value and the phase that it was measured on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reading {
    /// The value in thousandths.
    pub milli: i64,
    /// 0 none, 1 A, 2 B, 3 C.
    pub phase: u16,
}

/// One line of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// What happened.
    pub kind: EventKind,
    /// The value that was out of its limit, and its phase.
    pub reading: Reading,
    /// When, by the civil clock.
    pub time: NaiveDateTime,
}

/// The last events, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Log {
    events: Vec<Event>,
    /// Whether an event came since this was last asked.
    #[serde(skip)]
    is_fresh: bool,
}

impl Log {
    /// Puts an event on top; the ninth is gone.
    pub fn push(&mut self, event: Event) {
        self.events.insert(0, event);
        self.events.truncate(EVENTS);
        self.is_fresh = true;
    }

    /// Whether an event came since the last call.
    pub fn take_fresh(&mut self) -> bool {
        std::mem::take(&mut self.is_fresh)
    }

    /// Whether it has no more events than fit.
    pub fn fits(&self) -> bool {
        self.events.len() <= EVENTS
    }

    /// Puts all events into their registers.
    pub fn show(&self, digits: u8, regs: &mut Image) {
        for index in 0..EVENTS {
            let event = self.events.get(index);
            let number = |of: fn(&Event) -> u32| event.map_or(0, |event| of(event) as u16);
            let reading = event.map(|event| event.reading).unwrap_or_default();
            regs.set(EVENT_N_KIND.nth(index), number(|event| event.kind as u32));
            regs.set(EVENT_N_VALUE.nth(index), unsigned_pair(reading.milli as f64 / 1000.0, digits));
            regs.set(EVENT_N_PHASE.nth(index), reading.phase);
            regs.set(EVENT_N_DAY.nth(index), number(|event| event.time.day()));
            regs.set(EVENT_N_MONTH.nth(index), number(|event| event.time.month()));
            regs.set(EVENT_N_YEAR.nth(index), number(|event| event.time.year().rem_euclid(100) as u32));
            regs.set(EVENT_N_SECOND.nth(index), number(|event| event.time.second()));
            regs.set(EVENT_N_MINUTE.nth(index), number(|event| event.time.minute()));
            regs.set(EVENT_N_HOUR.nth(index), number(|event| event.time.hour()));
        }
    }
}
