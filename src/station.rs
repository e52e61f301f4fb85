//! One slave on a bus: the standard way of a request (BUS-8 … BUS-12), power, restart and memory. Knows the engine's
//! vocabulary, no particular device and no I/O.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use crate::device::{Answer, CrcError, Cx, Device, Effects, Kind, Refusal};
use crate::image::{Change, Image, Layout, Member, Origin, Txn, Write};
use crate::line::Address;
use crate::map::{Access, Bank, Keep};
use crate::options::Options;
use crate::time::{Instant, Moment, SimClock};
use crate::wire::{Exception, Request};
use crate::world::World;

/// One device on a bus.
#[derive(Clone, Debug)]
pub struct Station {
    name: String,
    kind: &'static Kind,
    layout: Arc<Layout>,
    configured: Address,
    boot_ms: u64,
    response_delay_ms: u64,
    answers_crc_errors: bool,
    live: Live,
    /// The image that a write is staged in; after it, the registers as they were.
    scratch: Image,
    writes: Vec<Write>,
    effects: Effects,
    unsaved: bool,
}

/// All that changes in a station's life: what a snapshot keeps and a write that could not be kept takes back.
#[derive(Clone, Debug)]
pub struct Live {
    device: Box<dyn Device>,
    regs: Image,
    world: World,
    power: Power,
    plugged: bool,
    boots: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Power {
    Off,
    Booting { until: Instant },
    On,
}

/// What a station is made of.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Its name, unique in the file.
    pub name: String,
    /// Its model.
    pub kind: &'static Kind,
    /// Its unit and the bus' line, as devices.toml says.
    pub address: Address,
    /// Its options, complete.
    pub options: Options,
    /// Inputs that are not at their defaults: number of the input and value, judged.
    pub inputs: Vec<(usize, f64)>,
    /// Start values by register name.
    pub registers: Vec<(String, i64)>,
}

/// What EEPROM keeps of a device: a type of its own, so that the live structure may change (BUS-19).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Saved {
    /// Version of this form.
    pub version: u32,
    /// The model.
    pub model: String,
    /// The unit that devices.toml gave when the image was made.
    pub configured_unit: u8,
    /// Registers that EEPROM keeps, by name, as raw numbers.
    pub registers: BTreeMap<String, i64>,
    /// What else the device keeps.
    pub device: Json,
}

/// The version of [`Saved`] that this program writes.
pub const SAVED_VERSION: u32 = 1;

/// What became of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It was answered; the reply is in the buffer.
    Reply,
    /// It was refused; the exception is in the buffer.
    Exception(Refusal),
    /// Nothing was answered, for this reason.
    Silence(&'static str),
}

impl Station {
    /// A station at the first moment of the simulation: EEPROM image or factory values, line settings, start values.
    ///
    /// # Errors
    /// What is wrong with the image, or which start values the device refuses and why, one line each.
    pub fn new(
        setup: Setup,
        layout: Arc<Layout>,
        saved: Option<&Saved>,
        clock: &SimClock,
    ) -> Result<Self, Vec<String>> {
        let Setup { name, kind, address, options, inputs, registers } = setup;
        let mut world = World::new(kind.inputs);
        for (index, value) in inputs {
            world.set_value(index, value);
        }
        let regs = Image::factory(&layout);
        let mut station = Self {
            name,
            kind,
            configured: address,
            boot_ms: options.integer("boot_ms") as u64,
            response_delay_ms: options.integer("response_delay_ms") as u64,
            answers_crc_errors: kind.profile.crc_error == CrcError::Exception
                && !options.is("crc_error_reply", "silent"),
            scratch: regs.clone(),
            live: Live { device: (kind.build)(&options), regs, world, power: Power::Off, plugged: true, boots: 0 },
            layout,
            writes: Vec::new(),
            effects: Effects::default(),
            unsaved: true,
        };
        match saved {
            Some(saved) => station.load(saved).map_err(|problem| vec![problem])?,
            None => kind.profile.line.lay(address, &mut station.live.regs),
        }
        let now = clock.at(Instant(0));
        if station.is_supplied() {
            station.start(now);
        }
        if saved.is_none() {
            station.lay_start_values(&registers, now)?;
        }
        Ok(station)
    }

