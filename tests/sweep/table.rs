//! The order of BUS-8 as a plain model: a table's rows as a list of addresses, and what they make of a request. Knows
//! neither the engine's index of addresses nor its way of a request.

use std::collections::{BTreeSet, HashMap};

use standin::device::Kind;
use standin::image::Image;
use standin::map::{Access, Bank, Row};

/// Rows that a device's own clause lets take numbers beyond their range, by wrapping or in another scale.
const BENT: &[(&str, &str, &str)] = &[("logiccon-trc", "baud", "TRC-4"), ("logiccon-trc", "stop_bits", "TRC-4")];

/// A model's table as a plain list of addresses: what BUS-8 is judged by, independent of the engine's own index.
pub struct Table {
    pub kind: &'static Kind,
    pub words: HashMap<(Bank, u16), Word>,
}

/// What an address holds.
#[derive(Clone, Copy)]
pub struct Word {
    pub row: &'static Row,
    /// Address of the register's first word.
    start: u16,
}

/// What a device must answer: function and data.
#[derive(Debug, PartialEq)]
pub enum Wanted {
    /// These bytes.
    Exactly(Vec<u8>),
    /// These, or exception 03 or 04 where a rule of the device refuses what the table allows.
    UnlessRefused(Vec<u8>),
}

fn exactly(function: u8, exception: u8) -> Wanted {
    Wanted::Exactly(vec![function | 0x80, exception])
}

fn word(bytes: &[u8]) -> u16 {
    u16::from_be_bytes([bytes[0], bytes[1]])
}

impl Table {
    pub fn of(kind: &'static Kind) -> Self {
        let mut words = HashMap::new();
        for row in kind.map.iter().copied().flatten() {
            for index in 0..row.count {
                let start = row.addr + index * row.stride;
                for offset in 0..row.words() {
                    words.insert((row.bank, start + offset), Word { row, start });
                }
            }
        }
        Self { kind, words }
    }

    fn has(&self, bank: Bank, start: u16, quantity: u16) -> bool {
        let span = u32::from(start)..u32::from(start) + u32::from(quantity);
        span.into_iter().all(|addr| u16::try_from(addr).is_ok_and(|addr| self.words.contains_key(&(bank, addr))))
    }

    /// The low addresses and those of a bank, those beside them, and those far out.
    pub fn addresses(&self, bank: Bank) -> BTreeSet<u16> {
        let mine = self.words.keys().filter(|key| key.0 == bank).map(|key| key.1);
        let around = mine.flat_map(|addr| [addr.saturating_sub(1), addr, addr.saturating_add(1)]);
        around.chain(0..=0x1FF).chain([0x7FFF, 0x8000, 0xFFFE, 0xFFFF]).collect()
    }

    /// What the order of BUS-8 makes of a request's function and data.
    pub fn wanted(&self, pdu: &[u8], image: &Image) -> Wanted {
        let (function, profile) = (pdu[0], &self.kind.profile);
        if !profile.functions.contains(&function) {
            return exactly(function, 1);
        }
        let (start, second) = (word(&pdu[1..]), word(&pdu[3..]));
        let (bank, most) = match function {
            1 => (Bank::Coil, profile.read_bits_max),
            2 => (Bank::Discrete, profile.read_bits_max),
            3 => (Bank::Holding, profile.read_registers_max),
            4 => (Bank::Input, profile.read_registers_max),
            5 => (Bank::Coil, 1),
            6 => (Bank::Holding, 1),
            15 => (Bank::Coil, profile.write_bits_max),
            16 => (Bank::Holding, profile.write_registers_max),
            other => panic!("function {other} has no known form"),
        };
        let quantity = if let 5 | 6 = function { 1 } else { second };
        let data = if let 15 | 16 = function { &pdu[6..] } else { &[] };
        let bytes = match function {
            15 => usize::from(quantity).div_ceil(8),
            16 => usize::from(quantity) * 2,
            _ => 0,
        };
        let is_odd_coil = function == 5 && !matches!(second, 0 | 0xFF00);
        if !(1..=most).contains(&quantity) || data.len() != bytes || is_odd_coil {
            return exactly(function, 3);
        }
        if !self.has(bank, start, quantity) {
            return exactly(function, 2);
        }
        if let 1..=4 = function {
            let words: Vec<u16> = (0..quantity).map(|offset| image.word(bank, start + offset)).collect();
            return Wanted::Exactly(read_reply(function, &words));
        }
        let written: HashMap<u16, u16> = (0..quantity)
            .map(|offset| {
                let at = usize::from(offset);
                let value = match function {
                    5 => u16::from(second == 0xFF00),
                    6 => second,
                    15 => u16::from(data[at / 8] >> (at % 8) & 1),
                    _ => word(&data[2 * at..]),
                };
                (start + offset, value)
            })
            .collect();
        if written.keys().any(|addr| self.words[&(bank, *addr)].row.access == Access::Read) {
            return exactly(function, 2);
        }
        let is_refused = written.keys().any(|addr| !self.admits(bank, *addr, &written, image));
        let changes = written.iter().any(|(addr, value)| image.word(bank, *addr) != *value);
        let commands = written.keys().any(|addr| self.words[&(bank, *addr)].row.access == Access::Command);
        // What one register holds already was allowed once; several in one message may fall under a rule (VOL-2).
        match (is_refused, quantity == 1 && !changes && !commands) {
            (true, _) => exactly(function, 3),
            (false, true) => Wanted::Exactly(pdu[..5].to_vec()),
            (false, false) => Wanted::UnlessRefused(pdu[..5].to_vec()),
        }
    }

    /// Whether the register at an address may hold what a write makes of it.
    fn admits(&self, bank: Bank, addr: u16, written: &HashMap<u16, u16>, image: &Image) -> bool {
        let Word { row, start } = self.words[&(bank, addr)];
        let is_bent = BENT.iter().any(|bent| (bent.0, bent.1) == (self.kind.name, row.name_of(0).as_str()));
        let after = |addr| written.get(&addr).copied().unwrap_or_else(|| image.word(bank, addr));
        let words: Vec<u16> = (start..start + row.words()).map(after).collect();
        is_bent || row.admits(row.format.decode(&words, row.scale))
    }
}

/// Function, byte count and data of a read's reply.
pub fn read_reply(function: u8, words: &[u16]) -> Vec<u8> {
    let data: Vec<u8> = match function {
        1 | 2 => {
            let bit = |(index, bit): (usize, &u16)| (*bit as u8) << index;
            words.chunks(8).map(|eight| eight.iter().enumerate().map(bit).sum()).collect()
        }
        _ => words.iter().flat_map(|word| word.to_be_bytes()).collect(),
    };
    [vec![function, data.len() as u8], data].concat()
}

/// Function and data of a request.
pub fn request(function: u8, start: u16, second: u16, data: Option<&[u8]>) -> Vec<u8> {
    let mut pdu = vec![function];
    pdu.extend(start.to_be_bytes());
    pdu.extend(second.to_be_bytes());
    if let Some(data) = data {
        pdu.push(data.len() as u8);
        pdu.extend(data);
    }
    pdu
}
