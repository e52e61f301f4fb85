//! What a bus tells of what happens on it: requests and what became of them, changes of its devices, counts.

use smallvec::SmallVec;

use crate::faults::Hit;
use crate::image::Member;
use crate::station::Outcome;
use crate::time::Moment;

/// A message that is mostly short: one that fits takes no allocation, and each request that is journalled has two.
pub type Bytes = SmallVec<[u8; 32]>;

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
    pub request: Bytes,
    /// Unit, function and data of the reply; empty without one.
    pub reply: Bytes,
    /// What became of it.
    pub outcome: Outcome,
    /// The faults that hit it, in their order.
    pub faults: Vec<Hit>,
    /// The bytes that left, where faults made others of the reply.
    pub sent: Option<Vec<u8>>,
}

impl Exchange {
    /// The function code of the request; 0 where it has none.
    pub fn function(&self) -> u8 {
        self.request.get(1).copied().unwrap_or(0)
    }

    /// The code of the exception that answered it.
    pub fn exception_code(&self) -> Option<u8> {
        let is_exception = matches!(self.outcome, Outcome::Exception(_));
        is_exception.then(|| self.reply.get(2).copied().unwrap_or(0))
    }
}

/// Something that happened and is no request.
#[derive(Clone, Debug)]
pub enum Event {
    /// A register holds another number than at the last look.
    Change {
        /// When that was seen.
        at: Moment,
        /// Index of the station.
        station: usize,
        /// The register.
        member: Member,
        /// Decimal digits of its value.
        scale: u8,
        /// Its raw number before.
        before: i64,
        /// Its raw number now.
        after: i64,
    },
    /// A device has started.
    Boot {
        /// When that was seen.
        at: Moment,
        /// Index of the station.
        station: usize,
        /// How often it has started.
        boots: u32,
    },
    /// A device has lost or regained its power.
    Power {
        /// When that was seen.
        at: Moment,
        /// Index of the station.
        station: usize,
        /// Whether it has power.
        is_powered: bool,
    },
    /// A fault put bytes on the line that nobody asked for.
    Noise {
        /// When.
        at: Moment,
        /// The fault.
        hit: Hit,
        /// The bytes.
        bytes: Vec<u8>,
    },
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