    fn lay_start_values(&mut self, registers: &[(String, i64)], now: Moment) -> Result<(), Vec<String>> {
        let mut problems = Vec::new();
        let mut values = Vec::new();
        for (name, raw) in registers {
            match self.layout.named(name) {
                Some(member) => values.push((member, *raw)),
                None => problems.push(format!("register {name} does not exist")),
            }
        }
        if values.is_empty() && problems.is_empty() {
            return Ok(());
        }
        if let Err(refusal) = self.write_registers(&values, Origin::Start, now) {
            problems.push(refusal.to_string());
        }
        self.settle_restart(now.elapsed);
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    /// Its name in devices.toml.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its model.
    pub fn kind(&self) -> &'static Kind {
        self.kind
    }

    /// Where its registers lie.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Its registers.
    pub fn regs(&self) -> &Image {
        &self.live.regs
    }

    /// The world that it measures.
    pub fn world(&self) -> &World {
        &self.live.world
    }

    /// Unit and line settings that hold for the next request (BUS-13).
    pub fn address(&self) -> Address {
        self.live.device.address(&self.live.regs).unwrap_or_else(|| self.kind.profile.line.read(&self.live.regs))
    }

    /// Unit and line as devices.toml gives them.
    pub fn configured(&self) -> Address {
        self.configured
    }

    /// Decimal digits of a register's value.
    pub fn scale(&self, member: Member) -> u8 {
        self.live.device.scale(member.row)
    }

    /// The raw number of a register, with the decimal digits that the device's options give it.
    pub fn raw(&self, member: Member) -> i64 {
        member.row.format.decode(self.live.regs.words(member), self.scale(member))
    }

    /// Whether it has power, booting or not.
    pub fn is_powered(&self) -> bool {
        self.live.power != Power::Off
    }

    /// Whether it listens to the bus now.
    pub fn is_listening(&self) -> bool {
        self.live.power == Power::On
    }

    /// Whether its plug is in; its supply is an input of its own.
    pub fn is_plugged(&self) -> bool {
        self.live.plugged
    }

    /// How often it has started.
    pub fn boots(&self) -> u32 {
        self.live.boots
    }

    /// Time that it takes before it answers, beside what the line takes.
    pub fn response_delay_ms(&self) -> u64 {
        self.response_delay_ms
    }

    /// Whether it answers a damaged frame (BUS-4).
    pub fn answers_crc_errors(&self) -> bool {
        self.answers_crc_errors && self.is_listening()
    }

    /// A copy of all that changes.
    pub fn live(&self) -> Live {
        self.live.clone()
    }

    /// Brings back a copy made by [`Station::live`].
    pub fn restore(&mut self, live: Live) {
        self.live = live;
        self.effects = Effects::default();
    }

    /// Lives up to `to`, stopping at every protocol delay that ends before it.
    pub fn advance(&mut self, clock: &SimClock, to: Instant) {
        loop {
            match self.live.power {
                Power::Off => return,
                Power::Booting { until } if until <= to => self.start(clock.at(until)),
                Power::Booting { .. } => return,
                Power::On => {
                    let stop = self.live.device.deadline().filter(|deadline| *deadline <= to);
                    let at = clock.at(stop.unwrap_or(to));
                    self.turn(at, |device, cx| device.advance(cx));
                    if self.settle_restart(at.elapsed) {
                        continue;
                    }
                    if stop.is_none() {
                        return;
                    }
                }
            }
        }
    }

    /// When a protocol delay of the device ends, or it has started.
    pub fn deadline(&self) -> Option<Instant> {
        match self.live.power {
            Power::Off => None,
            Power::Booting { until } => Some(until),
            Power::On => self.live.device.deadline(),
        }
    }

    /// Lets the device act, and collects what it wants done.
    fn turn<R>(&mut self, now: Moment, act: impl FnOnce(&mut Box<dyn Device>, &mut Cx) -> R) -> R {
        let Live { device, regs, world, .. } = &mut self.live;
        let result = act(device, &mut Cx { now, regs, world, effects: &mut self.effects });
        self.unsaved |= std::mem::take(&mut self.effects.save);
        result
    }

    fn start(&mut self, now: Moment) {
        for member in self.layout.members().filter(|member| member.row.keep == Keep::Ram) {
            self.live.regs.set_raw(member, member.row.default_of(member.index));
        }
        self.live.power = Power::On;
        self.live.boots += 1;
        self.turn(now, |device, cx| device.power_on(cx));
        self.effects.restart = false;
    }

    fn stop(&mut self, now: Moment) {
        if self.live.power == Power::On {
            self.turn(now, |device, cx| device.power_off(cx));
        }
        self.live.power = Power::Off;
    }

