//! The bus behind its doors: who hears a request, when its reply leaves, and what has to be kept before it does.

use std::collections::{HashMap, HashSet, VecDeque};

use super::{Counters, DoorId, DoorKind, Exchange, Form, LineCheck, Output, Settings, Timing};
use crate::device::Refusal;
use crate::line::Line;
use crate::station::{self, Outcome, Station};
use crate::time::{Instant, SimClock};
use crate::wire::{Exception, FRAME_MAX, Request, append_crc, crc16};

/// All of the bus but the doors.
#[derive(Debug)]
pub(super) struct Segment {
    settings: Settings,
    pub(super) clock: SimClock,
    pub(super) now: Instant,
    pub(super) stations: Vec<Station>,
    pub(super) routes: Box<[Route; 256]>,
    /// Whether a station is restarting: it has to be woken before routes are believed.
    is_waking: bool,
    pub(super) outputs: VecDeque<Output>,
    pub(super) replies: VecDeque<Reply>,
    /// Stations as they were before the write that is being kept.
    pub(super) undo: HashMap<usize, station::Live>,
    /// Stations whose image could not be kept though no write was answered for it.
    unkept: HashSet<usize>,
    pub(super) counters: Counters,
    pub(super) is_observed: bool,
    pub(super) is_durable: bool,
    saved_at: Instant,
    lived_at: Instant,
    /// A buffer that replies are made in.
    scratch: Vec<u8>,
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

/// Who answers a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Route {
    #[default]
    Nobody,
    One(usize),
    Several,
}

