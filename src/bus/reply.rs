//! Replies on their way out, what faults make of them, and what is told of them.

use std::collections::VecDeque;
use std::mem;
use std::sync::Arc;
use std::task::Poll;

use super::segment::{Heard, Route, Segment};
use super::{Bytes, DoorId, DoorKind, Event, Exchange, Form, Output, Timing};
use crate::device::Refusal;
use crate::faults::{Hit, Sent};
use crate::line::Line;
use crate::station::Outcome;
use crate::time::Instant;
use crate::wire::{Exception, Request, append_crc, crc16};

/// A reply that has not left yet, or a piece of one.
#[derive(Debug)]
pub(super) struct Reply {
    pub(super) due: Instant,
    pub(super) door: DoorId,
    transaction: Option<u16>,
    bytes: Vec<u8>,
    /// Unit and function of the reply that these bytes belong to.
    head: [u8; 2],
    heard: Instant,
    /// A fault holds it back: until it leaves, the line is free for other devices.
    is_late: bool,
    /// What is counted and told once these bytes have left; earlier pieces of a reply have none.
    end: Option<End>,
}

/// The most pieces of replies that wait beside the line because faults hold them back; more hold up the line.
const LATE_MAX: usize = 256;

#[derive(Debug)]
struct End {
    is_exception: bool,
    exchange: Option<Arc<Exchange>>,
}

