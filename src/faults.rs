//! Faults made on purpose: requests that get lost, replies that come late, damaged or wrong. They compose in the order
//! in which they were given, count what they hit, and a seed makes them repeat exactly.
//!
//! Knows requests, replies and registers; no line, no ports and no time but what it is handed.

use oorandom::Rand64;

use crate::image::Member;
use crate::map::Bank;
use crate::time::Instant;
use crate::wire::append_crc;

/// A fault that somebody asked for.
#[derive(Clone, Debug)]
pub struct Fault {
    /// Its number, unique in the program.
    pub id: u64,
    /// What it does.
    pub kind: FaultKind,
    /// What it may hit.
    pub target: Target,
    /// How likely it hits what it may hit, 0 to 1.
    pub probability: f64,
    /// After so many hits it is spent.
    pub count: Option<u64>,
    /// After so much elapsed time, in microseconds, it is spent.
    pub lasts_us: Option<u64>,
    /// What its chance is drawn from: the same seed and the same requests give the same bytes.
    pub seed: u64,
}

/// What a fault does.
#[derive(Clone, Copy, Debug)]
pub enum FaultKind {
    /// The request is lost: the device never sees it.
    Drop,
    /// The reply comes later, by `ms` and up to `jitter_ms` more.
    Delay {
        /// Milliseconds, always.
        ms: u64,
        /// The most of the milliseconds that chance adds.
        jitter_ms: u64,
    },
    /// The device does not carry the request out and answers this exception.
    Exception {
        /// Exception code, 1 to 255.
        code: u8,
    },
    /// The reply's CRC is wrong.
    BadCrc,
    /// The reply's last bytes are missing.
    Truncate {
        /// How many.
        bytes: usize,
    },
    /// Random bytes come with the reply.
    Garbage {
        /// How many.
        bytes: usize,
        /// On which side of it.
        place: Place,
    },
    /// The reply carries the next unit's number.
    WrongUnit,
    /// The reply carries the next function's code.
    WrongFunction,
    /// The reply comes in two pieces.
    Split {
        /// Bytes of the first piece.
        at: usize,
        /// Milliseconds between them.
        gap_ms: u64,
    },
    /// The device's previous reply comes once more in place of this one.
    Stale,
    /// The request comes back before the reply, as from a two-wire adapter.
    Echo,
    /// The cable of the bus is pulled.
    Offline,
    /// Bytes that nobody asked for.
    Noise {
        /// Bursts a minute, on the average.
        per_minute: u32,
    },
    /// Reads show this number, whatever the register holds.
    StuckRegister {
        /// The register.
        member: Member,
        /// Its words on the wire.
        words: [u16; 2],
        /// The raw number that they stand for.
        value: i64,
    },
}

impl FaultKind {
    /// Its name in the control interface.
    pub fn name(&self) -> &'static str {
        match self {
            FaultKind::Drop => "drop",
            FaultKind::Delay { .. } => "delay",
            FaultKind::Exception { .. } => "exception",
            FaultKind::BadCrc => "bad_crc",
            FaultKind::Truncate { .. } => "truncate",
            FaultKind::Garbage { .. } => "garbage",
            FaultKind::WrongUnit => "wrong_unit",
            FaultKind::WrongFunction => "wrong_function",
            FaultKind::Split { .. } => "split",
            FaultKind::Stale => "stale",
            FaultKind::Echo => "echo",
            FaultKind::Offline => "offline",
            FaultKind::Noise { .. } => "noise",
            FaultKind::StuckRegister { .. } => "stuck_register",
        }
    }
}

/// On which side of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Before its first byte.
    Before,
    /// After its last byte.
    After,
}

/// What a fault may hit; what is not said does not matter.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// One device, by its index on the bus.
    pub station: Option<usize>,
    /// Function codes; empty: all.
    pub functions: Vec<u8>,
    /// First and last address of ranges, one of which the request touches; empty: all.
    pub addresses: Vec<(u16, u16)>,
}

/// A request as faults see it.
#[derive(Clone, Copy, Debug)]
pub struct Asked<'a> {
    /// When.
    pub now: Instant,
    /// Index of the device that it reaches, if it reaches one.
    pub station: Option<usize>,
    /// Function code.
    pub function: u8,
    /// Bank, first address and quantity, where it has them.
    pub span: Option<(Bank, u16, u16)>,
    /// Unit, function and data.
    pub request: &'a [u8],
    /// Whether its frame has a CRC: Modbus TCP has none, and faults of the line do not hit it.
    pub has_crc: bool,
}

/// A fault that hit something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hit {
    /// The fault's number.
    pub id: u64,
    /// What it does.
    pub kind: &'static str,
}

