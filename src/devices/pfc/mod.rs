//! LogiCCon PFC24S-TCR: power-factor relay with 24 steps and two thyristor-controlled reactors.

pub mod controller;
pub mod display;
pub mod energy;
pub mod events;
pub mod grid;
pub mod harmonics;
pub mod map;
pub mod protections;
pub mod relay;
pub mod settings;
pub mod steps;
pub mod tcr;

use chrono::NaiveDateTime;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use self::display::{Digits, OPTIONS};
use self::events::EventKind;
use self::grid::{INPUTS, SUPPLY, Scene};
use self::map::{
    DELTA_TCR_UPDATE_KP_KI, INPUT_1, INPUT_2, LINE, MAP, OUTPUT_1, OUTPUT_2, SETTINGS, STAR_TCR_UPDATE_KP_KI, STEP_N,
    STEP_SETTINGS, STEPS,
};
use self::relay::{Memory, Relay};
use self::settings::Settings;
use self::tcr::Tcr;
use crate::device::{CrcError, Cx, Device, Kind, Profile};
use crate::image::{Change, Image, Origin};
use crate::map::{Bank, Row};
use crate::options::Options;
use crate::time::Moment;
use crate::wire::function::{READ_COILS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, WRITE_SINGLE_REGISTER};
use crate::world::World;

/// The model.
pub const KIND: Kind = Kind {
    name: "logiccon-pfc24s-tcr",
    title: "LogiCCon PFC24S-TCR power-factor relay",
    manual: "LogiCCon PFC24S-TCR Modbus kullanım kılavuzu",
    map: MAP,
    rules: &[],
    inputs: INPUTS,
    options: OPTIONS,
    profile: Profile {
        // 134 bytes in one message (PFC-3).
        read_registers_max: 64,
        read_bits_max: 1032,
        crc_error: CrcError::Exception,
        supply: Some(SUPPLY),
        ..Profile::new(FUNCTIONS, LINE)
    },
    build: |options| Box::new(Pfc::new(options)),
};

const FUNCTIONS: &[u8] = &[READ_COILS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, WRITE_SINGLE_REGISTER];

/// The behaviour: the relay, and how it lies in registers, options and memory.
#[derive(Clone, Debug)]
struct Pfc {
    digits: Digits,
    relay: Relay,
    is_on: bool,
    /// When power was lost that it has not yet come back from (PFC-17).
    lost_at: Option<NaiveDateTime>,
    /// The holding registers that the relay works by, so that what is put there past the device is noticed.
    seen: Vec<u16>,
}

/// What EEPROM keeps beside registers (PFC-20).
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    memory: Memory,
    /// When it last had power; `None` where it never had.
    alive_at: Option<NaiveDateTime>,
}

impl Pfc {
    fn new(options: &Options) -> Self {
        Self { digits: Digits::of(options), relay: Relay::default(), is_on: false, lost_at: None, seen: Vec::new() }
    }

    /// Takes over the holding registers, now that the relay has lived up to `now`.
    fn take_settings(&mut self, now: Moment, regs: &mut Image) {
        self.seen.clear();
        self.seen.extend(holding_words(regs));
        self.relay.set_settings(Settings::of(regs), now, regs);
    }

    fn show(&mut self, cx: &mut Cx) {
        let relay = &mut self.relay;
        display::show(&relay.measured, &relay.scene, &self.digits, cx.regs);
        for step in 0..STEPS {
            cx.regs.set(STEP_N.nth(step), relay.connected[step]);
        }
        cx.regs.set(OUTPUT_1, relay.closes(1));
        cx.regs.set(OUTPUT_2, relay.closes(2));
        cx.regs.set(INPUT_1, relay.scene.input_1);
        cx.regs.set(INPUT_2, relay.scene.input_2);
        relay.memory.meters.show(self.digits.note_3, cx.regs);
        relay.memory.log.show(self.digits.note_3, cx.regs);
        cx.effects.save |= relay.memory.log.take_fresh();
    }
}

