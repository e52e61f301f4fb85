//! Many stations on one line: bytes in, bytes out, delays, broadcasts, collisions. No I/O: after every receive, command
//! or timer the shell drains [`Bus::poll`] and sleeps until [`Bus::wake_at`].
//!
//! A bus has *doors*: a pty, a serial port, a TCP connection. All see one bus; a reply leaves by the door that its
//! request came in by.

mod exchange;
mod hand;
mod journal;
mod reply;
mod segment;
mod watch;

use std::collections::{HashSet, VecDeque};
use std::sync::Arc;
use std::task::Poll;

pub use self::exchange::{Bytes, Counters, Event, Exchange, Form};
pub use self::hand::Snapshot;
pub use self::journal::{Journal, RECORDS_MAX, REPLY_BOUNDS_US, Record, ReplyTimes, Subject, Tally, outcome_name};
use self::segment::{Heard, Route, Segment};
use crate::line::Line;
use crate::station::{Saved, Station};
use crate::time::{Instant, Moment, SimClock};
use crate::wire::{Frame, Framer, crc16};

/// How long replies take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Timing {
    /// At once (BUS-17).
    #[default]
    Fast,
    /// As long as the real line takes.
    Wire,
}

/// What a client at the wrong speed gets (BUS-16).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LineCheck {
    /// An answer, and the log one warning.
    #[default]
    Warn,
    /// Nothing.
    Enforce,
    /// An answer.
    Off,
}

/// The settings of a bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Speed and character format.
    pub line: Line,
    /// How long replies take.
    pub timing: Timing,
    /// What a client at the wrong speed gets.
    pub line_check: LineCheck,
    /// Added to the silence that ends a frame, because ptys and adapters split and delay bytes (BUS-5).
    pub slack_ms: u64,
}

impl Settings {
    /// The silence that ends what is no frame: 3.5 characters, or 1.75 ms above 19200 baud, and the slack (BUS-5).
    pub fn frame_timeout_us(&self) -> u64 {
        let least_us = if self.line.baud > 19_200 { 1750 } else { 0 };
        self.line.half_characters_us(7).max(least_us) + self.slack_ms * 1000
    }
}

/// A door of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DoorId(u64);

impl DoorId {
    /// No door: replies to what a client that is gone has asked leave by it.
    const NONE: Self = Self(u64::MAX);
}

/// What comes through a door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DoorKind {
    /// RTU frames that arrive in no time, from a pty or TCP: timing "wire" waits for the characters' time.
    Virtual,
    /// RTU frames on a real line, which takes its own time.
    Wire,
    /// Modbus TCP: units and PDUs, framed by the shell.
    Tcp,
}

#[derive(Debug)]
struct Door {
    id: DoorId,
    kind: DoorKind,
    framer: Framer,
    /// When the last bytes came.
    heard_at: Instant,
    /// Speed and stop bits that the client has set, where they can be seen.
    seen: Option<(u32, u8)>,
    /// Stations that this client was warned about (BUS-16).
    warned: HashSet<usize>,
    /// Whole requests that wait for their turn.
    requests: VecDeque<Queued>,
}

#[derive(Debug)]
struct Queued {
    transaction: Option<u16>,
    /// The client that asked is gone (BUS-23).
    is_left: bool,
    unit: u8,
    pdu: Vec<u8>,
}

/// The most requests that wait for their turn at one door; more are dropped.
pub const QUEUE_MAX: usize = 64;

impl Door {
    fn queue(&mut self, request: Queued) {
        if self.requests.len() < QUEUE_MAX {
            self.requests.push_back(request);
        }
    }
}