/// What becomes of a request on its way to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It gets there.
    Through,
    /// It is lost, for this reason.
    Lost(&'static str),
    /// It is answered by this exception code.
    Refused(u8),
}

/// A reply as it leaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sent {
    /// How much later than it would, in microseconds.
    pub delay_us: u64,
    /// Its pieces, each with the microseconds since the one before; empty when nothing is left of it.
    pub pieces: Vec<(u64, Vec<u8>)>,
}

/// A fault and what it has done.
#[derive(Clone, Debug)]
pub struct Active {
    fault: Fault,
    added: Instant,
    hits: u64,
    rng: Rand64,
    /// When noise comes next.
    noise_at: Option<Instant>,
}

impl Active {
    /// What was asked for.
    pub fn fault(&self) -> &Fault {
        &self.fault
    }

    /// How often it has hit.
    pub fn hits(&self) -> u64 {
        self.hits
    }

    /// Whether its count and time are not used up.
    pub fn is_active(&self, now: Instant) -> bool {
        let in_time = self.fault.lasts_us.is_none_or(|lasts_us| now.since_us(self.added) < lasts_us);
        in_time && self.fault.count.is_none_or(|count| self.hits < count)
    }

    fn aims_at(&self, asked: &Asked) -> bool {
        let Target { station, functions, addresses } = &self.fault.target;
        let touched = |(first, last): &(u16, u16)| {
            let Some((_, start, quantity)) = asked.span else { return false };
            start <= *last && u32::from(*first) < u32::from(start) + u32::from(quantity.max(1))
        };
        (station.is_none() || *station == asked.station)
            && (functions.is_empty() || functions.contains(&asked.function))
            && (addresses.is_empty() || addresses.iter().any(touched))
    }

    /// Whether it hits; draws from its chance only where it could.
    fn strikes(&mut self, asked: &Asked) -> bool {
        if !self.is_active(asked.now) || !self.aims_at(asked) {
            return false;
        }
        self.draws()
    }

    /// Whether chance lets it hit now; counts the hit.
    fn draws(&mut self) -> bool {
        let hits = self.fault.probability >= 1.0 || self.rng.rand_float() < self.fault.probability;
        self.hits += u64::from(hits);
        hits
    }

    fn hit(&self) -> Hit {
        Hit { id: self.fault.id, kind: self.fault.kind.name() }
    }

    fn draw_noise(&mut self, from: Instant, per_minute: u32) {
        let share = -(1.0 - self.rng.rand_float()).ln();
        let us = share * 60e6 / f64::from(per_minute.max(1));
        self.noise_at = Some(from.plus_us((us as u64).max(1)));
    }
}

/// The most bytes of a burst of noise.
const NOISE_BYTES_MAX: u64 = 4;

/// The faults of a bus, in the order in which they were given.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    list: Vec<Active>,
}

impl Faults {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// All of them.
    pub fn list(&self) -> &[Active] {
        &self.list
    }

    /// From `now` on there is one more.
    pub fn add(&mut self, fault: Fault, now: Instant) {
        let rng = Rand64::new(u128::from(fault.seed));
        let mut active = Active { added: now, hits: 0, rng, noise_at: None, fault };
        if let FaultKind::Noise { per_minute } = active.fault.kind {
            active.draw_noise(now, per_minute);
        }
        self.list.push(active);
    }

    /// Takes one away; `false` where there is none of that number.
    pub fn remove(&mut self, id: u64) -> bool {
        let before = self.list.len();
        self.list.retain(|active| active.fault.id != id);
        self.list.len() < before
    }

    /// Takes all away.
    pub fn clear(&mut self) {
        self.list.clear();
    }

    /// The fault that keeps everything off the bus, if its cable is pulled now.
    pub fn offline(&mut self, now: Instant) -> Option<Hit> {
        let pulled = |active: &&mut Active| matches!(active.fault.kind, FaultKind::Offline) && active.is_active(now);
        self.list.iter_mut().filter(pulled).find_map(|active| active.draws().then(|| active.hit()))
    }

    /// What becomes of a request that a device would answer.
    pub fn intercept(&mut self, asked: &Asked, hits: &mut Vec<Hit>) -> Verdict {
        let mut verdict = Verdict::Through;
        for active in &mut self.list {
            let kind = active.fault.kind;
            match kind {
                FaultKind::Drop if active.strikes(asked) => {
                    hits.push(active.hit());
                    return Verdict::Lost("a fault lost the request");
                }
                FaultKind::Exception { code } if verdict == Verdict::Through && active.strikes(asked) => {
                    hits.push(active.hit());
                    verdict = Verdict::Refused(code);
                }
                _ => {}
            }
        }
        verdict
    }

