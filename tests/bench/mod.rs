//! A bench: devices on a bus without I/O, moved by hand. What transcripts and the devices' own tests talk to.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use std::sync::Arc;

use chrono::NaiveDateTime;
use standin::bus::{Bus, DoorId, DoorKind, LineCheck, Output, Settings, Timing};
use standin::device::Kind;
use standin::devices;
use standin::image::Layout;
use standin::line::{Address, Line, Parity};
use standin::options::{OptionValue, Options};
use standin::station::{Saved, Setup, Station};
use standin::time::{Instant, SimClock};
use standin::wire::append_crc;

/// How long a reply may take, elapsed.
const REPLY_WITHIN_MS: u64 = 2000;

/// How long the line stays silent before a test believes it.
const SILENCE_MS: u64 = 100;

/// Devices before they are on a bus.
pub struct Plan {
    pub setups: Vec<Setup>,
    pub settings: Settings,
    pub start: NaiveDateTime,
    pub rate: f64,
}

impl Default for Plan {
    fn default() -> Self {
        let line = Line { baud: 9600, parity: Parity::None, stop_bits: 2 };
        Self {
            setups: Vec::new(),
            settings: Settings { line, timing: Timing::Fast, line_check: LineCheck::Warn, slack_ms: 20 },
            start: time("2014-10-27T14:22:08"),
            rate: 1.0,
        }
    }
}

/// A civil time from its text.
#[track_caller]
pub fn time(text: &str) -> NaiveDateTime {
    text.parse().unwrap_or_else(|_| panic!("{text:?} is no date and time"))
}

impl Plan {
    /// One device of a model at a unit.
    #[track_caller]
    pub fn of(model: &str, unit: u8) -> Self {
        Self::default().device(model, unit)
    }

    /// And one more.
    #[track_caller]
    pub fn device(mut self, model: &str, unit: u8) -> Self {
        let kind = devices::kind(model).unwrap_or_else(|| panic!("no model {model}"));
        self.setups.push(Setup {
            name: format!("device{}", self.setups.len() + 1),
            kind,
            address: Address { unit, line: self.settings.line },
            options: Options::defaults(kind),
            inputs: Vec::new(),
            registers: Vec::new(),
        });
        self
    }

    fn last(&mut self) -> &mut Setup {
        self.setups.last_mut().expect("a device comes first")
    }

    /// Names the last device.
    pub fn named(mut self, name: &str) -> Self {
        self.last().name = name.into();
        self
    }

    /// Sets an option of the last device.
    #[track_caller]
    pub fn option(mut self, name: &str, value: OptionValue) -> Self {
        let setup = self.last();
        let row = setup.kind.all_options().find(|row| row.name == name).unwrap_or_else(|| panic!("no option {name}"));
        setup.options.set(row, value).unwrap();
        self
    }

    /// Sets an input of the last device.
    #[track_caller]
    pub fn input(mut self, name: &str, value: f64) -> Self {
        let setup = self.last();
        let index = input_index(setup.kind, name, value);
        setup.inputs.push((index, value));
        self
    }

    /// Sets a start value of the last device.
    pub fn register(mut self, name: &str, raw: i64) -> Self {
        self.last().registers.push((name.into(), raw));
        self
    }

    /// Sets the clock.
    #[track_caller]
    pub fn clock(mut self, start: &str, rate: f64) -> Self {
        (self.start, self.rate) = (time(start), rate);
        self
    }

    /// Sets the line of the bus and of all devices.
    pub fn line(mut self, line: Line) -> Self {
        self.settings.line = line;
        for setup in &mut self.setups {
            setup.address.line = line;
        }
        self
    }

    /// Powers all up.
    #[track_caller]
    pub fn start(self) -> Bench {
        self.start_with(&[])
    }

    /// Powers all up with the images of an earlier run, by device.
    #[track_caller]
    pub fn start_with(self, images: &[Option<Saved>]) -> Bench {
        let clock = SimClock::new(self.start, self.rate);
        let mut stations = Vec::new();
        for (index, setup) in self.setups.into_iter().enumerate() {
            let layout = Arc::new(Layout::new(setup.kind.map));
            let saved = images.get(index).and_then(Option::as_ref);
            match Station::new(setup, layout, saved, &clock) {
                Ok(station) => stations.push(station),
                Err(problems) => panic!("the device does not start: {}", problems.join("; ")),
            }
        }
        let mut bus = Bus::new("bench", self.settings, clock, stations);
        let door = bus.open_door(Instant(0), DoorKind::Virtual);
        Bench { bus, door, now: Instant(0), heard: Vec::new(), notes: Vec::new() }
    }
}