/// What the bus wants the shell to do, in this order.
#[derive(Clone, Debug)]
pub enum Output {
    /// Write this image before anything else is sent; if that fails, say so with [`Bus::keep_failed`] (BUS-19).
    Persist {
        /// Index of the station.
        station: usize,
        /// Its image.
        saved: Saved,
    },
    /// Send these bytes: an RTU frame, or for Modbus TCP unit and PDU behind the transaction's header.
    Transmit {
        /// The door to send them by.
        door: DoorId,
        /// The Modbus TCP transaction.
        transaction: Option<u16>,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// A request came to its end; only while the bus is observed.
    Exchange(Arc<Exchange>),
    /// Something else happened; only while the bus is watched.
    Event(Event),
    /// A line for the log.
    Note(String),
}

/// A line with its stations.
#[derive(Debug)]
pub struct Bus {
    name: String,
    settings: Settings,
    doors: Vec<Door>,
    next_door: u64,
    segment: Segment,
}

impl Bus {
    /// A bus at the first moment of its clock.
    pub fn new(name: impl Into<String>, settings: Settings, clock: SimClock, stations: Vec<Station>) -> Self {
        let segment = Segment::new(settings, clock, stations);
        Self { name: name.into(), settings, doors: Vec::new(), next_door: 0, segment }
    }

    /// Its name in devices.toml.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Its stations, in the order of devices.toml.
    pub fn stations(&self) -> &[Station] {
        &self.segment.stations
    }

    /// What it has counted.
    pub fn counters(&self) -> Counters {
        self.segment.counters
    }

    /// The readings of its clock.
    pub fn moment(&self, now: Instant) -> Moment {
        Moment { elapsed: now, ..self.segment.clock.at(self.segment.inner(now)) }
    }

    /// Its clock's rate.
    pub fn rate(&self) -> f64 {
        self.segment.held_rate.unwrap_or(self.segment.clock.rate())
    }

    /// From now on every request's course is handed out, or not.
    pub fn observe(&mut self, is_observed: bool) {
        self.segment.is_observed = is_observed;
    }

    /// From now on images are handed out to be kept before replies leave, and those of all stations at once.
    pub fn keep_memory(&mut self) {
        self.segment.is_durable = true;
        self.segment.persist_changed();
    }

    /// Opens a door.
    pub fn open_door(&mut self, now: Instant, kind: DoorKind) -> DoorId {
        let id = DoorId(self.next_door);
        self.next_door += 1;
        self.doors.push(Door {
            id,
            kind,
            framer: Framer::default(),
            heard_at: self.segment.inner(now),
            seen: None,
            warned: HashSet::new(),
            requests: VecDeque::new(),
        });
        id
    }

    /// Closes a door; what came in by it and is not answered yet is forgotten.
    pub fn close_door(&mut self, door: DoorId) {
        self.doors.retain(|other| other.id != door);
        self.forget_reply(door);
    }

    /// The last client at a door is gone: what it left half sent or unanswered is forgotten (BUS-23), and the next one is
    /// warned anew (BUS-16).
    pub fn client_closed(&mut self, door: DoorId) {
        if let Some(door) = self.door(door) {
            door.framer.clear();
            door.requests.clear();
            door.warned.clear();
        }
        self.forget_reply(door);
    }

    /// The speed and stop bits that the client at a door has set (BUS-16).
    pub fn line_seen(&mut self, door: DoorId, baud: u32, stop_bits: u8) {
        if let Some(door) = self.door(door) {
            door.seen = Some((baud, stop_bits));
        }
    }

    fn door(&mut self, id: DoorId) -> Option<&mut Door> {
        self.doors.iter_mut().find(|door| door.id == id)
    }

    fn forget_reply(&mut self, door: DoorId) {
        self.segment.outputs.retain(|output| !matches!(output, Output::Transmit { door: to, .. } if *to == door));
        self.segment.abandon("the client was gone before the reply left (BUS-23)", |reply| reply.door == door);
    }

    /// Takes bytes that came in by a door.
    pub fn receive(&mut self, now: Instant, door: DoorId, bytes: &[u8]) {
        self.take(now, door, bytes, Framer::push);
    }

    /// Takes bytes that came in by a door and may begin with what a client before this one has left (BUS-23). A client
    /// waits for its reply, so a request that others follow is the one's that is gone: it is carried out and not answered.
    pub fn receive_mixed(&mut self, now: Instant, door: DoorId, bytes: &[u8]) {
        self.take(now, door, bytes, Framer::push_mixed);
        let Some(index) = self.doors.iter().position(|other| other.id == door) else { return };
        let (door, routes) = (&mut self.doors[index], &self.segment.routes);
        while let Some((unit, pdu)) = next_frame(&mut door.framer, routes) {
            let pdu = pdu.to_vec();
            let is_left = door.framer.is_waiting();
            door.queue(Queued { transaction: None, is_left, unit, pdu });
        }
    }

