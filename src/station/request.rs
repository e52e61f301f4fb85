//! The standard way of a request: the order of checks of BUS-8, reads of one snapshot, writes that are all or nothing.

use super::{Outcome, Station};
use crate::device::{Answer, Refusal};
use crate::image::{Change, Image, Member, Origin, Txn, Write};
use crate::map::{Access, Bank, Keep};
use crate::time::Moment;
use crate::wire::{Exception, Request};

impl Station {
    /// Carries out a request that reached the device, and puts function and data of the reply into `reply`. The device
    /// has been advanced to `now`, and the caller settles a restart after the reply.
    pub fn respond(&mut self, request: &Request, now: Moment, reply: &mut Vec<u8>) -> Outcome {
        let answer = self.turn(now, |device, cx| device.answer(request, cx));
        let refused = match answer {
            Answer::Standard => self.standard(request, now, reply).err(),
            Answer::Silence(reason) => return Outcome::Silence(reason),
            Answer::Refuse(refusal) => Some(refusal),
        };
        let Some(refusal) = refused else { return Outcome::Reply };
        reply.extend([request.function() | 0x80, refusal.exception as u8]);
        Outcome::Exception(refusal)
    }

    /// The order of checks of BUS-8.
    fn standard(&mut self, request: &Request, now: Moment, reply: &mut Vec<u8>) -> Result<(), Refusal> {
        let function = request.function();
        let profile = &self.kind.profile;
        if !profile.functions.contains(&function) {
            let reason = format!("{} has no function {function:02}", self.kind.name);
            return Err(Refusal::new(Exception::IllegalFunction, reason, "BUS-8"));
        }
        match *request {
            Request::Read { bank, start, quantity } => {
                let max = if bank.is_bits() { profile.read_bits_max } else { profile.read_registers_max };
                check_quantity(quantity, max)?;
                self.check_span(bank, start, quantity)?;
                self.read(function, bank, start, quantity, reply);
            }
            Request::WriteSingle { bank, addr, value } => {
                let word = match (bank, value) {
                    (Bank::Coil, 0xFF00) => 1,
                    (Bank::Coil, 0x0000) => 0,
                    (Bank::Coil, _) => {
                        let reason = format!("a coil is written with 0xFF00 or 0x0000, not 0x{value:04X}");
                        return Err(Refusal::new(Exception::IllegalDataValue, reason, "BUS-8"));
                    }
                    _ => value,
                };
                self.check_span(bank, addr, 1)?;
                self.writes.clear();
                self.writes.push(Write { bank, addr, word });
                self.write(Origin::Bus, now)?;
                reply.push(function);
                reply.extend(addr.to_be_bytes());
                reply.extend(value.to_be_bytes());
            }
            Request::WriteMultiple { bank, start, quantity, data } => {
                let bits = bank.is_bits();
                check_quantity(quantity, if bits { profile.write_bits_max } else { profile.write_registers_max })?;
                let bytes = if bits { usize::from(quantity).div_ceil(8) } else { usize::from(quantity) * 2 };
                if data.len() != bytes {
                    let reason = format!("{quantity} values take {bytes} bytes, not {}", data.len());
                    return Err(Refusal::new(Exception::IllegalDataValue, reason, "BUS-8"));
                }
                self.check_span(bank, start, quantity)?;
                self.writes.clear();
                self.writes.extend((0..quantity).map(|offset| {
                    let at = usize::from(offset);
                    let word = if bits {
                        u16::from(data[at / 8] >> (at % 8) & 1)
                    } else {
                        u16::from_be_bytes([data[2 * at], data[2 * at + 1]])
                    };
                    Write { bank, addr: start + offset, word }
                }));
                self.write(Origin::Bus, now)?;
                reply.push(function);
                reply.extend(start.to_be_bytes());
                reply.extend(quantity.to_be_bytes());
            }
            Request::Other { .. } => {
                let reason = format!("function {function:02} is not simulated");
                return Err(Refusal::new(Exception::IllegalFunction, reason, "BUS-8"));
            }
        }
        Ok(())
    }

    fn check_span(&self, bank: Bank, start: u16, quantity: u16) -> Result<(), Refusal> {
        if self.layout.covers(bank, start, quantity) {
            return Ok(());
        }
        let missing = (0..=quantity).map(|offset| start.saturating_add(offset));
        let first = missing.into_iter().find(|addr| self.layout.slot(bank, *addr).is_none()).unwrap_or(start);
        let reason = format!("{} has no {} {first} (0x{first:04X})", self.kind.name, bank.name());
        Err(Refusal::new(Exception::IllegalDataAddress, reason, "BUS-11"))
    }

