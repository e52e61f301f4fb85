//! Finds frames in a stream of bytes (BUS-1, BUS-5, BUS-6).
//!
//! A frame ends as soon as a length that its function code allows has a good CRC: the length of a request and, for
//! units that are not ours, that of a reply too, because on a shared line the other devices' replies pass by. For our
//! own units only a request's length counts, so that no request can be mistaken for a short reply. What does not end
//! so is kept until the line falls silent, and is then handed out as damaged. Knows no time: the bus tells it of
//! silence, and of the units that are ours.
//!
//! Where several lengths are allowed, the CRC of a frame's first bytes is good by chance once in 65536: such a frame would
//! end too early, and what follows it would be lost. So it is followed on to its longest, and the next frame is looked for
//! behind each length that it may have.

use super::crc::{CRC_START, crc_step};
use super::pdu::function::{
    READ_COILS, READ_INPUT_REGISTERS, WRITE_MULTIPLE_COILS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_COIL,
    WRITE_SINGLE_REGISTER,
};

/// The most bytes of a frame: unit, function, data, CRC (BUS-1).
pub const FRAME_MAX: usize = 256;

/// The most bytes that wait while the bus is busy; a client that sends on without reading loses the rest.
const WAITING_MAX: usize = 16 * 1024;

/// Bytes of the CRC.
const CRC_BYTES: usize = 2;

/// The fewest bytes of a frame.
const FRAME_MIN: usize = 4;