    fn take(&mut self, now: Instant, door: DoorId, bytes: &[u8], push: fn(&mut Framer, &[u8])) {
        self.segment.set_now(now);
        let (now, timeout_us) = (self.segment.now, self.settings.frame_timeout_us());
        let Some(index) = self.doors.iter().position(|other| other.id == door) else { return };
        let door = &mut self.doors[index];
        if door.framer.is_waiting() && now.since_us(door.heard_at) > timeout_us {
            // Whole frames wait for the reply before them; only what follows them is none.
            let routes = &self.segment.routes;
            while let Some((unit, pdu)) = next_frame(&mut door.framer, routes) {
                let pdu = pdu.to_vec();
                door.queue(Queued { transaction: None, is_left: false, unit, pdu });
            }
            Self::silence(door, &mut self.segment);
        }
        push(&mut door.framer, bytes);
        door.heard_at = now;
    }

    /// The bytes handed in last by a door may have come as late as `now`, because the shell was late to look: the
    /// silence behind them is counted from then, so that no delay of the program passes for one (BUS-5).
    pub fn heard_until(&mut self, now: Instant, door: DoorId) {
        let now = self.segment.inner(now);
        if let Some(door) = self.door(door) {
            door.heard_at = door.heard_at.max(now);
        }
    }

    /// Whether a door takes more without losing some: a shell that can make its client wait does so until then.
    pub fn has_room(&self, door: DoorId) -> bool {
        let door = self.doors.iter().find(|other| other.id == door);
        door.is_some_and(|door| door.requests.len() < QUEUE_MAX && door.framer.has_room())
    }

    /// Whether something that came in by a door is still to be answered, or may be.
    pub fn is_asked(&self, door: DoorId) -> bool {
        let waits = |other: &Door| other.id == door && (!other.requests.is_empty() || other.framer.is_waiting());
        self.doors.iter().any(waits) || self.segment.under_way().any(|reply| reply.door == door)
    }

    /// Whether a reply is under way.
    pub fn is_answering(&self) -> bool {
        self.segment.under_way().next().is_some()
    }

    /// Takes a request of Modbus TCP.
    pub fn receive_pdu(&mut self, now: Instant, door: DoorId, transaction: u16, unit: u8, pdu: &[u8]) {
        self.segment.set_now(now);
        let Some(door) = self.door(door) else { return };
        door.queue(Queued { transaction: Some(transaction), is_left: false, unit, pdu: pdu.to_vec() });
    }

    /// What is to be done now; `None` when all is done until [`Bus::wake_at`].
    pub fn poll(&mut self, now: Instant) -> Option<Output> {
        self.segment.set_now(now);
        loop {
            let segment = &mut self.segment;
            if let Some(output) = segment.outputs.pop_front() {
                // The reply is on its way: what is done about it now keeps nobody waiting.
                match (&output, &mut segment.journal) {
                    (Output::Exchange(exchange), Some(journal)) => journal.push(exchange.clone()),
                    _ => return Some(output),
                }
                match segment.is_observed || segment.watch.is_some() {
                    true => return Some(output),
                    false => continue,
                }
            }
            segment.undo.clear();
            segment.part_late();
            if !segment.faults.is_empty() && self.make_noise() {
                continue;
            }
            let segment = &mut self.segment;
            match segment.next_reply() {
                Poll::Ready(Some(reply)) => {
                    segment.transmit(reply);
                    continue;
                }
                Poll::Pending => return None,
                Poll::Ready(None) => {}
            }
            if !self.next_request() {
                self.segment.housekeep();
                self.segment.look();
                if self.segment.outputs.is_empty() {
                    return None;
                }
            }
        }
    }