#[track_caller]
fn input_index(kind: &Kind, name: &str, value: f64) -> usize {
    let index = kind.input(name).unwrap_or_else(|| panic!("{} has no input {name}", kind.name));
    let input = &kind.inputs[index];
    assert!(input.admits(value), "{name} takes {}, not {value}", input.allowed());
    index
}

/// Devices on a bus, and a hand on the time.
pub struct Bench {
    pub bus: Bus,
    pub door: DoorId,
    pub now: Instant,
    /// Frames that the bus has sent and that nobody has looked at.
    pub heard: Vec<Vec<u8>>,
    /// Lines for the log.
    pub notes: Vec<String>,
}

impl Bench {
    fn drain(&mut self) {
        while let Some(output) = self.bus.poll(self.now) {
            match output {
                Output::Transmit { bytes, .. } => self.heard.push(bytes),
                Output::Note(note) => self.notes.push(note),
                Output::Persist { .. } | Output::Exchange(_) | Output::Event(_) => {}
            }
        }
    }

    /// Sends bytes as they are; drops what was heard before.
    pub fn send(&mut self, bytes: &[u8]) {
        self.drain();
        self.heard.clear();
        self.bus.receive(self.now, self.door, bytes);
        self.drain();
    }

    /// The next frame, waiting for it as long as a reply may take.
    pub fn hear(&mut self) -> Option<Vec<u8>> {
        self.hear_within(REPLY_WITHIN_MS)
    }

    /// The next frame within a time; an empty line lets all of it pass.
    pub fn hear_within(&mut self, ms: u64) -> Option<Vec<u8>> {
        let end = self.now.plus_ms(ms);
        loop {
            self.drain();
            if !self.heard.is_empty() {
                return Some(self.heard.remove(0));
            }
            if self.now >= end {
                return None;
            }
            self.now = self.bus.wake_at().map_or(end, |at| at.clamp(self.now, end));
        }
    }

    /// Whether the line stays silent.
    pub fn is_silent(&mut self) -> bool {
        self.hear_within(SILENCE_MS).is_none()
    }

    /// Sends unit, function and data with their CRC; gives those of the reply, `None` for silence.
    pub fn ask(&mut self, request: &[u8]) -> Option<Vec<u8>> {
        self.send(&framed(request));
        let reply = self.hear_within(SILENCE_MS)?;
        assert_eq!(framed(&reply[..reply.len() - 2]), reply, "the reply's CRC");
        Some(reply[..reply.len() - 2].to_vec())
    }

    /// Writes a holding register with function 06: 0, or the exception code.
    #[track_caller]
    pub fn write(&mut self, unit: u8, addr: u16, value: u16) -> u8 {
        let [a, b] = addr.to_be_bytes();
        let [c, d] = value.to_be_bytes();
        exception(&self.ask(&[unit, 6, a, b, c, d]).expect("a reply"))
    }

    /// Writes holding registers with function 16: 0, or the exception code.
    #[track_caller]
    pub fn write_many(&mut self, unit: u8, addr: u16, values: &[u16]) -> u8 {
        let mut request = vec![unit, 16];
        request.extend(addr.to_be_bytes());
        request.extend((values.len() as u16).to_be_bytes());
        request.push((values.len() * 2) as u8);
        request.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        exception(&self.ask(&request).expect("a reply"))
    }

