//! Reading a bus' journal: which requests a reader wants to see, and hints where a request looks like a common mistake.
//! Knows the protocol and register maps, no bus at work and no HTTP.

use std::sync::Arc;

use crate::bus::{Exchange, Form, outcome_name};
use crate::device::Kind;
use crate::image::{Layout, Member};
use crate::map::Bank;
use crate::station::Outcome;
use crate::wire::{Request, function, function_name};

/// Which requests a reader wants to see; what is not said does not matter.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// Those that reached the device of this index.
    pub station: Option<usize>,
    /// Those of this function code.
    pub function: Option<u8>,
    /// Those that came to this: `reply`, `exception` or `silence`.
    pub outcome: Option<&'static str>,
    /// Those that touch this address.
    pub address: Option<u16>,
    /// Those from this elapsed time on, in microseconds.
    pub since_us: Option<u64>,
}

impl Filter {
    /// Whether a request is among them.
    pub fn admits(&self, exchange: &Exchange) -> bool {
        self.station.is_none_or(|station| exchange.station == Some(station))
            && self.function.is_none_or(|function| exchange.function() == function)
            && self.outcome.is_none_or(|outcome| outcome_name(&exchange.outcome) == outcome)
            && self.since_us.is_none_or(|since_us| exchange.at.elapsed.0 >= since_us)
            && self.address.is_none_or(|address| Asked::of(exchange).is_some_and(|asked| asked.touches(address)))
    }
}

/// What a request asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asked {
    /// The kind of data.
    pub bank: Bank,
    /// First address.
    pub start: u16,
    /// How many bits or registers.
    pub quantity: u16,
    /// The words that a write carries, bits as 0 and 1; empty for a read.
    pub values: Vec<u16>,
}

impl Asked {
    /// Of a request that has an address; `None` for others.
    pub fn of(exchange: &Exchange) -> Option<Self> {
        if exchange.form == Form::Damaged {
            return None;
        }
        match Request::parse(exchange.request.get(1..)?)? {
            Request::Read { bank, start, quantity } => Some(Self { bank, start, quantity, values: Vec::new() }),
            Request::WriteSingle { bank: Bank::Coil, addr, value } => {
                // What is neither on nor off is refused, and told as it was sent.
                let value = if value == 0xFF00 { 1 } else { value };
                Some(Self { bank: Bank::Coil, start: addr, quantity: 1, values: vec![value] })
            }
            Request::WriteSingle { bank, addr, value } => {
                Some(Self { bank, start: addr, quantity: 1, values: vec![value] })
            }
            Request::WriteMultiple { bank, start, quantity, data } => {
                let values = if bank.is_bits() { bits(data, quantity) } else { words(data) };
                Some(Self { bank, start, quantity, values })
            }
            Request::Other { .. } => None,
        }
    }

    fn touches(&self, address: u16) -> bool {
        u32::from(self.start) <= u32::from(address)
            && u32::from(address) < u32::from(self.start) + u32::from(self.quantity.max(1))
    }
}

/// The values that a reply to a read carries, bits as 0 and 1; empty for other replies.
pub fn values_read(exchange: &Exchange) -> Vec<u16> {
    let is_read = (function::READ_COILS..=function::READ_INPUT_REGISTERS).contains(&exchange.function());
    let (Outcome::Reply, true, Some(asked)) = (&exchange.outcome, is_read, Asked::of(exchange)) else {
        return Vec::new();
    };
    let data = exchange.reply.get(3..).unwrap_or_default();
    if asked.bank.is_bits() { bits(data, asked.quantity) } else { words(data) }
}