    /// Begins the restart that the device has asked for; it is silent from `from` on.
    pub fn settle_restart(&mut self, from: Instant) -> bool {
        let wanted = std::mem::take(&mut self.effects.restart) && self.live.power == Power::On;
        if wanted {
            self.live.power = Power::Booting { until: from.plus_ms(self.boot_ms) };
        }
        wanted
    }

    /// Restarts it, as a reset button does.
    pub fn restart(&mut self, now: Moment) {
        self.effects.restart = true;
        self.settle_restart(now.elapsed);
    }

    /// Its own return to factory settings.
    pub fn factory_reset(&mut self, now: Moment) {
        self.turn(now, |device, cx| device.factory_reset(cx));
        self.unsaved = true;
        self.settle_restart(now.elapsed);
    }

    fn is_supplied(&self) -> bool {
        let supply = self.kind.profile.supply.is_none_or(|input| self.live.world.flag(input));
        self.live.plugged && supply
    }

    /// Pulls the plug, or puts it back.
    pub fn set_plug(&mut self, plugged: bool, now: Moment) {
        self.live.plugged = plugged;
        self.settle_supply(now);
    }

    fn settle_supply(&mut self, now: Moment) {
        match (self.is_supplied(), self.is_powered()) {
            (true, false) => self.start(now),
            (false, true) => self.stop(now),
            _ => {}
        }
    }

    /// Sets inputs by their numbers; the caller has judged the values.
    pub fn set_inputs(&mut self, values: &[(usize, f64)], now: Moment) {
        for (index, value) in values {
            self.live.world.set_value(*index, *value);
        }
        self.settle_supply(now);
        if self.is_listening() {
            self.turn(now, |device, cx| device.input_changed(cx));
            self.settle_restart(now.elapsed);
        }
    }

    /// The civil clock jumped by `by_us` to `now`.
    pub fn clock_jumped(&mut self, by_us: i64, now: Moment) {
        self.turn(now, |device, cx| device.clock_jumped(by_us, cx));
    }

    /// Lines for the log that the device left.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.effects.notes)
    }

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

    /// Puts a raw number into a register whatever its access; `false` where it does not fit the register's format.
    pub fn force(&mut self, member: Member, raw: i64) -> bool {
        let words = member.row.format.encode(raw, self.scale(member));
        for (offset, word) in words.iter().flatten().take(usize::from(member.row.words())).enumerate() {
            self.live.regs.set_word(member.row.bank, member.addr() + offset as u16, *word);
        }
        self.unsaved |= words.is_some() && member.row.keep == Keep::Eeprom;
        words.is_some()
    }

    /// Whether something that EEPROM keeps has changed since the last call.
    pub fn take_unsaved(&mut self) -> bool {
        std::mem::take(&mut self.unsaved)
    }

    /// What EEPROM keeps now.
    pub fn saved(&self, now: Moment) -> Saved {
        let kept = self.layout.members().filter(|member| member.row.keep == Keep::Eeprom);
        Saved {
            version: SAVED_VERSION,
            model: self.kind.name.into(),
            configured_unit: self.configured.unit,
            registers: kept.map(|member| (member.name(), self.live.regs.raw(member))).collect(),
            device: self.live.device.save(&self.live.world, now),
        }
    }

    fn load(&mut self, saved: &Saved) -> Result<(), String> {
        let kept = |member: &Member| member.row.keep == Keep::Eeprom;
        for (name, raw) in &saved.registers {
            let member = self.layout.named(name).filter(kept);
            let member = member.ok_or_else(|| format!("{} keeps no register {name}", self.kind.name))?;
            if !self.live.device.admits(member.row, *raw) || !self.live.regs.set_raw(member, *raw) {
                return Err(format!("register {name} takes {}, not {raw}", member.row.allowed()));
            }
        }
        if let Some(member) = self.layout.members().filter(kept).find(|m| !saved.registers.contains_key(&m.name())) {
            return Err(format!("register {} is missing", member.name()));
        }
        self.unsaved = false;
        let Live { device, world, .. } = &mut self.live;
        device.load(&saved.device, world)
    }
}

fn check_quantity(quantity: u16, max: u16) -> Result<(), Refusal> {
    if (1..=max).contains(&quantity) {
        return Ok(());
    }
    let reason = format!("a message takes 1 to {max} of them, not {quantity}");
    Err(Refusal::new(Exception::IllegalDataValue, reason, "BUS-9"))
}
