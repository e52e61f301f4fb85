//! Finds frames in a stream of bytes (BUS-1, BUS-5, BUS-6).
//!
//! A frame ends as soon as a length that its function code allows has a good CRC: the length of a request and, for
//! units that are not ours, that of a reply too, because on a shared line the other devices' replies pass by. For our
//! own units only a request's length counts, so that no request can be mistaken for a short reply. What does not end
//! so is kept until the line falls silent, and is then handed out as damaged. Knows no time: the bus tells it of
//! silence, and of the units that are ours.

use super::crc::crc16;
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
    /// Where the frame that is being read starts.
    start: usize,
    /// Lengths below this have been tried.
    tried: usize,
    /// More than the longest frame came without a silence: only silence helps (BUS-1).
    overrun: bool,
    /// So many zero bytes at the start may be the end of the frame before: a CRC that ends in zeros is good without
    /// them too, and only a request's known length tells that they belong to it.
    strays: usize,
}

impl Framer {
    /// Takes bytes off the line; what is more than may wait is lost.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.start > 0 {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        if self.overrun {
            return;
        }
        let room = WAITING_MAX.saturating_sub(self.bytes.len());
        self.bytes.extend_from_slice(&bytes[..bytes.len().min(room)]);
    }

    /// The next whole frame, as soon as its last byte is there. `ours` tells the units that are served here.
    pub fn next_frame(&mut self, ours: impl Fn(u8) -> bool) -> Option<Frame<'_>> {
        if self.overrun {
            return None;
        }
        let bytes = &self.bytes[self.start..];
        let found = (0..=self.strays).filter_map(|skip| {
            let (strays, rest) = bytes.split_at_checked(skip)?;
            let length = whole_length(rest, self.tried.saturating_sub(skip), &ours)?;
            strays.iter().all(|byte| *byte == 0).then_some((skip, length))
        });
        // The one that ends first, as it would if the bytes came one by one.
        let Some((skip, length)) = found.min_by_key(|(skip, length)| skip + length) else {
            let longest = FRAME_MAX + self.strays;
            self.tried = bytes.len().min(longest);
            if bytes.len() > longest {
                self.overrun = true;
                self.bytes.truncate(self.start + FRAME_MAX);
            }
            return None;
        };
        let start = self.start + skip;
        self.start = start + length;
        self.tried = 0;
        self.strays = if ends_for_certain(&self.bytes[start..], &ours) { 0 } else { CRC_BYTES };
        Some(Frame::Whole(&self.bytes[start..self.start - CRC_BYTES]))
    }

    /// The line fell silent: what was not a frame until now is none.
    pub fn silence(&mut self) -> Option<Frame<'_>> {
        let start = std::mem::replace(&mut self.start, 0);
        if start > 0 {
            self.bytes.drain(..start);
        }
        self.tried = 0;
        let strays = std::mem::take(&mut self.strays);
        if self.bytes.len() <= strays && self.bytes.iter().all(|byte| *byte == 0) {
            self.bytes.clear();
        }
        let is_overlong = std::mem::take(&mut self.overrun) || self.bytes.len() > FRAME_MAX;
        self.bytes.truncate(FRAME_MAX);
        // The bytes are handed out once and forgotten with the next push.
        self.start = self.bytes.len();
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

/// Whether the length of a frame follows from its bytes, so that not the CRC alone tells where it ends.
fn ends_for_certain(frame: &[u8], ours: impl Fn(u8) -> bool) -> bool {
    (frame[0] == 0 || ours(frame[0]))
        && matches!(frame[1], READ_COILS..=WRITE_SINGLE_REGISTER | WRITE_MULTIPLE_COILS..=WRITE_MULTIPLE_REGISTERS)
}

/// The length of the frame at the start of `bytes`, if one is whole. Lengths of `tried` and below had no good CRC.
fn whole_length(bytes: &[u8], tried: usize, ours: impl Fn(u8) -> bool) -> Option<usize> {
    if bytes.len() < FRAME_MIN {
        return None;
    }
    let ours = bytes[0] == 0 || ours(bytes[0]);
    let good = |length: usize| {
        let new = length > tried && (FRAME_MIN..=FRAME_MAX.min(bytes.len())).contains(&length);
        (new && crc16(&bytes[..length]) == 0).then_some(length)
    };
    let counted = |at: usize, rest: usize| bytes.get(at).map_or(0, |count| usize::from(*count) + rest);
    let (request, reply) = match bytes[1] {
        READ_COILS..=READ_INPUT_REGISTERS => (8, counted(2, 5)),
        WRITE_SINGLE_COIL | WRITE_SINGLE_REGISTER => (8, 8),
        WRITE_MULTIPLE_COILS | WRITE_MULTIPLE_REGISTERS => (counted(6, 9), 8),
        0x80.. if !ours => (5, 5),
        // Of an unknown function only the CRC tells where it ends.
        _ => return (FRAME_MIN.max(tried + 1)..=bytes.len().min(FRAME_MAX)).find_map(good),
    };
    if ours { good(request) } else { good(request.min(reply)).or_else(|| good(request.max(reply))) }
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
