//! Many stations on one line: bytes in, bytes out, delays, broadcasts, collisions. No I/O: after every receive, command
//! or timer the shell drains [`Bus::poll`] and sleeps until [`Bus::wake_at`].
//!
//! A bus has *doors*: a pty, a serial port, a TCP connection. All see one bus; a reply leaves by the door that its
//! request came in by.

mod segment;

use std::collections::{HashSet, VecDeque};

use chrono::NaiveDateTime;

use self::segment::{Heard, Route, Segment};
use crate::line::Line;
use crate::station::{self, Outcome, Saved, Station};
use crate::time::{Instant, Moment, SimClock};
use crate::wire::{Frame, Framer};

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
        let silence_us = if self.line.baud > 19_200 { 1750 } else { self.line.half_characters_us(7) };
        silence_us + self.slack_ms * 1000
    }
}

/// A door of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DoorId(u64);

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
    unit: u8,
    pdu: Vec<u8>,
}

/// The most requests that wait for their turn at one door; more are dropped.
pub const QUEUE_MAX: usize = 64;

/// What the bus wants the shell to do, in this order.
#[derive(Clone, Debug, PartialEq)]
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
    Exchange(Box<Exchange>),
    /// A line for the log.
    Note(String),
}

/// A request and what became of it: what traces, journals and metrics are made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Exchange {
    /// When its last byte was there.
    pub at: Moment,
    /// Microseconds from then until the reply left; 0 without a reply.
    pub reply_us: u64,
    /// The unit that was addressed; 0 is a broadcast.
    pub unit: u8,
    /// Index of the station that it reached.
    pub station: Option<usize>,
    /// In what form it came.
    pub form: Form,
    /// Unit, function and data of the request; all bytes of what is no frame.
    pub request: Vec<u8>,
    /// Unit, function and data of the reply; empty without one.
    pub reply: Vec<u8>,
    /// What became of it.
    pub outcome: Outcome,
}

/// In what form a request came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A frame with a CRC.
    Rtu,
    /// A transaction of Modbus TCP.
    Tcp {
        /// Its number.
        transaction: u16,
    },
    /// Bytes that silence ended and that are no frame.
    Damaged,
}

