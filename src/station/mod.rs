//! One slave on a bus: the standard way of a request (BUS-8 … BUS-12), power, restart and memory. Knows the engine's
//! vocabulary, no particular device and no I/O.

mod memory;
mod request;

use std::collections::BTreeMap;
use std::sync::Arc;

pub use self::memory::{SAVED_VERSION, Saved};
use crate::device::{CrcError, Cx, Device, Effects, Kind, Refusal};
use crate::image::{Image, Layout, Member, Origin, Write};
use crate::line::Address;
use crate::map::{Bank, Keep};
use crate::options::Options;
use crate::time::{Instant, Moment, SimClock};
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
    /// What EEPROM keeps in place of forced numbers that it may not hold: those that were there before.
    kept: BTreeMap<(Bank, u16), i64>,
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
            live: Live {
                device: (kind.build)(&options),
                regs,
                world,
                power: Power::Off,
                plugged: true,
                boots: 0,
                kept: BTreeMap::new(),
            },
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
        station.start(now);
        match saved {
            Some(_) => station.note_what_the_image_wins(),
            None => station.lay_start_values(&registers, now)?,
        }
        // A device whose supply is off from the start has taken its start values all the same.
        station.settle_supply(now);
        Ok(station)
    }

    /// Where image and devices.toml differ, the image wins, and the log says so (BUS-14).
    fn note_what_the_image_wins(&mut self) {
        let (now, configured) = (self.address(), self.configured);
        if now != configured && self.kind.profile.line.missing(configured.line).is_empty() {
            let (unit, line) = (now.unit, now.line);
            let text = format!(
                "its memory says unit {unit}, {line}; devices.toml says unit {}, {}: the memory wins (BUS-14)",
                configured.unit, configured.line
            );
            self.effects.notes.push(text);
        }
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
                    let deadline = self.live.device.deadline().filter(|deadline| *deadline <= to);
                    let at = clock.at(deadline.unwrap_or(to));
                    self.turn(at, |device, cx| device.advance(cx));
                    if self.settle_restart(at.elapsed) {
                        continue;
                    }
                    if deadline.is_none() || self.live.device.deadline() == deadline {
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

    /// Puts a raw number into a register whatever its access; `false` where it does not fit the register's format. A
    /// number that EEPROM may not hold is not kept, because no start would take it back (BUS-20).
    pub fn force(&mut self, member: Member, raw: i64) -> bool {
        let before = self.live.regs.raw(member);
        if member.row.keep == Keep::Eeprom && self.live.device.holds(member.row, before) {
            self.live.kept.insert((member.row.bank, member.addr()), before);
        }
        let words = member.row.format.encode(raw, self.scale(member));
        for (offset, word) in words.iter().flatten().take(usize::from(member.row.words())).enumerate() {
            self.live.regs.set_word(member.row.bank, member.addr() + offset as u16, *word);
        }
        self.unsaved |= words.is_some() && member.row.keep != Keep::Ram;
        words.is_some()
    }
}