fn holding_words(regs: &Image) -> &[u16] {
    let (first, last) = (STEP_SETTINGS[0].addr, SETTINGS[SETTINGS.len() - 1].addr);
    regs.span(Bank::Holding, first, last + 1 - first)
}

impl Device for Pfc {
    fn clone_box(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }

    fn power_on(&mut self, cx: &mut Cx) {
        if !cx.world.flag(SUPPLY) {
            // Dark from the first moment: it is only set up, and begins to live when its supply comes.
            self.lost_at.get_or_insert(cx.now.civil);
            return;
        }
        if let Some(time) = self.lost_at.take() {
            self.relay.log(EventKind::PowerLoss, time);
        }
        self.seen = holding_words(cx.regs).to_vec();
        self.relay.start(cx.now, Scene::of(cx.world), Settings::of(cx.regs), cx.regs);
        self.is_on = true;
        self.show(cx);
    }

    fn power_off(&mut self, cx: &mut Cx) {
        if !self.is_on {
            return;
        }
        self.advance(cx);
        self.is_on = false;
        self.lost_at = Some(cx.now.civil);
        for coil in 0..=INPUT_2.addr() {
            cx.regs.set_word(Bank::Coil, coil, 0);
        }
        cx.effects.save = true;
    }

    fn advance(&mut self, cx: &mut Cx) {
        if !self.is_on {
            return;
        }
        self.relay.memory.meters.adopt(self.digits.note_3, cx.regs);
        let is_forced = self.seen != holding_words(cx.regs);
        if is_forced {
            self.take_settings(self.relay.lived_to(cx.now), cx.regs);
        }
        let has_happened = self.relay.live(cx.now, cx.regs);
        if is_forced || has_happened {
            self.show(cx);
        } else {
            self.relay.memory.meters.show(self.digits.note_3, cx.regs);
        }
    }

    fn clock_jumped(&mut self, _by_us: i64, cx: &mut Cx) {
        if self.is_on {
            self.relay.clock_moved(cx.now);
        }
    }

    fn input_changed(&mut self, cx: &mut Cx) {
        self.advance(cx);
        self.relay.set_scene(Scene::of(cx.world), cx.now, cx.regs);
        self.show(cx);
    }

    fn committed(&mut self, change: &Change, cx: &mut Cx) {
        // The start values of devices.toml are a panel that was set up, reactors included.
        let is_set_up = change.origin == Origin::Start;
        for (tcr, command) in [STAR_TCR_UPDATE_KP_KI, DELTA_TCR_UPDATE_KP_KI].into_iter().enumerate() {
            if is_set_up || change.sent(command).is_some() {
                self.relay.memory.gains[tcr] = Tcr::both(cx.regs)[tcr].gains();
                cx.effects.save = true;
            }
        }
        if self.is_on {
            self.take_settings(cx.now, cx.regs);
            self.show(cx);
        }
    }

    fn factory_reset(&mut self, cx: &mut Cx) {
        for row in STEP_SETTINGS.iter().chain(SETTINGS) {
            for member in 0..row.count {
                cx.regs.set_word(row.bank, row.addr_of(member), row.default_of(member) as u16);
            }
        }
        self.relay.memory.gains = Default::default();
        if self.is_on {
            self.take_settings(cx.now, cx.regs);
            self.show(cx);
        }
    }

    fn scale(&self, row: &Row) -> u8 {
        self.digits.of_row(row)
    }

    fn save(&self, _world: &World, now: Moment) -> Json {
        let alive_at = if self.is_on { Some(now.civil) } else { self.lost_at };
        serde_json::json!(Kept { memory: self.relay.memory.clone(), alive_at })
    }

    fn load(&mut self, saved: &Json, _world: &mut World) -> Result<(), String> {
        let kept = Kept::deserialize(saved).map_err(|error| error.to_string())?;
        if !kept.memory.log.fits() {
            return Err("the log keeps 8 events".into());
        }
        self.relay.memory = kept.memory;
        self.lost_at = kept.alive_at;
        Ok(())
    }
}
