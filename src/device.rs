//! What a device is to the engine: [`Kind`] is everything about a model that is data, [`Device`] everything that
//! moves. Knows no particular device, no bus and no I/O.

use std::borrow::Cow;
use std::fmt;

use serde_json::Value as Json;

use crate::image::{Change, Image, Rule, Txn};
use crate::line::{Address, LineOffer};
use crate::map::Row;
use crate::options::{COMMON_OPTIONS, OptionRow, Options};
use crate::time::{Instant, Moment};
use crate::wire::{Exception, Request};
use crate::world::{Input, InputPoint, World};

/// A model of a device.
#[derive(Debug)]
pub struct Kind {
    /// The model's name in devices.toml.
    pub name: &'static str,
    /// What it is, in a few words.
    pub title: &'static str,
    /// The manual that it is made from.
    pub manual: &'static str,
    /// Its register tables.
    pub map: &'static [&'static [Row]],
    /// Rules that tie registers together.
    pub rules: &'static [Rule],
    /// The world that it measures.
    pub inputs: &'static [Input],
    /// The options of devices.toml that it has beside [`COMMON_OPTIONS`].
    pub options: &'static [OptionRow],
    /// How it talks.
    pub profile: Profile,
    /// Makes the behaviour; the options are complete and judged.
    pub build: fn(&Options) -> Box<dyn Device>,
}

impl Kind {
    /// The options of every model and of this one.
    pub fn all_options(&self) -> impl Iterator<Item = &'static OptionRow> {
        COMMON_OPTIONS.iter().chain(self.options)
    }

    /// The number of a named input.
    pub fn input(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|input| input.name() == name)
    }
}

/// How a model answers, as far as that is data.
#[derive(Debug)]
pub struct Profile {
    /// Function codes that it supports.
    pub functions: &'static [u8],
    /// Most registers that one read may ask for (BUS-9).
    pub read_registers_max: u16,
    /// Most coils or discrete inputs that one read may ask for.
    pub read_bits_max: u16,
    /// Most registers that one write may carry.
    pub write_registers_max: u16,
    /// Most coils that one write may carry.
    pub write_bits_max: u16,
    /// What it does with a damaged frame; where it answers, the option `crc_error_reply` can silence it (BUS-4).
    pub crc_error: CrcError,
    /// Its line registers and what they offer.
    pub line: LineOffer,
    /// The input that is its supply: false is dark, as with the plug pulled.
    pub supply: Option<InputPoint<bool>>,
}

impl Profile {
    /// A profile with the protocol's own limits (BUS-9), silent on damaged frames.
    pub const fn new(functions: &'static [u8], line: LineOffer) -> Self {
        Self {
            functions,
            read_registers_max: 125,
            read_bits_max: 2000,
            write_registers_max: 123,
            write_bits_max: 1968,
            crc_error: CrcError::Silent,
            line,
            supply: None,
        }
    }
}

/// What a model does with a frame whose CRC is wrong (BUS-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrcError {
    /// Nothing.
    Silent,
    /// It answers function | 0x80, code 03, when the unit byte is its own.
    Exception,
}

/// Why a request is refused: what the wire sees and what people read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The exception that is answered.
    pub exception: Exception,
    /// The reason in words.
    pub reason: Cow<'static, str>,
    /// The clause that it rests on.
    pub cite: &'static str,
}

impl Refusal {
    /// A refusal with a reason.
    pub fn new(exception: Exception, reason: impl Into<Cow<'static, str>>, cite: &'static str) -> Self {
        Self { exception, reason: reason.into(), cite }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} ({})", self.reason, self.cite)
    }
}

/// What a device is handed when something happens: its registers, its world, the time, and room for what it wants done.
#[derive(Debug)]
pub struct Cx<'a> {
    /// The time.
    pub now: Moment,
    /// Its registers.
    pub regs: &'a mut Image,
    /// The world that it measures.
    pub world: &'a mut World,
    /// What it wants done.
    pub effects: &'a mut Effects,
}