    /// Whether a fault of this one device loses a broadcast for it.
    pub fn deafens(&mut self, asked: &Asked, hits: &mut Vec<Hit>) -> bool {
        let own = |active: &&mut Active| {
            matches!(active.fault.kind, FaultKind::Drop) && active.fault.target.station.is_some()
        };
        for active in self.list.iter_mut().filter(own) {
            if active.strikes(asked) {
                hits.push(active.hit());
                return true;
            }
        }
        false
    }

    /// A reply's unit, function and data on their way out. `previous` is the device's reply before it.
    pub fn deform(&mut self, asked: &Asked, reply: &[u8], previous: &[u8], hits: &mut Vec<Hit>) -> Sent {
        let mut shape = Shape::new(reply, asked.has_crc);
        for active in &mut self.list {
            let kind = active.fault.kind;
            if shape.admits(&kind, asked, previous) && active.strikes(asked) {
                shape.apply(kind, asked, previous, &mut active.rng);
                hits.push(active.hit());
            }
        }
        shape.sent()
    }

    /// When noise comes next.
    pub fn noise_at(&self) -> Option<Instant> {
        self.list
            .iter()
            .filter(|active| active.noise_at.is_some_and(|at| active.is_active(at)))
            .filter_map(|active| active.noise_at)
            .min()
    }

    /// The next burst of noise that is due.
    pub fn noise(&mut self, now: Instant) -> Option<(Hit, Vec<u8>)> {
        let due = |active: &&mut Active| active.noise_at.is_some_and(|at| at <= now && active.is_active(at));
        loop {
            let active = self.list.iter_mut().filter(due).min_by_key(|active| active.noise_at)?;
            let FaultKind::Noise { per_minute } = active.fault.kind else { return None };
            let count = active.rng.rand_range(1..NOISE_BYTES_MAX + 1);
            let bytes = random_bytes(&mut active.rng, count as usize);
            let is_heard = active.draws();
            active.draw_noise(active.noise_at?, per_minute);
            if is_heard {
                return Some((active.hit(), bytes));
            }
        }
    }
}

fn random_bytes(rng: &mut Rand64, count: usize) -> Vec<u8> {
    (0..count).map(|_| rng.rand_range(0..256) as u8).collect()
}

/// A reply that faults work on: all bytes that leave, and where among them the frame is.
struct Shape {
    bytes: Vec<u8>,
    /// First byte of the frame, and the one behind its last.
    start: usize,
    end: usize,
    has_crc: bool,
    is_crc_wrong: bool,
    is_cut: bool,
    /// Where the next piece starts, and after how many microseconds.
    splits: Vec<(usize, u64)>,
    delay_us: u64,
}

impl Shape {
    fn new(reply: &[u8], has_crc: bool) -> Self {
        let mut bytes = reply.to_vec();
        if has_crc {
            append_crc(&mut bytes);
        }
        let end = bytes.len();
        let splits = Vec::new();
        Self { bytes, start: 0, end, has_crc, is_crc_wrong: false, is_cut: false, splits, delay_us: 0 }
    }

    /// Whether a fault of this kind has something to do here.
    fn admits(&self, kind: &FaultKind, asked: &Asked, previous: &[u8]) -> bool {
        let has_line = self.has_crc && !self.bytes.is_empty();
        match kind {
            FaultKind::Drop | FaultKind::Exception { .. } | FaultKind::Offline | FaultKind::Noise { .. } => false,
            FaultKind::Delay { .. } | FaultKind::Truncate { .. } => !self.bytes.is_empty(),
            FaultKind::BadCrc => has_line && !self.is_cut && !self.is_crc_wrong,
            FaultKind::Garbage { .. } | FaultKind::Echo => has_line,
            FaultKind::Split { at, .. } => has_line && (1..self.bytes.len()).contains(at),
            FaultKind::WrongUnit | FaultKind::WrongFunction => !self.is_cut,
            FaultKind::Stale => !self.is_cut && !previous.is_empty(),
            FaultKind::StuckRegister { member, .. } => self.stuck_span(member, asked).is_some(),
        }
    }