fn words(data: &[u8]) -> Vec<u16> {
    data.chunks_exact(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
}

fn bits(data: &[u8], quantity: u16) -> Vec<u16> {
    let bit = |at: usize| data.get(at / 8).map(|byte| u16::from(byte >> (at % 8) & 1));
    (0..usize::from(quantity)).map_while(bit).collect()
}

/// A device as hints know it.
#[derive(Clone, Debug)]
pub struct Known {
    /// Its name.
    pub name: String,
    /// Its model.
    pub kind: &'static Kind,
    /// Its registers.
    pub layout: Arc<Layout>,
    /// The unit that it answers.
    pub unit: u8,
}

/// What a request that went wrong may have been meant to be, in words; `devices` are those of its bus, by index.
pub fn hint(exchange: &Exchange, devices: &[Known]) -> Option<String> {
    if !exchange.faults.is_empty() || exchange.form == Form::Damaged {
        return None;
    }
    let Some(device) = exchange.station.and_then(|index| devices.get(index)) else {
        return unknown_unit(exchange, devices);
    };
    let asked = Asked::of(exchange)?;
    let slip = Slip { device, asked: &asked, function: exchange.function() };
    match exchange.exception_code() {
        None => slip.half_a_register().filter(|_| exchange.outcome == Outcome::Reply),
        Some(1) => slip.other_bank(),
        Some(2) => {
            slip.numbering().or_else(|| slip.other_bank()).or_else(|| slip.off_by_one()).or_else(|| slip.float())
        }
        Some(3) => slip.too_many().or_else(|| slip.swapped()).or_else(|| slip.float()),
        Some(_) => None,
    }
}

fn unknown_unit(exchange: &Exchange, devices: &[Known]) -> Option<String> {
    let is_silent = matches!(exchange.outcome, Outcome::Silence(_));
    if !is_silent || exchange.unit == 0 || devices.iter().any(|device| device.unit == exchange.unit) {
        return None;
    }
    let here: Vec<String> = devices.iter().map(|device| format!("{} is {}", device.name, device.unit)).collect();
    Some(format!("nobody on this bus has unit {}: {}", exchange.unit, here.join(", ")))
}

/// A request to a device that may be a slip.
struct Slip<'a> {
    device: &'a Known,
    asked: &'a Asked,
    function: u8,
}

