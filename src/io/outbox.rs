//! What a port has not taken yet: replies wait here, in bounded room.

use std::io::{self, ErrorKind};

/// The most bytes that wait. A client that reads nothing while it asks for more than this loses replies, as it would
/// on a line.
const WAITING_MAX: usize = 64 * 1024;

/// Bytes on their way out of a port.
#[derive(Debug, Default)]
pub struct Outbox {
    bytes: Vec<u8>,
    /// How many of them are gone.
    sent: usize,
}

impl Outbox {
    /// Sends a frame, behind those that wait; what the port does not take now waits. A frame that finds no room is
    /// dropped whole.
    ///
    /// # Errors
    /// The port's own.
    pub fn send(&mut self, frame: &[u8], mut write: impl FnMut(&[u8]) -> io::Result<usize>) -> io::Result<()> {
        let taken = if self.is_empty() { write_most(frame, &mut write)? } else { 0 };
        self.bytes.drain(..std::mem::take(&mut self.sent));
        if self.bytes.len() + frame.len() - taken <= WAITING_MAX || taken > 0 {
            self.bytes.extend_from_slice(&frame[taken..]);
        }
        Ok(())
    }

    /// Sends what waits, as far as the port takes it.
    ///
    /// # Errors
    /// The port's own.
    pub fn flush(&mut self, mut write: impl FnMut(&[u8]) -> io::Result<usize>) -> io::Result<()> {
        self.sent += write_most(&self.bytes[self.sent..], &mut write)?;
        if self.is_empty() {
            self.clear();
        }
        Ok(())
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.sent == self.bytes.len()
    }

    /// Whether the client reads so slowly that it should not be asked for more.
    pub fn is_crowded(&self) -> bool {
        self.bytes.len() - self.sent > WAITING_MAX / 2
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.sent = 0;
    }
}

/// Writes as much as is taken without waiting.
fn write_most(bytes: &[u8], write: &mut impl FnMut(&[u8]) -> io::Result<usize>) -> io::Result<usize> {
    let mut taken = 0;
    while taken < bytes.len() {
        match write(&bytes[taken..]) {
            Ok(0) => break,
            Ok(count) => taken += count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(taken)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A port that takes `room` bytes.
    fn port(taken: &mut Vec<u8>, room: usize) -> impl FnMut(&[u8]) -> io::Result<usize> + '_ {
        let mut room = room;
        move |bytes| {
            if room == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            let count = bytes.len().min(room);
            room -= count;
            taken.extend_from_slice(&bytes[..count]);
            Ok(count)
        }
    }

    #[test]
    fn frames_leave_whole_and_in_order() {
        let (mut outbox, mut taken) = (Outbox::default(), Vec::new());
        outbox.send(b"first", port(&mut taken, 3)).unwrap();
        outbox.send(b"second", port(&mut taken, 99)).unwrap();
        assert_eq!(taken, b"fir");
        outbox.flush(port(&mut taken, 4)).unwrap();
        assert!(!outbox.is_empty());
        outbox.flush(port(&mut taken, 99)).unwrap();
        assert_eq!((taken.as_slice(), outbox.is_empty()), (&b"firstsecond"[..], true));
    }

    #[test]
    fn a_client_that_does_not_read_takes_bounded_room() {
        let (mut outbox, mut taken) = (Outbox::default(), Vec::new());
        for number in 0..=u16::MAX {
            outbox.send(&number.to_be_bytes().repeat(50), port(&mut taken, 0)).unwrap();
        }
        assert!(outbox.is_crowded());
        outbox.flush(port(&mut taken, usize::MAX)).unwrap();
        assert_eq!(taken.len(), WAITING_MAX / 100 * 100, "whole frames, and no more than fit");
        assert_eq!(taken[taken.len() - 2..], 654_u16.to_be_bytes(), "the oldest");
    }
}
