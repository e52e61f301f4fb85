//! The bus behind its doors: who hears a request, when its reply leaves, and what has to be kept before it does.

use std::collections::{HashMap, HashSet, VecDeque};

use super::journal::Journal;
use super::reply::Reply;
use super::watch::Watch;
use super::{Bytes, Counters, DoorId, DoorKind, LineCheck, Output, Settings};
use crate::device::Refusal;
use crate::faults::{Asked, Faults, Hit, Verdict};
use crate::station::{self, Outcome, Station};
use crate::time::{Instant, Moment, SimClock};
use crate::wire::{Exception, Request};

/// All of the bus but the doors.
#[derive(Debug)]
pub(super) struct Segment {
    pub(super) settings: Settings,
    pub(super) clock: SimClock,
    pub(super) now: Instant,
    pub(super) stations: Vec<Station>,
    pub(super) routes: Box<[Route; 256]>,
    /// Whether a station is restarting: it has to be woken before routes are believed.
    is_waking: bool,
    pub(super) outputs: VecDeque<Output>,
    /// Replies on their way in their turn: the line is taken until they have left.
    pub(super) replies: VecDeque<Reply>,
    /// Replies that faults hold back, the next one first.
    pub(super) late: VecDeque<Reply>,
    /// Stations as they were before the write that is being kept.
    pub(super) undo: HashMap<usize, station::Live>,
    /// Stations whose image could not be kept though no write was answered for it.
    unkept: HashSet<usize>,
    pub(super) counters: Counters,
    pub(super) is_observed: bool,
    pub(super) journal: Option<Journal>,
    pub(super) watch: Option<Watch>,
    pub(super) faults: Faults,
    /// The last reply of each station, as it would have left without faults.
    pub(super) last_replies: Vec<Vec<u8>>,
    /// How much younger the stations are than the program, in microseconds: a restored snapshot takes them back to its
    /// own elapsed time, so that their protocol delays end as they would have.
    pub(super) skew_us: u64,
    /// The rate that the clock will have again when it is held no longer.
    pub(super) held_rate: Option<f64>,
    pub(super) is_durable: bool,
    pub(super) saved_at: Instant,
    pub(super) lived_at: Instant,
    /// A buffer that replies are made in.
    pub(super) scratch: Vec<u8>,
}

/// A frame with a good CRC, and who sent it.
pub(super) struct Heard<'a> {
    pub(super) door: DoorId,
    pub(super) kind: DoorKind,
    pub(super) transaction: Option<u16>,
    /// Baud and stop bits that the client has set.
    pub(super) seen: Option<(u32, u8)>,
    pub(super) warned: &'a mut HashSet<usize>,
    pub(super) unit: u8,
    pub(super) pdu: &'a [u8],
}

impl Heard<'_> {
    /// Unit, function and data.
    pub(super) fn frame(&self) -> Bytes {
        let mut frame = Bytes::from_slice(&[self.unit]);
        frame.extend_from_slice(self.pdu);
        frame
    }

    /// The request as faults see it; `frame` is [`Heard::frame`].
    pub(super) fn asked<'a>(
        &self,
        now: Instant,
        station: Option<usize>,
        request: &Request,
        frame: &'a [u8],
    ) -> Asked<'a> {
        let span = match *request {
            Request::Read { bank, start, quantity } | Request::WriteMultiple { bank, start, quantity, .. } => {
                Some((bank, start, quantity))
            }
            Request::WriteSingle { bank, addr, .. } => Some((bank, addr, 1)),
            Request::Other { .. } => None,
        };
        Asked { now, station, function: request.function(), span, request: frame, has_crc: self.transaction.is_none() }
    }
}

/// Who answers a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Route {
    #[default]
    Nobody,
    One(usize),
    Several,
}

/// How often moving things that EEPROM keeps are saved when no write does it.
const SAVE_EVERY_MS: u64 = 60_000;

/// When an image that could not be kept is tried again.
const RETRY_MS: u64 = 5_000;