    fn apply(&mut self, kind: FaultKind, asked: &Asked, previous: &[u8], rng: &mut Rand64) {
        match kind {
            FaultKind::Drop | FaultKind::Exception { .. } | FaultKind::Offline | FaultKind::Noise { .. } => {}
            FaultKind::Delay { ms, jitter_ms } => {
                let jitter_us = if jitter_ms == 0 { 0 } else { rng.rand_range(0..jitter_ms * 1000 + 1) };
                self.delay_us += ms * 1000 + jitter_us;
            }
            FaultKind::BadCrc => {
                self.is_crc_wrong = true;
                self.bytes[self.end - 1] ^= 0xFF;
            }
            FaultKind::Truncate { bytes } => {
                self.bytes.truncate(self.bytes.len().saturating_sub(bytes));
                self.is_cut |= self.bytes.len() < self.end;
                self.end = self.end.min(self.bytes.len());
                self.splits.retain(|(at, _)| *at < self.bytes.len());
            }
            FaultKind::Garbage { bytes, place: Place::Before } => self.put_before(&random_bytes(rng, bytes)),
            FaultKind::Garbage { bytes, place: Place::After } => self.bytes.extend(random_bytes(rng, bytes)),
            FaultKind::Echo => {
                let mut request = asked.request.to_vec();
                append_crc(&mut request);
                self.put_before(&request);
            }
            FaultKind::WrongUnit => self.reshape(|body| body[0] = if body[0] >= 247 { 1 } else { body[0] + 1 }),
            FaultKind::WrongFunction => self.reshape(|body| {
                let code = body[1] & 0x7F;
                body[1] = body[1] & 0x80 | if code >= 0x7F { 1 } else { code + 1 };
            }),
            FaultKind::Split { at, gap_ms } => self.splits.push((at, gap_ms * 1000)),
            FaultKind::Stale => self.reshape(|body| *body = previous.to_vec()),
            FaultKind::StuckRegister { member, words, .. } => {
                let Some((from, to)) = self.stuck_span(&member, asked) else { return };
                let Some((_, start, _)) = asked.span else { return };
                self.reshape(|body| {
                    for addr in from..to {
                        let (place, word) = (usize::from(addr - start), words[usize::from(addr - member.addr())]);
                        if member.row.bank.is_bits() {
                            let bit = 1 << (place % 8);
                            let byte = &mut body[3 + place / 8];
                            *byte = if word == 0 { *byte & !bit } else { *byte | bit };
                        } else {
                            body[3 + 2 * place..5 + 2 * place].copy_from_slice(&word.to_be_bytes());
                        }
                    }
                });
            }
        }
    }

    /// The addresses of a register, first and the one behind the last, that the reply shows.
    fn stuck_span(&self, member: &Member, asked: &Asked) -> Option<(u16, u16)> {
        let (bank, start, quantity) = asked.span?;
        let is_read = (1..=4).contains(&asked.function) && self.bytes.get(self.start + 1) == Some(&asked.function);
        if self.is_cut || !is_read || bank != member.row.bank {
            return None;
        }
        let (from, to) = (start.max(member.addr()), (member.addr() + member.row.words()).min(start + quantity));
        // A stale reply may be shorter than what was asked for.
        let length = if bank.is_bits() { usize::from(quantity).div_ceil(8) } else { usize::from(quantity) * 2 };
        let is_whole = self.bytes.get(self.start + 2).is_some_and(|count| usize::from(*count) == length);
        (from < to && is_whole).then_some((from, to))
    }

    /// Changes unit, function and data; the CRC stays what it was: right, or wrong.
    fn reshape(&mut self, change: impl FnOnce(&mut Vec<u8>)) {
        let behind = self.bytes.split_off(self.end);
        let crc = if self.has_crc { 2 } else { 0 };
        let mut body = self.bytes[self.start..self.end - crc].to_vec();
        change(&mut body);
        if self.has_crc {
            append_crc(&mut body);
        }
        if self.is_crc_wrong
            && let Some(last) = body.last_mut()
        {
            *last ^= 0xFF;
        }
        self.bytes.truncate(self.start);
        self.bytes.extend(body);
        self.end = self.bytes.len();
        self.bytes.extend(behind);
    }

    fn put_before(&mut self, bytes: &[u8]) {
        self.bytes.splice(0..0, bytes.iter().copied());
        self.start += bytes.len();
        self.end += bytes.len();
        for (at, _) in &mut self.splits {
            *at += bytes.len();
        }
    }

    fn sent(mut self) -> Sent {
        self.splits.sort_unstable();
        let mut pieces = Vec::new();
        let (mut from, mut gap_us) = (0, 0);
        for (at, next_gap_us) in self.splits {
            let piece = self.bytes.get(from..at).unwrap_or_default();
            if !piece.is_empty() {
                pieces.push((gap_us, piece.to_vec()));
                gap_us = 0;
            }
            (from, gap_us) = (at, gap_us + next_gap_us);
        }
        let rest = self.bytes.get(from..).unwrap_or_default();
        if !rest.is_empty() {
            pieces.push((gap_us, rest.to_vec()));
        }
        Sent { delay_us: self.delay_us, pieces }
    }
}