/// What a device wants done when its turn is over.
#[derive(Clone, Debug, Default)]
pub struct Effects {
    /// Restart it: after the reply it is silent for `boot_ms`, then starts with what EEPROM keeps.
    pub restart: bool,
    /// Something that EEPROM keeps and that is no register has changed.
    pub save: bool,
    /// Lines for the log.
    pub notes: Vec<String>,
}

/// How a device answers a request that it looked at itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// By the standard pipeline.
    Standard,
    /// Not at all.
    Silence(&'static str),
    /// By an exception.
    Refuse(Refusal),
}

/// The behaviour of one device: a plain struct that is handed time and never looks it up.
pub trait Device: Send {
    /// A copy for snapshots and for taking back a write that could not be kept.
    fn clone_box(&self) -> Box<dyn Device>;

    /// The device starts: registers that EEPROM does not keep are at their factory values.
    fn power_on(&mut self, cx: &mut Cx) {
        let _ = cx;
    }

    /// Its power is lost; the registers are still there. A restart is no such loss.
    fn power_off(&mut self, cx: &mut Cx) {
        let _ = cx;
    }

    /// Lives up to `cx.now`, in whole fixed steps or from event to event: the state never depends on how often this is
    /// called.
    fn advance(&mut self, cx: &mut Cx);

    /// When a protocol delay of the device ends (elapsed time): it is advanced to that very moment.
    fn deadline(&self) -> Option<Instant> {
        None
    }

    /// The civil clock jumped to `cx.now`; nothing happened in between. `by_us` is how far.
    fn clock_jumped(&mut self, by_us: i64, cx: &mut Cx) {
        let _ = (by_us, cx);
    }

    /// An input was set, by devices.toml's successors at run time.
    fn input_changed(&mut self, cx: &mut Cx) {
        let _ = cx;
    }

    /// Whether a number may be written to a row, as far as row and options say.
    fn admits(&self, row: &Row, number: i64) -> bool {
        row.admits(number)
    }

    /// Whether EEPROM may hold a number in a row: wider than [`Device::admits`] where the device puts numbers there itself
    /// that nobody may write.
    fn holds(&self, row: &Row, number: i64) -> bool {
        self.admits(row, number)
    }

    /// Shapes a write: rounding, wrapping, dependent registers. Every value has passed [`Device::admits`].
    fn stage(&self, txn: &mut Txn) {
        let _ = txn;
    }

    /// Judges a write by rules that need the device's state; the model's [`Rule`]s hold.
    ///
    /// # Errors
    /// Why it is refused.
    fn judge(&self, txn: &Txn) -> Result<(), Refusal> {
        let _ = txn;
        Ok(())
    }

    /// Reacts to an accepted write; `cx.regs` holds it.
    fn committed(&mut self, change: &Change, cx: &mut Cx) {
        let _ = (change, cx);
    }

    /// Looks at a request before the standard pipeline does: the last resort for quirks.
    fn answer(&mut self, request: &Request, cx: &mut Cx) -> Answer {
        let _ = (request, cx);
        Answer::Standard
    }

    /// Unit and line settings that hold now, where they are not simply those in the registers.
    fn address(&self, regs: &Image) -> Option<Address> {
        let _ = regs;
        None
    }

    /// The device's own return to factory settings, as from its panel.
    fn factory_reset(&mut self, cx: &mut Cx);

    /// Decimal digits of a row, where an option changes them.
    fn scale(&self, row: &Row) -> u8 {
        row.scale
    }

    /// What EEPROM keeps beside registers.
    fn save(&self, world: &World, now: Moment) -> Json {
        let _ = (world, now);
        Json::Null
    }

    /// Takes back what [`Device::save`] gave, before [`Device::power_on`].
    ///
    /// # Errors
    /// What is wrong with it.
    fn load(&mut self, saved: &Json, world: &mut World) -> Result<(), String> {
        let _ = (saved, world);
        Ok(())
    }
}

impl Clone for Box<dyn Device> {
    fn clone(&self) -> Self {
        self.clone_box()
    }
}

impl fmt::Debug for dyn Device {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Device")
    }
}