impl Segment {
    pub(super) fn new(settings: Settings, clock: SimClock, stations: Vec<Station>) -> Self {
        let mut segment = Self {
            settings,
            clock,
            journal: None,
            watch: None,
            faults: Faults::default(),
            last_replies: vec![Vec::new(); stations.len()],
            skew_us: 0,
            held_rate: None,
            now: Instant(0),
            stations,
            routes: Box::new([Route::Nobody; 256]),
            is_waking: false,
            outputs: VecDeque::new(),
            replies: VecDeque::new(),
            late: VecDeque::new(),
            undo: HashMap::new(),
            unkept: HashSet::new(),
            counters: Counters::default(),
            is_observed: false,
            is_durable: false,
            saved_at: Instant(0),
            lived_at: Instant(0),
            scratch: Vec::with_capacity(256),
        };
        segment.collect_notes();
        segment.route();
        segment
    }

    /// An elapsed time of the program as the stations count it.
    pub(super) fn inner(&self, now: Instant) -> Instant {
        Instant(now.0.saturating_sub(self.skew_us))
    }

    /// An elapsed time of the stations as the program counts it.
    pub(super) fn outer(&self, now: Instant) -> Instant {
        now.plus_us(self.skew_us)
    }

    /// It is `now` of the program.
    pub(super) fn set_now(&mut self, now: Instant) {
        self.now = self.now.max(self.inner(now));
    }

    /// All readings for those who look from outside.
    pub(super) fn moment(&self) -> Moment {
        Moment { elapsed: self.outer(self.now), ..self.clock.at(self.now) }
    }