/// A reply that has not left yet.
#[derive(Debug)]
pub(super) struct Reply {
    pub(super) due: Instant,
    pub(super) door: DoorId,
    transaction: Option<u16>,
    bytes: Vec<u8>,
    heard: Instant,
    exchange: Option<Box<Exchange>>,
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
            now: Instant(0),
            stations,
            routes: Box::new([Route::Nobody; 256]),
            is_waking: false,
            outputs: VecDeque::new(),
            replies: VecDeque::new(),
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
        if self.is_waking {
            self.live_to(self.now);
        }
        if heard.unit == 0 {
            return self.broadcast(heard);
        }
        match self.routes[usize::from(heard.unit)] {
            Route::Nobody => {
                let reason = match self.stations.iter().any(|station| station.address().unit == heard.unit) {
                    true => "the device is off or restarting",
                    false => "no device here has this unit (BUS-2)",
                };
                self.report(&heard, None, Outcome::Silence(reason));
            }
            Route::One(index) => self.ask(heard, index),
            Route::Several => {
                let unit = heard.unit;
                let reason = Outcome::Silence("several devices have this unit, their replies collide (BUS-15)");
                self.report(&heard, None, reason);
                self.carry_out(heard, |station| station.address().unit == unit);
            }
        }
    }

    /// Every device that supports the function carries a write out, and nobody answers (BUS-3).
    fn broadcast(&mut self, heard: Heard) {
        let is_write = Request::parse(heard.pdu).is_some_and(|request| !request.is_read());
        let reason =
            if is_write { "a broadcast is not answered (BUS-3)" } else { "a broadcast read does nothing (BUS-3)" };
        self.report(&heard, None, Outcome::Silence(reason));
        if is_write {
            self.carry_out(heard, |_| true);
        }
    }

    /// Lets the listening stations of a choice carry out a request without an answer.
    fn carry_out(&mut self, heard: Heard, chosen: impl Fn(&Station) -> bool) {
        let Some(request) = Request::parse(heard.pdu) else { return };
        for index in 0..self.stations.len() {
            self.stations[index].advance(&self.clock, self.now);
            let station = &self.stations[index];
            if station.is_listening() && chosen(station) && self.is_heard(index, heard.seen, heard.warned) {
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
            return self.report(&heard, Some(index), Outcome::Silence("the device is off or restarting"));
        }
        if !self.is_heard(index, heard.seen, heard.warned) {
            let reason = "the client's baud rate is not the device's (BUS-16)";
            return self.report(&heard, Some(index), Outcome::Silence(reason));
        }
        let Some(request) = Request::parse(heard.pdu) else {
            let reason = "the body has the wrong length for its function (BUS-12)";
            return self.report(&heard, Some(index), Outcome::Silence(reason));
        };
        let line = self.stations[index].address().line;
        self.scratch.clear();
        self.scratch.push(heard.unit);
        let outcome = self.respond(index, &request);
        if let Outcome::Silence(_) = outcome {
            self.report(&heard, Some(index), outcome);
        } else {
            let delay_us = self.delay_us(index, &line, heard.kind, heard.pdu.len() + 3, self.scratch.len() + 2);
            let exchange = self.is_observed.then(|| Box::new(self.exchange(&heard, Some(index), outcome.clone())));
            let mut bytes = self.scratch.clone();
            if heard.transaction.is_none() {
                append_crc(&mut bytes);
            }
            match outcome {
                Outcome::Exception(_) => self.counters.exceptions += 1,
                _ => self.counters.replies += 1,
            }
            let (door, transaction) = (heard.door, heard.transaction);
            let due = self.now.plus_us(delay_us);
            self.replies.push_back(Reply { due, door, transaction, bytes, heard: self.now, exchange });
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

    /// Whether a station hears a client (BUS-16). Only the baud rate keeps it from hearing: a receiver takes any number of
    /// stop bits from one up.
    fn is_heard(&mut self, index: usize, seen: Option<(u32, u8)>, warned: &mut HashSet<usize>) -> bool {
        if self.settings.line_check == LineCheck::Off {
            return true;
        }
        let (station, bus) = (&self.stations[index], self.settings.line);
        let line = station.address().line;
        let (baud, stop_bits) = seen.unwrap_or((bus.baud, bus.stop_bits));
        let enforced = self.settings.line_check == LineCheck::Enforce;
        if (baud, stop_bits) != (line.baud, line.stop_bits) && warned.insert(index) {
            let what =
                if enforced && baud != line.baud { "hears nothing" } else { "would not be understood on a real line" };
            let name = station.name();
            let text =
                format!("the client talks {baud} baud, {stop_bits} stop bits; {name} is set to {line}: it {what}");
            self.outputs.push_back(Output::Note(text));
        }
        !enforced || baud == line.baud
    }

    /// From a request's last byte to its reply (BUS-17).
    fn delay_us(&self, index: usize, line: &Line, kind: DoorKind, request: usize, reply: usize) -> u64 {
        let own_us = self.stations[index].response_delay_ms() * 1000;
        let characters = match (self.settings.timing, kind) {
            (Timing::Fast, _) => return own_us,
            (Timing::Wire, DoorKind::Wire) => 0,
            (Timing::Wire, DoorKind::Virtual | DoorKind::Tcp) => request + reply,
        };
        own_us + line.half_characters_us(2 * characters as u64 + 7)
    }

    /// Takes bytes that silence ended and that are no frame (BUS-4); `false` when nobody answers them.
    pub(super) fn damaged(&mut self, door: DoorId, kind: DoorKind, bytes: &[u8]) -> bool {
        let Route::One(index) = self.routes[usize::from(bytes.first().copied().unwrap_or(0))] else { return false };
        if bytes.len() < 4 || crc16(bytes) == 0 {
            return false;
        }
        self.stations[index].advance(&self.clock, self.now);
        if !self.stations[index].answers_crc_errors() {
            return false;
        }
        let frame = vec![bytes[0], bytes[1] | 0x80, Exception::IllegalDataValue as u8];
        let line = self.stations[index].address().line;
        let due = self.now.plus_us(self.delay_us(index, &line, kind, 0, frame.len() + 2));
        let exchange = self.is_observed.then(|| {
            let refusal = Refusal::new(Exception::IllegalDataValue, "the frame's CRC is wrong", "BUS-4");
            Box::new(Exchange {
                at: self.clock.at(self.now),
                reply_us: 0,
                unit: bytes[0],
                station: Some(index),
                form: Form::Damaged,
                request: bytes.to_vec(),
                reply: frame.clone(),
                outcome: Outcome::Exception(refusal),
            })
        });
        let mut bytes = frame;
        append_crc(&mut bytes);
        self.counters.exceptions += 1;
        self.replies.push_back(Reply { due, door, transaction: None, bytes, heard: self.now, exchange });
        true
    }

    /// Reports bytes that silence ended and that nobody answers.
    pub(super) fn report_damaged(&mut self, bytes: &[u8]) {
        if !self.is_observed {
            return;
        }
        let reason = match bytes.len() {
            0..4 => "fewer than four bytes are no frame (BUS-1)",
            FRAME_MAX.. => "more than 256 bytes without a silence are no frame (BUS-1)",
            _ if crc16(bytes) == 0 => "the body has the wrong length for its function (BUS-12)",
            _ => "the CRC is wrong (BUS-4)",
        };
        self.outputs.push_back(Output::Exchange(Box::new(Exchange {
            at: self.clock.at(self.now),
            reply_us: 0,
            unit: bytes.first().copied().unwrap_or(0),
            station: None,
            form: Form::Damaged,
            request: bytes.to_vec(),
            reply: Vec::new(),
            outcome: Outcome::Silence(reason),
        })));
    }

    fn exchange(&self, heard: &Heard, station: Option<usize>, outcome: Outcome) -> Exchange {
        let is_silent = matches!(outcome, Outcome::Silence(_));
        let mut request = Vec::with_capacity(heard.pdu.len() + 1);
        request.push(heard.unit);
        request.extend(heard.pdu);
        Exchange {
            at: self.clock.at(self.now),
            reply_us: 0,
            unit: heard.unit,
            station,
            form: heard.transaction.map_or(Form::Rtu, |transaction| Form::Tcp { transaction }),
            request,
            reply: if is_silent { Vec::new() } else { self.scratch.clone() },
            outcome,
        }
    }

    fn report(&mut self, heard: &Heard, station: Option<usize>, outcome: Outcome) {
        if self.is_observed {
            let exchange = self.exchange(heard, station, outcome);
            self.outputs.push_back(Output::Exchange(Box::new(exchange)));
        }
    }

    /// Lets the first waiting reply go.
    pub(super) fn transmit(&mut self) {
        let Some(Reply { door, transaction, bytes, heard, exchange, .. }) = self.replies.pop_front() else { return };
        self.outputs.push_back(Output::Transmit { door, transaction, bytes });
        self.outputs.extend(exchange.map(|mut exchange| {
            exchange.reply_us = self.now.since_us(heard);
            Output::Exchange(exchange)
        }));
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
        let text = format!("the memory cannot be kept: {reason}");
        for reply in &mut self.replies {
            let function = reply.bytes[1] & 0x7F;
            reply.bytes.truncate(1);
            reply.bytes.extend([function | 0x80, Exception::DeviceFailure as u8]);
            if let Some(exchange) = &mut reply.exchange {
                exchange.reply.clone_from(&reply.bytes);
                exchange.outcome = Outcome::Exception(Refusal::new(Exception::DeviceFailure, text.clone(), "BUS-19"));
            }
            if reply.transaction.is_none() {
                append_crc(&mut reply.bytes);
            }
        }
        self.route();
    }
}
