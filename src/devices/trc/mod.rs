//! LogiCCon TRC: rectifier and battery charger for 24 V, with eleven relays.

pub mod battery;
pub mod heat;
pub mod map;
pub mod plant;
pub mod rectifier;
pub mod relays;
pub mod site;

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use self::battery::Battery;
use self::map::{BAUD, BAUD_MAX, BAUD_OUT_OF_RANGE, LINE, MAP, OPTIONS, RANGE_CHECK, SETTINGS, STOP_BITS, UNIT};
use self::plant::{Plant, Settings};
use self::site::{AMBIENT_TEMPERATURE, BATTERY_CAPACITY, BATTERY_CHARGE, INPUTS, Site};
use crate::device::{CrcError, Cx, Device, Kind, Profile};
use crate::image::{Change, Txn};
use crate::map::Row;
use crate::options::Options;
use crate::time::Moment;
use crate::wire::function::{
    READ_COILS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_REGISTER,
};
use crate::world::World;

/// The model.
pub static KIND: Kind = Kind {
    name: "logiccon-trc",
    title: "LogiCCon TRC rectifier and battery charger",
    manual: "LogiCCon TRC serisi Modbus kullanma kılavuzu, REV01, March 2017",
    map: MAP,
    rules: &[],
    inputs: INPUTS,
    options: OPTIONS,
    profile: Profile {
        // 60 data bytes in one message (TRC-3).
        read_registers_max: 30,
        write_registers_max: 30,
        crc_error: CrcError::Exception,
        ..Profile::new(FUNCTIONS, LINE)
    },
    build: |options| Box::new(Trc::new(options)),
};

const FUNCTIONS: &[u8] =
    &[READ_COILS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, WRITE_SINGLE_REGISTER, WRITE_MULTIPLE_REGISTERS];

/// The behaviour.
#[derive(Clone, Debug)]
struct Trc {
    /// A baud number above 5 wraps instead of being refused (TRC-4).
    wraps_baud: bool,
    /// Values out of range are stored instead of being refused (TRC-5).
    stores_any_value: bool,
    /// Running time up to which the charger has lived; `None` without power.
    at_us: Option<i64>,
    /// The charger; there is none before the first start.
    plant: Option<Plant>,
    /// The temperature that EEPROM gave for the first start.
    kept_temperature_c: Option<f64>,
}

/// What EEPROM keeps beside registers (TRC-20).
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    battery_charge: f64,
    temperature: f64,
}

impl Trc {
    fn new(options: &Options) -> Self {
        Self {
            wraps_baud: options.is(BAUD_OUT_OF_RANGE.name, "wrap"),
            stores_any_value: options.is(RANGE_CHECK.name, "accept"),
            at_us: None,
            plant: None,
            kept_temperature_c: None,
        }
    }

    /// The charger, if it is on, and the running time up to which it has lived.
    fn running(&mut self) -> Option<(&mut Plant, &mut i64)> {
        self.plant.as_mut().zip(self.at_us.as_mut())
    }

    /// Lives up to `now` and breaks off the step that has begun: something changes at this very moment.
    fn live_to_the_end(&mut self, now: Moment) {
        let Some((plant, at_us)) = self.running() else { return };
        *at_us = plant.live(*at_us, now.running_us);
        plant.pass(now.running_us - *at_us);
        *at_us = now.running_us;
    }

    /// Takes over what has changed around the charger at this very moment.
    fn change(&mut self, cx: &mut Cx) {
        // The charge in the world is the charger's own until somebody sets it.
        let charge = cx.world.number(BATTERY_CHARGE);
        let is_set = self.plant.is_some_and(|plant| plant.battery.charge != charge);
        self.live_to_the_end(cx.now);
        let Some((plant, _)) = self.running() else { return };
        plant.site = Site::of(cx.world);
        plant.settings = Settings::of(cx.regs);
        plant.battery.capacity_ah = cx.world.number(BATTERY_CAPACITY);
        if is_set {
            plant.battery.charge = charge;
            cx.effects.save = true;
        }
        plant.settle();
        self.show(cx);
    }