    /// Lives up to `now`, as the stations count it.
    pub(super) fn live_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
        self.lived_at = self.now;
        for station in &mut self.stations {
            station.advance(&self.clock, self.now);
        }
        self.collect_notes();
        self.persist_changed();
        self.route();
    }

    fn collect_notes(&mut self) {
        for station in &mut self.stations {
            let notes = station.take_notes();
            self.outputs.extend(notes.into_iter().map(|note| Output::Note(format!("{}: {note}", station.name()))));
        }
    }

    /// Finds out anew who answers which unit (BUS-13, BUS-15).
    pub(super) fn route(&mut self) {
        let mut routes = [Route::Nobody; 256];
        for (index, station) in self.stations.iter().enumerate() {
            let unit = station.address().unit;
            let route = &mut routes[usize::from(unit)];
            match route {
                _ if unit == 0 || !station.is_listening() => {}
                Route::Nobody => *route = Route::One(index),
                Route::One(_) | Route::Several => {
                    if *route != Route::Several && self.routes[usize::from(unit)] != Route::Several {
                        let text =
                            format!("unit {unit} is taken twice: its replies collide, nobody answers it (BUS-15)");
                        self.outputs.push_back(Output::Note(text));
                    }
                    *route = Route::Several;
                }
            }
        }
        *self.routes = routes;
        self.is_waking = self.stations.iter().any(|station| station.is_powered() && !station.is_listening());
    }

    fn persist(&mut self, index: usize) {
        let moment = self.clock.at(self.now);
        let saved = self.stations[index].saved(moment);
        self.outputs.push_back(Output::Persist { station: index, saved });
    }

    pub(super) fn persist_changed(&mut self) {
        for index in 0..self.stations.len() {
            self.persist_if_changed(index);
        }
    }

    fn persist_if_changed(&mut self, index: usize) {
        if self.is_durable && self.stations[index].take_unsaved() {
            self.persist(index);
        }
    }

    pub(super) fn persist_all(&mut self) {
        self.saved_at = self.now;
        self.unkept.clear();
        for index in 0..self.stations.len() {
            if self.is_durable {
                self.stations[index].take_unsaved();
                self.persist(index);
            }
        }
    }

    /// When stations live on though nobody asks, so that no request has to wait for a long time to be lived through.
    pub(super) fn housekeeping_at(&self) -> Option<Instant> {
        let every_ms = match self.clock.rate() {
            0.0 if !self.is_durable => return None,
            rate if rate > 60.0 => 50,
            _ => 1000,
        };
        Some(self.lived_at.plus_ms(every_ms))
    }

    pub(super) fn housekeep(&mut self) {
        let is_due = self.housekeeping_at().is_some_and(|at| at <= self.now);
        let deadline = self.stations.iter().filter_map(Station::deadline).min();
        if is_due || deadline.is_some_and(|at| at <= self.now) {
            self.live_to(self.now);
        }
        let every_ms = if self.unkept.is_empty() { SAVE_EVERY_MS } else { RETRY_MS };
        if self.is_durable && self.now.since_us(self.saved_at) >= every_ms * 1000 {
            self.persist_all();
        }
    }

    /// Takes a frame with a good CRC.
    pub(super) fn hear(&mut self, heard: Heard) {
        self.counters.frames += 1;
        if let Some(hit) = self.offline() {
            return self.report(&heard, None, Outcome::Silence("the bus is offline"), vec![hit]);
        }
        if self.is_waking {
            self.live_to(self.now);
        }
        if heard.unit == 0 {
            return self.broadcast(heard);
        }
        match self.answering(heard.unit, heard.seen) {
            Route::Nobody => {
                let dark = self.stations.iter().position(|station| station.address().unit == heard.unit);
                let reason = match dark {
                    Some(_) => "the device is off or restarting",
                    None => "no device here has this unit (BUS-2)",
                };
                self.report(&heard, dark, Outcome::Silence(reason), Vec::new());
            }
            Route::One(index) => self.ask(heard, index),
            Route::Several => {
                let unit = heard.unit;
                let reason = Outcome::Silence("several devices have this unit, their replies collide (BUS-15)");
                self.report(&heard, None, reason, Vec::new());
                self.carry_out(heard, |_, station| station.address().unit == unit);
            }
        }
    }

    /// The fault that keeps this off the bus.
    pub(super) fn offline(&mut self) -> Option<Hit> {
        if self.faults.is_empty() { None } else { self.faults.offline(self.now) }
    }

    /// Every device that supports the function carries a write out, and nobody answers (BUS-3).
    fn broadcast(&mut self, heard: Heard) {
        let request = Request::parse(heard.pdu);
        let is_write = request.is_some_and(|request| !request.is_read());
        let (mut hits, mut deaf) = (Vec::new(), Vec::new());
        if let (Some(request), false) = (request, self.faults.is_empty()) {
            let frame = heard.frame();
            if let Verdict::Lost(reason) =
                self.faults.intercept(&heard.asked(self.now, None, &request, &frame), &mut hits)
            {
                return self.report(&heard, None, Outcome::Silence(reason), hits);
            }
            let faults = &mut self.faults;
            deaf.extend(
                (0..self.stations.len())
                    .filter(|index| faults.deafens(&heard.asked(self.now, Some(*index), &request, &frame), &mut hits)),
            );
        }
        let reason =
            if is_write { "a broadcast is not answered (BUS-3)" } else { "a broadcast read does nothing (BUS-3)" };
        self.report(&heard, None, Outcome::Silence(reason), hits);
        if is_write {
            self.carry_out(heard, |index, _| !deaf.contains(&index));
        }
    }

    /// Lets the listening stations of a choice carry out a request without an answer.
    fn carry_out(&mut self, heard: Heard, chosen: impl Fn(usize, &Station) -> bool) {
        let Some(request) = Request::parse(heard.pdu) else { return };
        for index in 0..self.stations.len() {
            self.stations[index].advance(&self.clock, self.now);
            let station = &self.stations[index];
            if station.is_listening() && chosen(index, station) && self.is_heard(index, heard.seen, heard.warned) {
                self.respond(index, &request);
                self.stations[index].settle_restart(self.now);
            }
        }
        self.settle();
    }

    /// Hands a request to the one station that has its unit.
    fn ask(&mut self, heard: Heard, index: usize) {
        self.stations[index].advance(&self.clock, self.now);
        if !self.stations[index].is_listening() {
            let reason = Outcome::Silence("the device is off or restarting");
            return self.report(&heard, Some(index), reason, Vec::new());
        }
        if !self.is_heard(index, heard.seen, heard.warned) {
            let reason = "the client's baud rate is not the device's (BUS-16)";
            return self.report(&heard, Some(index), Outcome::Silence(reason), Vec::new());
        }
        let Some(request) = Request::parse(heard.pdu) else {
            let reason = "the body has the wrong length for its function (BUS-12)";
            return self.report(&heard, Some(index), Outcome::Silence(reason), Vec::new());
        };
        let (mut hits, mut verdict) = (Vec::new(), Verdict::Through);
        if !self.faults.is_empty() {
            let frame = heard.frame();
            verdict = self.faults.intercept(&heard.asked(self.now, Some(index), &request, &frame), &mut hits);
        }
        let line = self.stations[index].address().line;
        self.scratch.clear();
        self.scratch.push(heard.unit);
        let outcome = match verdict {
            Verdict::Lost(reason) => Outcome::Silence(reason),
            Verdict::Through => self.respond(index, &request),
            Verdict::Refused(code) => {
                self.scratch.extend([request.function() | 0x80, code]);
                Outcome::Exception(Refusal::new(Exception::DeviceFailure, "a fault answers this exception", "fault"))
            }
        };
        if let Outcome::Silence(_) = outcome {
            self.report(&heard, Some(index), outcome, hits);
        } else {
            let due = self.reply(&heard, (index, &line), &request, outcome, hits);
            self.stations[index].settle_restart(due);
        }
        if !request.is_read() || !self.stations[index].is_listening() {
            self.settle();
        } else {
            // A read may tell of something that happened since: it is a promise too (BUS-19).
            self.persist_if_changed(index);
        }
    }

    /// Lets a station carry out a request; what it answers is in the scratch buffer.
    fn respond(&mut self, index: usize, request: &Request) -> Outcome {
        let station = &mut self.stations[index];
        if self.is_durable && !request.is_read() {
            self.undo.insert(index, station.live());
        }
        station.respond(request, self.clock.at(self.now), &mut self.scratch)
    }

    /// After a request that may have changed stations: notes, images, routes.
    fn settle(&mut self) {
        self.collect_notes();
        self.persist_changed();
        self.route();
    }

    /// Who answers a unit to a client: replies of two stations collide only where both hear it (BUS-15, BUS-16).
    pub(super) fn answering(&self, unit: u8, seen: Option<(u32, u8)>) -> Route {
        let route = self.routes[usize::from(unit)];
        if route != Route::Several {
            return route;
        }
        let mut hearing = (0..self.stations.len()).filter(|index| {
            let station = &self.stations[*index];
            station.is_listening() && station.address().unit == unit && self.hears(*index, seen)
        });
        match (hearing.next(), hearing.next()) {
            (Some(only), None) => Route::One(only),
            _ => route,
        }
    }

    /// Whether a station hears a client (BUS-16). Only the baud rate keeps it from hearing: a receiver takes any number of
    /// stop bits from one up.
    pub(super) fn hears(&self, index: usize, seen: Option<(u32, u8)>) -> bool {
        let baud = seen.map_or(self.settings.line.baud, |(baud, _)| baud);
        self.settings.line_check != LineCheck::Enforce || baud == self.stations[index].address().line.baud
    }

    /// As [`Segment::hears`], and the client is warned.
    fn is_heard(&mut self, index: usize, seen: Option<(u32, u8)>, warned: &mut HashSet<usize>) -> bool {
        if self.settings.line_check == LineCheck::Off {
            return true;
        }
        let (station, bus) = (&self.stations[index], self.settings.line);
        let line = station.address().line;
        let (baud, stop_bits) = seen.unwrap_or((bus.baud, bus.stop_bits));
        let hears = self.hears(index, seen);
        if (baud, stop_bits) != (line.baud, line.stop_bits) && warned.insert(index) {
            let what = if hears { "would not be understood on a real line" } else { "hears nothing" };
            let name = station.name();
            let text =
                format!("the client talks {baud} baud, {stop_bits} stop bits; {name} is set to {line}: it {what}");
            self.outputs.push_back(Output::Note(text));
        }
        hears
    }

    /// Takes back the write whose image could not be kept, and answers it 04 (BUS-19). What changed without a write stays,
    /// and is tried again later.
    pub(super) fn keep_failed(&mut self, index: usize, reason: &str) {
        let name = self.stations[index].name();
        self.outputs.push_back(Output::Note(format!("the memory of {name} cannot be kept: {reason}")));
        let Some(live) = self.undo.remove(&index) else {
            self.unkept.insert(index);
            return;
        };
        self.stations[index].restore(live);
        self.refuse_replies(&format!("the memory cannot be kept: {reason}"));
        self.route();
    }
}