impl Slip<'_> {
    fn is_write(&self) -> bool {
        self.function > function::READ_INPUT_REGISTERS
    }

    fn named(&self, bank: Bank, address: u16) -> String {
        self.device.layout.member(bank, address).map(|member| member.name()).unwrap_or_default()
    }

    fn covers(&self, bank: Bank, start: u16) -> bool {
        self.asked.quantity > 0 && self.device.layout.covers(bank, start, self.asked.quantity)
    }

    /// Register numbers of documents (40001 is holding register 0) used as addresses.
    fn numbering(&self) -> Option<String> {
        let start = self.asked.start;
        let (first, bank) = match start {
            10_001..=19_999 => (10_001, Bank::Discrete),
            30_001..=39_999 => (30_001, Bank::Input),
            40_001..=49_999 => (40_001, Bank::Holding),
            _ => return None,
        };
        let address = start - first;
        // A table that begins at 1 has no register for the first number.
        let meant = if address == 0 && !self.covers(bank, 0) { 1 } else { address };
        if !self.covers(bank, meant) {
            return None;
        }
        let is = if meant == address { "is" } else { "is 0, which does not exist; the first is" };
        Some(format!(
            "{start} is a register number of the {}xxxx kind; on the wire it {is} {} register {meant} ({}), read with \
             function {:02}",
            first / 10_000,
            bank.name(),
            self.named(bank, meant),
            reading(bank),
        ))
    }

    /// The same addresses exist under another function.
    fn other_bank(&self) -> Option<String> {
        let other = match self.asked.bank {
            Bank::Coil => Bank::Discrete,
            Bank::Discrete => Bank::Coil,
            Bank::Input => Bank::Holding,
            Bank::Holding => Bank::Input,
        };
        let start = self.asked.start;
        if !self.covers(other, start) || self.covers(self.asked.bank, start) {
            return None;
        }
        let what = if other.is_bits() { "" } else { " register" };
        let name = self.named(other, start);
        let cure = match (self.is_write(), other) {
            (true, Bank::Discrete | Bank::Input) => "which is only read".to_owned(),
            _ => format!("read it with function {:02} ({})", reading(other), function_name(reading(other))),
        };
        Some(format!("address {start} exists as {}{what} ({name}): {cure}", other.name()))
    }

    /// The first address of a document counts from 1, that on the wire from 0, or the other way round.
    fn off_by_one(&self) -> Option<String> {
        let start = self.asked.start;
        let shifted = [start.checked_sub(1), start.checked_add(1)].into_iter().flatten();
        let meant = shifted.into_iter().find(|meant| self.covers(self.asked.bank, *meant))?;
        let which = if meant < start { "less" } else { "more" };
        Some(format!(
            "one {which} would exist: {} {meant} ({}); some documents and libraries count addresses from 1, the wire \
             counts from 0",
            self.asked.bank.name(),
            self.named(self.asked.bank, meant)
        ))
    }

    /// More than one message may carry.
    fn too_many(&self) -> Option<String> {
        let profile = &self.device.kind.profile;
        let max = match (self.is_write(), self.asked.bank.is_bits()) {
            (false, false) => profile.read_registers_max,
            (false, true) => profile.read_bits_max,
            (true, false) => profile.write_registers_max,
            (true, true) => profile.write_bits_max,
        };
        let quantity = self.asked.quantity;
        (quantity > max).then(|| {
            let name = &self.device.name;
            let verb = if self.is_write() { "takes" } else { "gives" };
            format!("{name} {verb} at most {max} in one message, and this asks for {quantity}: ask in several messages")
        })
    }

    /// A register of two words that was written low word first.
    fn swapped(&self) -> Option<String> {
        let layout = &self.device.layout;
        let start = self.asked.start;
        let slots =
            (0..self.asked.quantity).filter_map(|offset| layout.slot(self.asked.bank, start.checked_add(offset)?));
        let firsts = slots.filter(|slot| slot.word == 0).map(|slot| layout.member_at(slot));
        firsts.filter(|member| member.row.words() == 2).find_map(|member: Member| {
            let at = usize::from(member.addr() - start);
            let [high, low] = *self.asked.values.get(at..at + 2)? else { return None };
            let meant = |words: &[u16]| member.row.admits(member.row.format.decode(words, member.row.scale));
            (high != low && !meant(&[high, low]) && meant(&[low, high])).then(|| {
                let name = member.name();
                format!("{name} takes two words, the high one first; with {low} before {high} it would be accepted")
            })
        })
    }

    /// A number sent as an IEEE float.
    fn float(&self) -> Option<String> {
        if !self.is_write() || self.asked.bank.is_bits() || self.asked.values.len() < 2 {
            return None;
        }
        let pair = &self.asked.values[..2];
        let number = |high: u16, low: u16| f32::from_bits(u32::from(high) << 16 | u32::from(low));
        // Small whole numbers in both words are tiny as floats, so they are never taken for one.
        let is_likely = |number: f32| (1e-3..1e7).contains(&number.abs());
        let orders = [(number(pair[0], pair[1]), "high word first"), (number(pair[1], pair[0]), "low word first")];
        let (number, order) = orders.into_iter().find(|(number, _)| is_likely(*number))?;
        let member = self.device.layout.member(self.asked.bank, self.asked.start);
        let cure = member.map(|member| match member.row.scale {
            0 => format!("; {} is a whole number", member.name()),
            digits => format!("; {} is a whole number that counts 10^-{digits} {}", member.name(), member.row.unit),
        });
        Some(format!(
            "0x{:04X} 0x{:04X} look like the 32-bit float {number} ({order}): {} has no floats{}",
            pair[0],
            pair[1],
            self.device.name,
            cure.unwrap_or_default()
        ))
    }

    /// A read that cuts a register of two words.
    fn half_a_register(&self) -> Option<String> {
        if self.is_write() {
            return None;
        }
        let layout = &self.device.layout;
        let (start, quantity) = (self.asked.start, self.asked.quantity);
        let last = start.checked_add(quantity.checked_sub(1)?)?;
        let first_cut = layout.slot(self.asked.bank, start).filter(|slot| slot.word > 0);
        let last_cut = layout.slot(self.asked.bank, last);
        let last_cut = last_cut.filter(|slot| slot.word + 1 < layout.member_at(*slot).row.words());
        let member = layout.member_at(first_cut.or(last_cut)?);
        let (name, addr) = (member.name(), member.addr());
        Some(format!("{name} takes two registers, {addr} and {}, the high word first: this reads half of it", addr + 1))
    }
}

/// The function that reads a bank.
fn reading(bank: Bank) -> u8 {
    match bank {
        Bank::Coil => function::READ_COILS,
        Bank::Discrete => function::READ_DISCRETE_INPUTS,
        Bank::Input => function::READ_INPUT_REGISTERS,
        Bank::Holding => function::READ_HOLDING_REGISTERS,
    }
}