    fn read(&self, function: u8, bank: Bank, start: u16, quantity: u16, reply: &mut Vec<u8>) {
        let words = self.live.regs.span(bank, start, quantity);
        reply.push(function);
        if bank.is_bits() {
            reply.push(quantity.div_ceil(8) as u8);
            let byte = |bits: &[u16]| bits.iter().rev().fold(0, |byte, bit| byte << 1 | (*bit as u8 & 1));
            reply.extend(words.chunks(8).map(byte));
        } else {
            reply.push((quantity * 2) as u8);
            reply.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        }
    }

    /// Judges and carries out `self.writes`: all of it or nothing (BUS-10).
    fn write(&mut self, origin: Origin, now: Moment) -> Result<(), Refusal> {
        let Self { live, layout, scratch, writes, kind, .. } = self;
        for write in writes.iter() {
            let member = layout.member(write.bank, write.addr);
            if let Some(member) = member.filter(|member| member.row.access == Access::Read) {
                let reason = format!("{} is only read", member.name());
                return Err(Refusal::new(Exception::IllegalDataAddress, reason, member.row.cite));
            }
        }
        scratch.copy_from(&live.regs);
        for write in writes.iter() {
            scratch.set_word(write.bank, write.addr, write.word);
        }
        for write in writes.iter() {
            let Some(member) = layout.member(write.bank, write.addr) else { continue };
            let number = scratch.raw(member);
            if !live.device.admits(member.row, number) {
                let reason = format!("{} takes {}, not {number}", member.name(), member.row.allowed());
                return Err(Refusal::new(Exception::IllegalDataValue, reason, member.row.cite));
            }
        }
        for write in writes.iter() {
            let member = layout.member(write.bank, write.addr);
            if member.is_some_and(|member| member.row.access == Access::Command) {
                scratch.set_word(write.bank, write.addr, 0);
            }
        }
        let mut txn = Txn { before: &live.regs, after: scratch, writes, origin };
        live.device.stage(&mut txn);
        if let Some(rule) = kind.rules.iter().find(|rule| !(rule.holds)(&txn)) {
            return Err(Refusal::new(Exception::IllegalDataValue, rule.says, rule.cite));
        }
        live.device.judge(&txn)?;
        std::mem::swap(&mut live.regs, scratch);
        let writes = std::mem::take(&mut self.writes);
        let before = std::mem::take(&mut self.scratch);
        let change = Change { before: &before, writes: &writes, origin };
        self.turn(now, |device, cx| device.committed(&change, cx));
        self.unsaved |= self.differs_in_eeprom(&before);
        (self.writes, self.scratch) = (writes, before);
        Ok(())
    }

    fn differs_in_eeprom(&self, before: &Image) -> bool {
        let kept = |member: &Member| member.row.keep == Keep::Eeprom;
        *before != self.live.regs
            && self.layout.members().filter(kept).any(|member| before.words(member) != self.live.regs.words(member))
    }

    /// Writes registers by the device's own rules, as one write that is not bound to a span.
    ///
    /// # Errors
    /// Why the device refuses; then nothing has changed.
    pub fn write_registers(&mut self, values: &[(Member, i64)], origin: Origin, now: Moment) -> Result<(), Refusal> {
        if !self.is_listening() {
            return Err(Refusal::new(Exception::DeviceFailure, format!("{} is not running", self.name), "BUS-8"));
        }
        self.writes.clear();
        for (member, raw) in values {
            let Some(words) = member.row.format.encode(*raw, self.live.device.scale(member.row)) else {
                let reason = format!("{} takes {}, not {raw}", member.name(), member.row.allowed());
                return Err(Refusal::new(Exception::IllegalDataValue, reason, member.row.cite));
            };
            self.writes.extend((0..member.row.words()).map(|offset| Write {
                bank: member.row.bank,
                addr: member.addr() + offset,
                word: words[usize::from(offset)],
            }));
        }
        self.writes.sort_by_key(|write| (write.bank, write.addr));
        self.write(origin, now)
    }
}

fn check_quantity(quantity: u16, max: u16) -> Result<(), Refusal> {
    if (1..=max).contains(&quantity) {
        return Ok(());
    }
    let reason = format!("a message takes 1 to {max} of them, not {quantity}");
    Err(Refusal::new(Exception::IllegalDataValue, reason, "BUS-9"))
}