    /// Carries out the next request of any door, or what silence tells; `false` when there is none.
    fn next_request(&mut self) -> bool {
        let timeout_us = self.settings.frame_timeout_us();
        for door in &mut self.doors {
            if let Some(request) = door.requests.pop_front() {
                let Queued { transaction, is_left, unit, pdu } = request;
                let (kind, seen, warned) = (door.kind, door.seen, &mut door.warned);
                let door = if is_left { DoorId::NONE } else { door.id };
                self.segment.hear(Heard { door, kind, transaction, seen, warned, unit, pdu: &pdu });
                return true;
            }
            if let Some((unit, pdu)) = next_frame(&mut door.framer, &self.segment.routes) {
                let (kind, seen, warned) = (door.kind, door.seen, &mut door.warned);
                self.segment.hear(Heard { door: door.id, kind, transaction: None, seen, warned, unit, pdu });
                return true;
            }
            if door.framer.is_waiting() && self.segment.now.since_us(door.heard_at) >= timeout_us {
                Self::silence(door, &mut self.segment);
                return true;
            }
        }
        false
    }

    fn silence(door: &mut Door, segment: &mut Segment) {
        let (from, seen) = ((door.id, door.kind), door.seen);
        let (bytes, overlong) = match door.framer.silence() {
            Some(Frame::Damaged(bytes)) => (bytes, false),
            Some(Frame::Overlong(bytes)) => (bytes, true),
            _ => return,
        };
        segment.counters.bad_frames += 1;
        segment.counters.dropped_bytes += bytes.len() as u64;
        if overlong {
            segment.report_damaged(bytes, "more than 256 bytes without a silence are no frame (BUS-1)");
        } else if !segment.damaged(from, seen, bytes) {
            let reason = match bytes.len() {
                0..4 => "fewer than four bytes are no frame (BUS-1)",
                _ if crc16(bytes) == 0 => "the body has the wrong length for its function (BUS-12)",
                _ => "the CRC is wrong (BUS-4)",
            };
            segment.report_damaged(bytes, reason);
        }
    }

    /// The image that was handed out last could not be kept: the write is taken back and answered 04 (BUS-19).
    pub fn keep_failed(&mut self, station: usize, reason: &str) {
        self.segment.keep_failed(station, reason);
    }

    /// Lets noise that is due onto every door but those of Modbus TCP.
    fn make_noise(&mut self) -> bool {
        let segment = &mut self.segment;
        let Some((hit, bytes)) = segment.faults.noise(segment.now) else { return false };
        for door in self.doors.iter().filter(|door| door.kind != DoorKind::Tcp) {
            segment.outputs.push_back(Output::Transmit { door: door.id, transaction: None, bytes: bytes.clone() });
        }
        segment.tell_noise(hit, bytes);
        true
    }

    /// When [`Bus::poll`] has something to do next, if nothing comes in.
    pub fn wake_at(&self) -> Option<Instant> {
        let segment = &self.segment;
        if !segment.outputs.is_empty() {
            return Some(segment.outer(segment.now));
        }
        let late = segment.late.front().map(|reply| reply.due);
        let unasked = segment.faults.noise_at().into_iter().chain(late).min();
        if let Some(reply) = segment.replies.front() {
            return [Some(reply.due), unasked].into_iter().flatten().min().map(|at| segment.outer(at));
        }
        let timeout_us = self.settings.frame_timeout_us();
        let silences = self.doors.iter().filter(|door| door.framer.is_waiting());
        let silences = silences.map(|door| door.heard_at.plus_us(timeout_us));
        let deadlines = segment.stations.iter().filter_map(Station::deadline);
        let wake_at = silences.chain(deadlines).chain(segment.housekeeping_at()).chain(unasked).min();
        wake_at.map(|at| segment.outer(at))
    }

    /// Hands out the images of all stations, where memory is kept: at the end of the program, or when much has happened.
    pub fn save_all(&mut self, now: Instant) {
        self.segment.set_now(now);
        self.segment.live_to(self.segment.now);
        self.segment.persist_all();
    }
}

/// Unit, function and data of the next whole frame, where units that have a route are our own.
fn next_frame<'a>(framer: &'a mut Framer, routes: &[Route; 256]) -> Option<(u8, &'a [u8])> {
    match framer.next_frame(|unit| routes[usize::from(unit)] != Route::Nobody)? {
        Frame::Whole(frame) => frame.split_first().map(|(unit, pdu)| (*unit, pdu)),
        Frame::Damaged(_) | Frame::Overlong(_) => None,
    }
}