    fn show(&self, cx: &mut Cx) {
        if let Some(plant) = &self.plant {
            plant.show(cx.regs);
            cx.world.set_number(BATTERY_CHARGE, plant.battery.charge);
        }
    }

    fn temperature_c(&self, world: &World) -> f64 {
        let lived_c = self.plant.map(|plant| plant.heat.temperature_c);
        lived_c.or(self.kept_temperature_c).unwrap_or_else(|| world.number(AMBIENT_TEMPERATURE))
    }
}

impl Device for Trc {
    fn clone_box(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }

    fn power_on(&mut self, cx: &mut Cx) {
        if self.at_us.is_some() {
            // A restart of the electronics does not stop the power stage.
            self.live_to_the_end(cx.now);
            self.show(cx);
        }
        let battery =
            Battery { capacity_ah: cx.world.number(BATTERY_CAPACITY), charge: cx.world.number(BATTERY_CHARGE) };
        let temperature_c = self.temperature_c(cx.world);
        self.plant = Some(Plant::switched_on(Site::of(cx.world), Settings::of(cx.regs), battery, temperature_c));
        self.at_us = Some(cx.now.running_us);
        self.show(cx);
    }

    fn power_off(&mut self, cx: &mut Cx) {
        self.live_to_the_end(cx.now);
        self.show(cx);
        self.at_us = None;
    }

    fn advance(&mut self, cx: &mut Cx) {
        let Some((plant, at_us)) = self.running() else { return };
        let settings = Settings::of(cx.regs);
        let is_forced = plant.settings != settings;
        if is_forced {
            // A register was put there past the device; it holds from where the charger has lived to.
            plant.settings = settings;
            plant.settle();
        }
        let before_us = *at_us;
        *at_us = plant.live(before_us, cx.now.running_us);
        if is_forced || *at_us != before_us {
            self.show(cx);
        }
    }

    fn input_changed(&mut self, cx: &mut Cx) {
        self.change(cx);
    }

    fn admits(&self, row: &Row, number: i64) -> bool {
        if row.addr == UNIT.addr() {
            return row.admits(number);
        }
        if row.addr == BAUD.addr() {
            return self.wraps_baud || row.admits(number);
        }
        row.addr == STOP_BITS.addr() || self.stores_any_value || row.admits(number)
    }

    fn holds(&self, row: &Row, number: i64) -> bool {
        // Line settings are kept as they were wrapped. A limit may come from a run with the other `range_check`: what was
        // acknowledged then is there (TRC-5, BUS-19).
        let is_line = [UNIT.addr(), BAUD.addr(), STOP_BITS.addr()].contains(&row.addr);
        row.admits(number) || !is_line
    }

    fn stage(&self, txn: &mut Txn) {
        // 5 itself is a speed and stays; only beyond it the rest by 5 is taken (TRC-4).
        if txn.get(BAUD) > BAUD_MAX as u16 {
            txn.after.set(BAUD, txn.get(BAUD) % BAUD_MAX as u16);
        }
        txn.after.set(STOP_BITS, txn.get(STOP_BITS) % 2);
    }

    fn committed(&mut self, change: &Change, cx: &mut Cx) {
        if *change.before != *cx.regs {
            self.change(cx);
        }
    }

    fn factory_reset(&mut self, cx: &mut Cx) {
        for row in SETTINGS {
            cx.regs.set_word(row.bank, row.addr, row.default as u16);
        }
        self.change(cx);
    }

    fn save(&self, world: &World, _now: Moment) -> Json {
        let kept = Kept { battery_charge: world.number(BATTERY_CHARGE), temperature: self.temperature_c(world) };
        serde_json::json!(kept)
    }

    fn load(&mut self, saved: &Json, world: &mut World) -> Result<(), String> {
        let kept = Kept::deserialize(saved).map_err(|error| error.to_string())?;
        if !(0.0..=1.0).contains(&kept.battery_charge) || !kept.temperature.is_finite() {
            return Err(format!("battery_charge is 0 to 1 and temperature a number, not {kept:?}"));
        }
        world.set_number(BATTERY_CHARGE, kept.battery_charge);
        self.kept_temperature_c = Some(kept.temperature);
        Ok(())
    }
}