impl Segment {
    /// Queues the reply that is in the scratch buffer, as faults leave it; says when its last byte is due.
    pub(super) fn reply(
        &mut self,
        heard: &Heard,
        (index, line): (usize, &Line),
        request: &Request,
        outcome: Outcome,
        mut hits: Vec<Hit>,
    ) -> Instant {
        let delay_us = self.delay_us(index, line, heard.kind, heard.pdu.len() + 3, self.scratch.len() + 2);
        let mut due = self.now.plus_us(delay_us);
        // With room for the CRC.
        let mut bytes = Vec::with_capacity(self.scratch.len() + 2);
        bytes.extend_from_slice(&self.scratch);
        if heard.transaction.is_none() {
            append_crc(&mut bytes);
        }
        let head = [self.scratch[0], self.scratch[1]];
        let (door, transaction, heard_at) = (heard.door, heard.transaction, self.now);
        // A device that is still at its last answer gives none before that.
        let in_time = due;
        due = self.late.iter().filter(|reply| reply.head[0] == head[0]).map(|reply| reply.due).fold(due, Instant::max);
        let mut is_late = due > in_time;
        let piece =
            |due, bytes, is_late, end| Reply { due, door, transaction, bytes, head, heard: heard_at, is_late, end };
        let mut sent = None;
        if !self.faults.is_empty() {
            let frame = heard.frame();
            let asked = heard.asked(self.now, Some(index), request, &frame);
            let previous = &self.last_replies[index];
            let Sent { delay_us, mut pieces } = self.faults.deform(&asked, &self.scratch, previous, &mut hits);
            let all: Vec<u8> = pieces.iter().flat_map(|(_, bytes)| bytes.iter().copied()).collect();
            sent = (all != bytes).then_some(all);
            due = due.max(in_time.plus_us(delay_us));
            is_late = due > in_time;
            let last = pieces.pop();
            for (gap_us, bytes) in pieces {
                due = due.plus_us(gap_us);
                self.replies.push_back(piece(due, bytes, is_late, None));
            }
            let Some((gap_us, last)) = last else {
                self.last_replies[index].clone_from(&self.scratch);
                self.report(heard, Some(index), Outcome::Silence("a fault left nothing of the reply"), hits);
                return due;
            };
            (due, bytes) = (due.plus_us(gap_us), last);
        }
        self.last_replies[index].clone_from(&self.scratch);
        let is_exception = matches!(outcome, Outcome::Exception(_));
        let exchange = self.is_recording().then(|| {
            let told = self.exchange(heard, Some(index), outcome, hits);
            Arc::new(Exchange { sent, ..told })
        });
        self.replies.push_back(piece(due, bytes, is_late, Some(End { is_exception, exchange })));
        due
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
    pub(super) fn damaged(&mut self, (door, kind): (DoorId, DoorKind), seen: Option<(u32, u8)>, bytes: &[u8]) -> bool {
        let Route::One(index) = self.answering(bytes.first().copied().unwrap_or(0), seen) else { return false };
        if bytes.len() < 4 || crc16(bytes) == 0 || !self.hears(index, seen) {
            return false;
        }
        self.stations[index].advance(&self.clock, self.now);
        if !self.stations[index].answers_crc_errors() {
            return false;
        }
        if let Some(hit) = self.offline() {
            if !self.is_recording() {
                return true;
            }
            let told = self.no_frame(bytes, Outcome::Silence("the bus is offline"));
            self.outputs.push_back(Output::Exchange(Arc::new(Exchange { faults: vec![hit], ..told })));
            return true;
        }
        let frame = vec![bytes[0], bytes[1] | 0x80, Exception::IllegalDataValue as u8];
        let line = self.stations[index].address().line;
        let due = self.now.plus_us(self.delay_us(index, &line, kind, 0, frame.len() + 2));
        let exchange = self.is_recording().then(|| {
            let refusal = Refusal::new(Exception::IllegalDataValue, "the frame's CRC is wrong", "BUS-4");
            let mut told = self.no_frame(bytes, Outcome::Exception(refusal));
            told.station = Some(index);
            told.reply = Bytes::from_slice(&frame);
            Arc::new(told)
        });
        let (head, end) = ([frame[0], frame[1]], Some(End { is_exception: true, exchange }));
        let (heard, is_late) = (self.now, false);
        let mut bytes = frame;
        append_crc(&mut bytes);
        self.replies.push_back(Reply { due, door, transaction: None, bytes, head, heard, is_late, end });
        true
    }

    /// Reports bytes that silence ended and that nobody answers.
    pub(super) fn report_damaged(&mut self, bytes: &[u8], reason: &'static str) {
        if !self.is_recording() {
            return;
        }
        let told = self.no_frame(bytes, Outcome::Silence(reason));
        self.outputs.push_back(Output::Exchange(Arc::new(told)));
    }

    fn no_frame(&self, bytes: &[u8], outcome: Outcome) -> Exchange {
        Exchange {
            at: self.moment(),
            reply_us: 0,
            unit: bytes.first().copied().unwrap_or(0),
            station: None,
            form: Form::Damaged,
            request: Bytes::from_slice(bytes),
            reply: Bytes::new(),
            outcome,
            faults: Vec::new(),
            sent: None,
        }
    }

    fn exchange(&self, heard: &Heard, station: Option<usize>, outcome: Outcome, faults: Vec<Hit>) -> Exchange {
        let is_silent = matches!(outcome, Outcome::Silence(_));
        Exchange {
            at: self.moment(),
            reply_us: 0,
            unit: heard.unit,
            station,
            form: heard.transaction.map_or(Form::Rtu, |transaction| Form::Tcp { transaction }),
            request: heard.frame(),
            reply: if is_silent { Bytes::new() } else { Bytes::from_slice(&self.scratch) },
            outcome,
            faults,
            sent: None,
        }
    }

    /// Tells what became of a request that gets no reply.
    pub(super) fn report(&mut self, heard: &Heard, station: Option<usize>, outcome: Outcome, hits: Vec<Hit>) {
        if self.is_recording() {
            let exchange = self.exchange(heard, station, outcome, hits);
            self.outputs.push_back(Output::Exchange(Arc::new(exchange)));
        }
    }

    /// Whether somebody wants to know what becomes of requests.
    fn is_recording(&self) -> bool {
        self.is_observed || self.journal.is_some()
    }

    /// Tells of noise that a fault made.
    pub(super) fn tell_noise(&mut self, hit: Hit, bytes: Vec<u8>) {
        if let Some(journal) = &mut self.journal {
            journal.count_hit(hit);
        }
        if self.watch.is_some() {
            let at = self.moment();
            self.outputs.push_back(Output::Event(Event::Noise { at, hit, bytes }));
        }
    }

    /// Tells what has changed on the stations since the last look.
    pub(super) fn look(&mut self) {
        let at = self.moment();
        if let Some(watch) = &mut self.watch {
            watch.look(at, &self.stations, &mut self.outputs);
        }
    }

    /// Lets replies that a fault holds back wait beside the line, as far as there is room for them.
    pub(super) fn part_late(&mut self) {
        while self.late.len() < LATE_MAX
            && let Some(index) = self.replies.iter().position(|reply| reply.is_late)
            && let Some(reply) = self.replies.remove(index)
        {
            let place = self.late.partition_point(|other| other.due <= reply.due);
            self.late.insert(place, reply);
        }
    }

    /// All replies that have not left yet.
    pub(super) fn under_way(&self) -> impl Iterator<Item = &Reply> {
        self.replies.iter().chain(&self.late)
    }

    /// Forgets replies that have not left yet; that they were asked for is told all the same.
    pub(super) fn abandon(&mut self, reason: &'static str, is_meant: impl Fn(&Reply) -> bool) {
        for replies in [&mut self.replies, &mut self.late] {
            let (gone, rest) = mem::take(replies).into_iter().partition::<VecDeque<_>, _>(&is_meant);
            *replies = rest;
            for mut exchange in gone.into_iter().filter_map(|reply| reply.end?.exchange) {
                let told = Arc::make_mut(&mut exchange);
                told.outcome = Outcome::Silence(reason);
                told.reply.clear();
                told.sent = None;
                self.outputs.push_back(Output::Exchange(exchange));
            }
        }
    }

    /// The next reply; pending while the line is taken by one that is not due yet.
    pub(super) fn next_reply(&mut self) -> Poll<Option<Reply>> {
        let now = self.now;
        let is_due = |reply: &Reply| reply.due <= now;
        if self.late.front().is_some_and(is_due) {
            return Poll::Ready(self.late.pop_front());
        }
        match self.replies.front() {
            Some(reply) if !is_due(reply) => Poll::Pending,
            _ => Poll::Ready(self.replies.pop_front()),
        }
    }

    /// Lets a reply go.
    pub(super) fn transmit(&mut self, reply: Reply) {
        let Reply { door, transaction, bytes, heard, end, .. } = reply;
        self.outputs.push_back(Output::Transmit { door, transaction, bytes });
        let Some(End { is_exception, exchange }) = end else { return };
        match is_exception {
            true => self.counters.exceptions += 1,
            false => self.counters.replies += 1,
        }
        if let Some(mut exchange) = exchange {
            Arc::make_mut(&mut exchange).reply_us = self.now.since_us(heard);
            self.outputs.push_back(Output::Exchange(exchange));
        }
    }

    /// Answers 04 in place of what waits to leave (BUS-19); no fault touches that.
    pub(super) fn refuse_replies(&mut self, reason: &str) {
        while self.replies.len() > 1 && self.replies.front().is_some_and(|reply| reply.end.is_none()) {
            self.replies.pop_front();
        }
        for reply in &mut self.replies {
            reply.bytes = vec![reply.head[0], reply.head[1] | 0x80, Exception::DeviceFailure as u8];
            if let Some(end) = &mut reply.end {
                end.is_exception = true;
                if let Some(exchange) = &mut end.exchange {
                    let exchange = Arc::make_mut(exchange);
                    let refusal = Refusal::new(Exception::DeviceFailure, reason.to_owned(), "BUS-19");
                    exchange.reply = Bytes::from_slice(&reply.bytes);
                    exchange.outcome = Outcome::Exception(refusal);
                    exchange.sent = None;
                }
            }
            if reply.transaction.is_none() {
                append_crc(&mut reply.bytes);
            }
        }
    }
}
