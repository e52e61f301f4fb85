//! What EEPROM keeps of a station, and how it is laid over factory values at the start (BUS-19, BUS-20).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::{Live, Station};
use crate::image::Member;
use crate::map::Keep;
use crate::time::Moment;

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

impl Saved {
    /// The image as it is kept: JSON that people can read.
    pub fn text(&self) -> String {
        // Names, numbers and JSON are always JSON.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// The version of [`Saved`] that this program writes.
pub const SAVED_VERSION: u32 = 1;

impl Station {
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
            registers: kept.map(|member| (member.name(), self.kept(member))).collect(),
            device: self.live.device.save(&self.live.world, now),
        }
    }

    fn kept(&self, member: Member) -> i64 {
        let raw = self.live.regs.raw(member);
        if self.live.device.holds(member.row, raw) {
            return raw;
        }
        self.live.kept.get(&(member.row.bank, member.addr())).copied().unwrap_or(raw)
    }

    pub(super) fn load(&mut self, saved: &Saved) -> Result<(), String> {
        let kept = |member: &Member| member.row.keep == Keep::Eeprom;
        for (name, raw) in &saved.registers {
            let member = self.layout.named(name).filter(kept);
            let member = member.ok_or_else(|| format!("{} keeps no register {name}", self.kind.name))?;
            if !self.live.device.holds(member.row, *raw) || !self.live.regs.set_raw(member, *raw) {
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