/// What the framer found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// Unit, function and data of a frame whose CRC is good; the CRC is cut off.
    Whole(&'a [u8]),
    /// Bytes that silence ended and that are no frame.
    Damaged(&'a [u8]),
    /// More than the longest frame without a silence; its first bytes.
    Overlong(&'a [u8]),
}

/// Takes bytes as they come and gives frames.
#[derive(Clone, Debug, Default)]
pub struct Framer {
    bytes: Vec<u8>,
    /// What is before this has been looked at.
    read: usize,
    /// Where the last frame ended.
    start: usize,
    /// Where the frame that is being read may start, ascending.
    starts: Vec<Start>,
    /// So many zero bytes behind the last frame may belong to it.
    strays: usize,
    /// What is before this may begin with a part of a frame that another client has left (BUS-23).
    mixed_to: usize,
    /// More than the longest frame came without a silence: only silence helps (BUS-1).
    overrun: bool,
}

/// A place where a frame may start.
#[derive(Clone, Copy, Debug)]
struct Start {
    at: usize,
    /// The CRC of what has been looked at from here on.
    crc: u16,
    /// So many zero bytes from here on may be the end of the frame before: a CRC that ends in zeros is good without
    /// them too, and only a request's known length tells that they belong to it.
    strays: usize,
    /// A frame that starts here has been handed out, and is followed on because it may be longer.
    is_told: bool,
}

impl Start {
    fn new(at: usize, strays: usize) -> Self {
        Self { at, crc: CRC_START, strays, is_told: false }
    }
}

impl Framer {
    /// Takes bytes off the line; what is more than may wait is lost.
    pub fn push(&mut self, bytes: &[u8]) {
        let needed = self.starts.first().map_or(self.start, |first| first.at.min(self.start));
        if needed > 0 {
            self.bytes.drain(..needed);
            self.read -= needed;
            self.start -= needed;
            self.mixed_to = self.mixed_to.saturating_sub(needed);
            for start in &mut self.starts {
                start.at -= needed;
            }
        }
        if self.overrun {
            return;
        }
        let room = WAITING_MAX.saturating_sub(self.bytes.len() - self.start);
        self.bytes.extend_from_slice(&bytes[..bytes.len().min(room)]);
    }

    /// Takes bytes that may begin with half a frame of another client, nobody knows how much: a frame may start at any of
    /// them, and those that belong to none are dropped (BUS-23).
    pub fn push_mixed(&mut self, bytes: &[u8]) {
        self.push(bytes);
        self.mixed_to = self.bytes.len();
    }

    /// The next whole frame, as soon as its last byte is there. `ours` tells the units that are served here.
    pub fn next_frame(&mut self, ours: impl Fn(u8) -> bool) -> Option<Frame<'_>> {
        while self.read < self.bytes.len() {
            if let Some(from) = self.step(&ours) {
                return Some(Frame::Whole(&self.bytes[from..self.read - CRC_BYTES]));
            }
        }
        None
    }

    /// Looks at one more byte, and tells where the frame starts that it ends.
    fn step(&mut self, ours: &impl Fn(u8) -> bool) -> Option<usize> {
        if self.starts.is_empty() && self.read == self.start {
            self.starts.push(Start::new(self.start, self.strays));
        } else if (1..=self.mixed_to).contains(&self.read) && self.starts.last().is_none_or(|last| last.at < self.read)
        {
            self.starts.push(Start::new(self.read, 0));
        }
        let (byte, end) = (self.bytes[self.read], self.read + 1);
        self.read = end;
        let (mut is_end, mut strays) = (false, 0);
        // The frame that is handed out: the first of our own, else the first.
        let mut found: Option<(usize, bool)> = None;
        for start in &mut self.starts {
            start.crc = crc_step(start.crc, byte);
            if byte == 0 && end - start.at == 1 {
                strays = start.strays;
            }
            let frame = &self.bytes[start.at..end];
            if start.crc == 0 && may_end(frame, ours) {
                is_end = true;
                let is_new = !std::mem::replace(&mut start.is_told, true);
                let is_own = is_ours(frame[0], ours);
                if is_new && found.is_none_or(|(_, is_found_own)| is_own && !is_found_own) {
                    found = Some((start.at, is_own));
                }
            }
        }
        if let Some((from, true)) = found {
            // It was a frame, so nothing else that it might have been was one.
            self.starts.retain(|start| start.at == from);
        }
        let bytes = &self.bytes;
        self.starts.retain(|start| end - start.at < longest(&bytes[start.at..end], ours));
        if is_end {
            let is_certain = found.is_some_and(|(from, _)| ends_for_certain(&bytes[from..end], ours));
            (self.start, self.strays) = (end, if is_certain { 0 } else { CRC_BYTES });
            self.starts.push(Start::new(end, self.strays));
        } else if strays > 0 {
            self.starts.push(Start::new(end, strays - 1));
        } else if end > self.start.max(self.mixed_to) + FRAME_MAX + self.strays {
            self.overrun = true;
            self.starts.clear();
            self.bytes.truncate(self.start + FRAME_MAX);
            self.read = self.bytes.len();
        }
        found.map(|(from, _)| from)
    }

    /// The line fell silent: what was not a frame until now is none.
    pub fn silence(&mut self) -> Option<Frame<'_>> {
        if std::mem::take(&mut self.mixed_to) > self.start {
            (self.start, self.overrun) = (self.bytes.len(), false);
        }
        self.bytes.drain(..self.start);
        self.starts.clear();
        let strays = std::mem::take(&mut self.strays);
        if self.bytes.len() <= strays && self.bytes.iter().all(|byte| *byte == 0) {
            self.bytes.clear();
        }
        let is_overlong = std::mem::take(&mut self.overrun) || self.bytes.len() > FRAME_MAX;
        self.bytes.truncate(FRAME_MAX);
        // The bytes are handed out once and forgotten with the next push.
        (self.start, self.read) = (self.bytes.len(), self.bytes.len());
        match is_overlong {
            true => Some(Frame::Overlong(&self.bytes)),
            false => (!self.bytes.is_empty()).then_some(Frame::Damaged(&self.bytes)),
        }
    }

    /// Whether bytes are waiting for the rest of their frame, or for silence.
    pub fn is_waiting(&self) -> bool {
        self.start < self.bytes.len()
    }

    /// Whether a whole read of the shell still fits; what came without a silence and is no frame takes no room.
    pub fn has_room(&self) -> bool {
        self.bytes.len() - self.start <= WAITING_MAX / 2
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

fn is_ours(unit: u8, ours: impl Fn(u8) -> bool) -> bool {
    unit == 0 || ours(unit)
}

/// Whether the length of a frame follows from its bytes, so that not the CRC alone tells where it ends.
fn ends_for_certain(frame: &[u8], ours: impl Fn(u8) -> bool) -> bool {
    is_ours(frame[0], ours)
        && matches!(frame[1], READ_COILS..=WRITE_SINGLE_REGISTER | WRITE_MULTIPLE_COILS..=WRITE_MULTIPLE_REGISTERS)
}

/// Whether a frame may be as long as this, its CRC being good.
fn may_end(frame: &[u8], ours: impl Fn(u8) -> bool) -> bool {
    let length = frame.len();
    let is_allowed = |(one, other): (usize, usize)| length == one || length == other;
    (FRAME_MIN..=FRAME_MAX).contains(&length) && lengths(frame, ours).is_none_or(is_allowed)
}

/// The most bytes that the frame may have that begins so.
fn longest(begun: &[u8], ours: impl Fn(u8) -> bool) -> usize {
    let longest = lengths(begun, ours).map_or(FRAME_MAX, |(one, other)| one.max(other));
    longest.min(FRAME_MAX)
}

/// The two lengths that are allowed for the frame that begins so: a request's and a reply's, or twice the same. `None`
/// where only the CRC tells where it ends, or not enough of it is there.
fn lengths(begun: &[u8], ours: impl Fn(u8) -> bool) -> Option<(usize, usize)> {
    let &[unit, function, ..] = begun else { return None };
    let is_ours = is_ours(unit, ours);
    let counted = |at: usize, rest: usize| begun.get(at).map_or(FRAME_MAX, |count| usize::from(*count) + rest);
    let (request, reply) = match function {
        READ_COILS..=READ_INPUT_REGISTERS => (8, counted(2, 5)),
        WRITE_SINGLE_COIL | WRITE_SINGLE_REGISTER => (8, 8),
        WRITE_MULTIPLE_COILS | WRITE_MULTIPLE_REGISTERS => (counted(6, 9), 8),
        0x80.. if !is_ours => (5, 5),
        _ => return None,
    };
    Some((request, if is_ours { request } else { reply }))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::wire::append_crc;

    fn framed(bytes: &[u8]) -> Vec<u8> {
        let mut frame = bytes.to_vec();
        append_crc(&mut frame);
        frame
    }

    fn all(framer: &mut Framer) -> Vec<Vec<u8>> {
        let mut frames = Vec::new();
        while let Some(Frame::Whole(frame)) = framer.next_frame(|unit| unit == 1) {
            frames.push(frame.to_vec());
        }
        frames
    }

    #[test]
    fn bus_5_byte_by_byte_ends_at_the_last_byte() {
        let mut framer = Framer::default();
        let frame = framed(&[1, 0x10, 0, 0x10, 0, 2, 4, 0, 14, 0, 11]);
        for (index, byte) in frame.iter().enumerate() {
            framer.push(&[*byte]);
            let found = all(&mut framer);
            assert_eq!(found.len(), usize::from(index + 1 == frame.len()));
        }
        assert!(!framer.is_waiting());
    }

    #[test]
    fn bus_6_a_foreign_reply_ends_its_frame() {
        let reply = framed(&[9, 3, 4, 1, 2, 3, 4]);
        let request = framed(&[1, 3, 0, 0x10, 0, 7]);
        let refused = framed(&[9, 0x83, 2]);
        let mut framer = Framer::default();
        framer.push(&[reply, refused, request].concat());
        assert_eq!(all(&mut framer), [vec![9, 3, 4, 1, 2, 3, 4], vec![9, 0x83, 2], vec![1, 3, 0, 0x10, 0, 7]]);
    }

    #[test]
    fn bus_6_a_crc_that_ends_in_zero_leaves_nothing_behind() {
        let request = framed(&[1, 3, 0, 0x10, 0, 7]);
        // The reply of a foreign device that is also good one byte earlier, where a request would end; and an unknown
        // function of our own.
        let reply = (0..=u8::MAX).map(|low| framed(&[9, 3, 4, 1, 2, 3, low])).find(|frame| frame.ends_with(&[0]));
        let unknown = (0..=u8::MAX).map(|low| framed(&[1, 0x2B, 0x0E, low])).find(|frame| frame.ends_with(&[0]));
        for (first, cut) in [(reply.unwrap(), 1), (unknown.unwrap(), 1)] {
            let mut framer = Framer::default();
            framer.push(&first);
            assert_eq!(all(&mut framer), [first[..first.len() - 2 - cut].to_vec()]);
            framer.push(&request);
            assert_eq!(all(&mut framer), [request[..6].to_vec()]);
            framer.push(&first);
            assert_eq!(all(&mut framer).len(), 1);
            assert_eq!(framer.silence(), None);
            assert!(!framer.is_waiting());
        }
    }

    #[test]
    fn bus_5_what_ends_first_is_the_frame_however_bytes_are_cut() {
        // Zeros may lie between the first frame and the second. Taken for a broadcast of an unknown function they make a
        // longer frame, whose CRC is good too.
        let foreign = framed(&[9, 6, 0, 2, 0, 2]);
        let request = framed(&[1, 6, 0, 2, 0, 2]);
        let longer = framed(&[&[0, 0], request.as_slice(), &[1, 2, 3]].concat());
        let stream = [foreign.as_slice(), &longer].concat();
        for piece in [1, 3, stream.len()] {
            let mut framer = Framer::default();
            let mut found = Vec::new();
            for bytes in stream.chunks(piece) {
                framer.push(bytes);
                found.extend(all(&mut framer));
            }
            assert_eq!(found, [foreign[..6].to_vec(), request[..6].to_vec()], "{piece} bytes at a time");
        }
    }

    #[test]
    fn bus_1_the_longest_frame_is_found_behind_zeros_too_however_bytes_are_cut() {
        let foreign = framed(&[9, 6, 0, 2, 0, 2]);
        let longest = framed(&[&[9, 3, 251][..], &[7; 251]].concat());
        assert_eq!(longest.len(), FRAME_MAX);
        let stream = [foreign.as_slice(), &[0, 0], &longest].concat();
        for piece in [1, stream.len()] {
            let mut framer = Framer::default();
            let mut found = Vec::new();
            for bytes in stream.chunks(piece) {
                framer.push(bytes);
                found.extend(all(&mut framer));
            }
            assert_eq!(found.len(), 2, "{piece} bytes at a time");
        }
    }

    #[test]
    fn bus_6_a_foreign_frame_whose_first_bytes_have_a_good_crc_loses_nothing() {
        let longer = |begun: &[u8], rest: &[u8]| framed(&[begun, rest].concat());
        // A reply of six registers, whose first eight bytes are a request too.
        let reply = longer(&framed(&[9, 3, 12, 1, 2, 3]), &[7; 7]);
        // A question for some registers, whose first five bytes are an empty reply too.
        let question = longer(&framed(&[9, 3, 0]), &[5]);
        // A write of two registers, whose first eight bytes are its reply too.
        let mut written = (0..=u16::MAX).map(|at| framed(&[&[9, 16], &at.to_be_bytes()[..], &[0, 2]].concat()));
        let written = written.find(|frame| frame[6] == 4);
        let write = longer(&written.unwrap(), &[2, 3, 4]);
        // A function that only the CRC ends, with two such places.
        let records = longer(&longer(&framed(&[9, 0x14, 200, 6, 1, 2]), &[0x55; 30]), &[0xAA; 150]);
        let request = framed(&[1, 3, 0, 0x10, 0, 7]);
        for foreign in [reply, write, question, records] {
            for piece in [1, foreign.len(), 300] {
                let mut framer = Framer::default();
                let mut found = Vec::new();
                for _ in 0..3 {
                    for bytes in [foreign.as_slice(), &request].concat().chunks(piece) {
                        framer.push(bytes);
                        found.extend(all(&mut framer).into_iter().filter(|frame| frame[0] == 1));
                    }
                }
                assert_eq!(found, vec![request[..6].to_vec(); 3], "{foreign:02X?}, {piece} bytes at a time");
                assert!(!framer.is_waiting());
            }
        }
    }

    #[test]
    fn bus_23_half_a_frame_of_another_client_hides_nothing() {
        let request = framed(&[1, 3, 0, 0x10, 0, 7]);
        let (half, rest) = request.split_at(5);
        for left in [&[][..], &request[..1], half, &[half, half].concat(), &[1; 300]] {
            for come in 0..=request.len() {
                let mut framer = Framer::default();
                framer.push_mixed(&[left, &request[..come]].concat());
                let mut found = all(&mut framer);
                framer.push(&request[come..]);
                found.extend(all(&mut framer));
                assert_eq!(found, [request[..6].to_vec()], "{} bytes left, {come} come", left.len());
                assert!(!framer.is_waiting());
            }
        }
        // What nobody completes is dropped, and the next one's damage is damage again.
        let mut framer = Framer::default();
        framer.push_mixed(half);
        assert_eq!(all(&mut framer), Vec::<Vec<u8>>::new());
        assert_eq!(framer.silence(), None);
        framer.push(rest);
        assert_eq!(framer.silence(), Some(Frame::Damaged(rest)));
    }

    #[test]
    fn bus_3_a_broadcast_right_behind_a_foreign_reply() {
        let reply = framed(&[9, 3, 4, 1, 2, 3, 4]);
        let broadcast = framed(&[0, 6, 0, 0x10, 0, 7]);
        let mut framer = Framer::default();
        framer.push(&[reply, broadcast].concat());
        assert_eq!(all(&mut framer), [vec![9, 3, 4, 1, 2, 3, 4], vec![0, 6, 0, 0x10, 0, 7]]);
    }

    #[test]
    fn bus_1_more_than_256_bytes_are_no_frame() {
        let mut framer = Framer::default();
        framer.push(&[0xFF; 300]);
        assert_eq!(framer.next_frame(|unit| unit == 1), None);
        framer.push(&framed(&[1, 3, 0, 0x10, 0, 7]));
        assert_eq!(framer.next_frame(|unit| unit == 1), None);
        assert!(matches!(framer.silence(), Some(Frame::Overlong(_))));
        framer.push(&framed(&[1, 3, 0, 0x10, 0, 7]));
        assert!(framer.next_frame(|unit| unit == 1).is_some());
    }

    #[test]
    fn bus_12_a_known_function_of_the_wrong_length_waits_for_silence() {
        let mut framer = Framer::default();
        framer.push(&framed(&[1, 3, 0, 0x10, 0]));
        assert_eq!(framer.next_frame(|unit| unit == 1), None);
        assert!(framer.silence().is_some());
        assert!(!framer.is_waiting());
    }
}