    /// Reads registers with function 03 or 04: the words, or the exception code.
    #[track_caller]
    pub fn read(&mut self, unit: u8, function: u8, addr: u16, quantity: u16) -> Result<Vec<u16>, u8> {
        let [a, b] = addr.to_be_bytes();
        let [c, d] = quantity.to_be_bytes();
        let reply = self.ask(&[unit, function, a, b, c, d]).expect("a reply");
        match exception(&reply) {
            0 => Ok(reply[3..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()),
            code => Err(code),
        }
    }

    /// Lets elapsed time pass, and simulated time with it.
    pub fn wait_ms(&mut self, ms: u64) {
        self.wait_us(ms * 1000);
    }

    /// Lets elapsed microseconds pass.
    pub fn wait_us(&mut self, us: u64) {
        let end = self.now.plus_us(us);
        while self.now < end {
            self.drain();
            self.now = self.bus.wake_at().map_or(end, |at| at.clamp(self.now, end));
        }
        self.drain();
        self.bus.live_to(self.now);
        self.drain();
    }

    /// Lets simulated seconds pass at once.
    pub fn advance_s(&mut self, seconds: f64) {
        self.bus.advance_clock(self.now, (seconds * 1e6) as i64);
        self.drain();
    }

    /// Moves the civil clock.
    #[track_caller]
    pub fn jump(&mut self, civil: &str) {
        self.bus.jump_clock(self.now, time(civil));
        self.drain();
    }

    /// The index of a device by its name; the empty name is the only device.
    #[track_caller]
    pub fn index(&self, name: &str) -> usize {
        let found = self.bus.stations().iter().position(|station| name.is_empty() || station.name() == name);
        found.unwrap_or_else(|| panic!("no device {name}"))
    }

    /// Sets an input; flags are 0 and 1. `name` is `input` or `device.input`.
    #[track_caller]
    pub fn input(&mut self, name: &str, value: f64) {
        let (device, name) = name.split_once('.').unwrap_or(("", name));
        let station = self.index(device);
        let index = input_index(self.bus.stations()[station].kind(), name, value);
        self.bus.with_station(self.now, station, |station, now| station.set_inputs(&[(index, value)], now));
        self.drain();
    }

    /// The value of an input. `name` is `input` or `device.input`.
    #[track_caller]
    pub fn input_value(&mut self, name: &str) -> f64 {
        self.bus.live_to(self.now);
        let (device, name) = name.split_once('.').unwrap_or(("", name));
        let station = &self.bus.stations()[self.index(device)];
        station.world().value(station.kind().input(name).unwrap_or_else(|| panic!("no input {name}")))
    }

    /// The raw number of a register. `name` is `register` or `device.register`.
    #[track_caller]
    pub fn get(&mut self, name: &str) -> i64 {
        self.bus.live_to(self.now);
        let (device, name) = name.split_once('.').unwrap_or(("", name));
        let station = &self.bus.stations()[self.index(device)];
        station.raw(station.layout().named(name).unwrap_or_else(|| panic!("no register {name}")))
    }

    /// Puts a raw number into a register whatever its access. `name` is `register` or `device.register`.
    #[track_caller]
    pub fn force(&mut self, name: &str, raw: i64) {
        let (device, name) = name.split_once('.').unwrap_or(("", name));
        let index = self.index(device);
        let forced = self.bus.with_station(self.now, index, |station, _| {
            let member = station.layout().named(name);
            station.force(member.unwrap_or_else(|| panic!("no register {name}")), raw)
        });
        assert!(forced, "{name} cannot hold {raw}");
        self.drain();
    }

    /// Pulls a device's plug, or puts it back.
    #[track_caller]
    pub fn power(&mut self, device: &str, plugged: bool) {
        let index = self.index(device);
        self.bus.with_station(self.now, index, |station, now| station.set_plug(plugged, now));
        self.drain();
    }

    /// Restarts a device.
    #[track_caller]
    pub fn restart(&mut self, device: &str) {
        let index = self.index(device);
        self.bus.with_station(self.now, index, |station, now| station.restart(now));
        self.drain();
    }

    /// Returns a device to its factory settings.
    #[track_caller]
    pub fn factory_reset(&mut self, device: &str) {
        let index = self.index(device);
        self.bus.with_station(self.now, index, |station, now| station.factory_reset(now));
        self.drain();
    }

    /// What EEPROM keeps of a device now.
    #[track_caller]
    pub fn saved(&mut self, device: &str) -> Saved {
        self.bus.live_to(self.now);
        let moment = self.bus.moment(self.now);
        self.bus.stations()[self.index(device)].saved(moment)
    }
}

/// A frame: the bytes and their CRC.
pub fn framed(bytes: &[u8]) -> Vec<u8> {
    let mut frame = bytes.to_vec();
    append_crc(&mut frame);
    frame
}

/// The exception code of a reply's unit, function and data; 0 where it is none.
pub fn exception(reply: &[u8]) -> u8 {
    if reply[1] & 0x80 == 0 { 0 } else { reply[2] }
}