/// What a bus has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames with a good CRC, other units' included.
    pub frames: u64,
    /// Replies without exceptions.
    pub replies: u64,
    /// Exceptions.
    pub exceptions: u64,
    /// Runs of bytes that silence ended and that were no frame.
    pub bad_frames: u64,
    /// Bytes of those.
    pub dropped_bytes: u64,
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
        self.segment.clock.at(now)
    }

    /// Its clock's rate.
    pub fn rate(&self) -> f64 {
        self.segment.clock.rate()
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
            heard_at: now,
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
        self.segment.replies.retain(|reply| reply.door != door);
        self.segment.outputs.retain(|output| !matches!(output, Output::Transmit { door: to, .. } if *to == door));
    }

    /// Takes bytes that came in by a door.
    pub fn receive(&mut self, now: Instant, door: DoorId, bytes: &[u8]) {
        self.segment.now = self.segment.now.max(now);
        let (now, timeout_us) = (self.segment.now, self.settings.frame_timeout_us());
        let Some(index) = self.doors.iter().position(|other| other.id == door) else { return };
        let door = &mut self.doors[index];
        if door.framer.is_waiting() && now.since_us(door.heard_at) > timeout_us {
            // Whole frames wait for the reply before them; only what follows them is none.
            let routes = &self.segment.routes;
            while let Some(Frame::Whole(frame)) =
                door.framer.next_frame(|unit| routes[usize::from(unit)] != Route::Nobody)
            {
                if door.requests.len() < QUEUE_MAX {
                    door.requests.push_back(Queued { transaction: None, unit: frame[0], pdu: frame[1..].to_vec() });
                }
            }
            Self::silence(door, &mut self.segment);
        }
        door.framer.push(bytes);
        door.heard_at = now;
    }

    /// The bytes handed in last by a door may have come as late as `now`, because the shell was late to look: the
    /// silence behind them is counted from then, so that no delay of the program passes for one (BUS-5).
    pub fn heard_until(&mut self, now: Instant, door: DoorId) {
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
        self.doors.iter().any(waits) || self.segment.replies.iter().any(|reply| reply.door == door)
    }

    /// Whether a reply is under way.
    pub fn is_answering(&self) -> bool {
        !self.segment.replies.is_empty()
    }

    /// Takes a request of Modbus TCP.
    pub fn receive_pdu(&mut self, now: Instant, door: DoorId, transaction: u16, unit: u8, pdu: &[u8]) {
        self.segment.now = self.segment.now.max(now);
        let Some(door) = self.door(door) else { return };
        if door.requests.len() < QUEUE_MAX {
            door.requests.push_back(Queued { transaction: Some(transaction), unit, pdu: pdu.to_vec() });
        }
    }

    /// What is to be done now; `None` when all is done until [`Bus::wake_at`].
    pub fn poll(&mut self, now: Instant) -> Option<Output> {
        self.segment.now = self.segment.now.max(now);
        loop {
            let segment = &mut self.segment;
            if let Some(output) = segment.outputs.pop_front() {
                return Some(output);
            }
            segment.undo.clear();
            if let Some(reply) = segment.replies.front() {
                if reply.due > segment.now {
                    return None;
                }
                segment.transmit();
                continue;
            }
            if !self.next_request() {
                self.segment.housekeep();
                return self.segment.outputs.pop_front();
            }
        }
    }

    /// Carries out the next request of any door, or what silence tells; `false` when there is none.
    fn next_request(&mut self) -> bool {
        let timeout_us = self.settings.frame_timeout_us();
        for door in &mut self.doors {
            if let Some(request) = door.requests.pop_front() {
                let Queued { transaction, unit, pdu } = request;
                let (kind, seen, warned) = (door.kind, door.seen, &mut door.warned);
                self.segment.hear(Heard { door: door.id, kind, transaction, seen, warned, unit, pdu: &pdu });
                return true;
            }
            let routes = &self.segment.routes;
            if let Some(Frame::Whole(frame)) = door.framer.next_frame(|unit| routes[usize::from(unit)] != Route::Nobody)
            {
                let (unit, pdu) = (frame[0], &frame[1..]);
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
        let (id, kind) = (door.id, door.kind);
        let (bytes, overlong) = match door.framer.silence() {
            Some(Frame::Damaged(bytes)) => (bytes, false),
            Some(Frame::Overlong(bytes)) => (bytes, true),
            _ => return,
        };
        segment.counters.bad_frames += 1;
        segment.counters.dropped_bytes += bytes.len() as u64;
        if overlong || !segment.damaged(id, kind, bytes) {
            segment.report_damaged(bytes);
        }
    }

    /// The image that was handed out last could not be kept: the write is taken back and answered 04 (BUS-19).
    pub fn keep_failed(&mut self, station: usize, reason: &str) {
        self.segment.keep_failed(station, reason);
    }

    /// When [`Bus::poll`] has something to do next, if nothing comes in.
    pub fn wake_at(&self) -> Option<Instant> {
        let segment = &self.segment;
        if !segment.outputs.is_empty() {
            return Some(segment.now);
        }
        if let Some(reply) = segment.replies.front() {
            return Some(reply.due);
        }
        let timeout_us = self.settings.frame_timeout_us();
        let silences = self.doors.iter().filter(|door| door.framer.is_waiting());
        let silences = silences.map(|door| door.heard_at.plus_us(timeout_us));
        let deadlines = segment.stations.iter().filter_map(Station::deadline);
        silences.chain(deadlines).chain(segment.housekeeping_at()).min()
    }

    /// Hands out the images of all stations, for the end of the program.
    pub fn save_all(&mut self, now: Instant) {
        self.segment.live_to(now);
        self.segment.persist_all();
    }

    /// Lets a station be changed at `now`: it has lived up to it, and what the change leaves is handed out after it.
    pub fn with_station<R>(&mut self, now: Instant, index: usize, act: impl FnOnce(&mut Station, Moment) -> R) -> R {
        self.segment.live_to(now);
        let moment = self.segment.clock.at(self.segment.now);
        let result = act(&mut self.segment.stations[index], moment);
        self.segment.persist_changed();
        self.segment.route();
        result
    }

    /// Lives up to `now` without waiting for a request: for what looks at the stations.
    pub fn live_to(&mut self, now: Instant) {
        self.segment.live_to(now);
    }

    /// From `now` on the clock runs at `rate` simulated seconds a real second.
    pub fn set_rate(&mut self, now: Instant, rate: f64) {
        self.segment.live_to(now);
        self.segment.clock.set_rate(self.segment.now, rate);
    }

    /// Lets simulated time pass at once; everything in between happens, in order.
    pub fn advance_clock(&mut self, now: Instant, us: i64) {
        self.segment.live_to(now);
        self.segment.clock.advance(self.segment.now, us);
        self.segment.live_to(now);
    }

    /// Moves the civil clock; nothing happens in between.
    pub fn jump_clock(&mut self, now: Instant, civil: NaiveDateTime) {
        self.segment.live_to(now);
        let segment = &mut self.segment;
        let before = segment.clock.at(segment.now);
        segment.clock.jump(segment.now, civil);
        let after = segment.clock.at(segment.now);
        let by_us = crate::time::civil_difference_us(after.civil, before.civil);
        for station in &mut segment.stations {
            station.clock_jumped(by_us, after);
        }
        segment.persist_changed();
        segment.route();
    }

    /// The clock as it is, for a snapshot.
    pub fn clock(&self) -> &SimClock {
        &self.segment.clock
    }

    /// Puts back stations and clock of a snapshot; what was being answered is forgotten.
    pub fn restore(&mut self, clock: SimClock, lives: Vec<station::Live>) {
        let segment = &mut self.segment;
        segment.clock = clock;
        segment.replies.clear();
        segment.undo.clear();
        for (station, live) in segment.stations.iter_mut().zip(lives) {
            station.restore(live);
        }
        segment.persist_all();
        segment.route();
    }
}
