//! Programs and the slots that hold them (ASTRO-60, ASTRO-64, ASTRO-65, ASTRO-70). Knows no clock and no relay.

use chrono::{Datelike, NaiveDate};
use serde::{Deserialize, Serialize};

use super::map::{
    RECORD_ACTIVE_DAYS, RECORD_HOUR, RECORD_MINUTE, RECORD_OFFSET_MINUTES, RECORD_SECOND, RECORD_SETTINGS,
};
use crate::image::Image;

/// Bit of the settings: astro, else time.
pub const ASTRO: u16 = 1 << 0;
/// Bit of the settings: sunrise, else sunset.
pub const SUNRISE: u16 = 1 << 1;
/// Bit of the settings: relay A, else B.
pub const RELAY_A: u16 = 1 << 2;
/// Bit of the settings: on, else off.
pub const ON: u16 = 1 << 3;

/// Settings of an empty slot.
pub const EMPTY: u16 = 0xFF;

const ALL_SETTINGS: u16 = ASTRO | SUNRISE | RELAY_A | ON;
const EVERY_DAY: u16 = 0x7F;

/// A program, in the words of the record registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// The bits above.
    pub settings: u16,
    /// Hour of a time program.
    pub hour: u16,
    /// Minute of a time program.
    pub minute: u16,
    /// Second of a time program.
    pub second: u16,
    /// Minutes that an astro program adds to sunrise or sunset.
    pub offset_minutes: i16,
    /// Bit 0 Monday to bit 6 Sunday.
    pub active_days: u16,
}

impl Program {
    const fn every_day(settings: u16) -> Self {
        Self { settings, hour: 0, minute: 0, second: 0, offset_minutes: 0, active_days: EVERY_DAY }
    }

    /// What the record registers hold, be it a program or not.
    pub fn read(regs: &Image) -> Self {
        Self {
            settings: regs.get(RECORD_SETTINGS),
            hour: regs.get(RECORD_HOUR),
            minute: regs.get(RECORD_MINUTE),
            second: regs.get(RECORD_SECOND),
            offset_minutes: regs.get(RECORD_OFFSET_MINUTES),
            active_days: regs.get(RECORD_ACTIVE_DAYS),
        }
    }

    /// Puts a slot into the record registers (ASTRO-63).
    pub fn show(slot: Option<Self>, regs: &mut Image) {
        let record = slot.unwrap_or(Self { settings: EMPTY, ..Self::default() });
        regs.set(RECORD_SETTINGS, record.settings);
        regs.set(RECORD_HOUR, record.hour);
        regs.set(RECORD_MINUTE, record.minute);
        regs.set(RECORD_SECOND, record.second);
        regs.set(RECORD_OFFSET_MINUTES, record.offset_minutes);
        regs.set(RECORD_ACTIVE_DAYS, record.active_days);
    }

    /// Whether it may be stored (ASTRO-65).
    pub fn is_correct(&self) -> bool {
        self.settings <= ALL_SETTINGS
            && self.hour <= 23
            && self.minute <= 59
            && self.second <= 59
            && (-720..=720).contains(&self.offset_minutes)
            && self.active_days <= EVERY_DAY
    }

    /// Whether it is for this day of the week.
    pub fn is_active(&self, date: NaiveDate) -> bool {
        self.active_days >> date.weekday().num_days_from_monday() & 1 == 1
    }

    /// Whether a bit of its settings is set.
    pub fn has(&self, bit: u16) -> bool {
        self.settings & bit != 0
    }
}

/// Why a process fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failed;

/// The slots, numbered from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slots {
    slots: Vec<Option<Program>>,
}

impl Slots {
    /// The factory's four programs (ASTRO-70).
    pub fn preset(capacity: u16) -> Self {
        let mut slots = vec![None; usize::from(capacity)];
        let presets = [ASTRO | RELAY_A | ON, ASTRO | SUNRISE | RELAY_A, ASTRO | ON, 0];
        for (slot, settings) in slots.iter_mut().zip(presets) {
            *slot = Some(Program::every_day(settings));
        }
        Self { slots }
    }

    /// The slots that were kept, if they are this many and every program in them is one.
    pub fn kept(slots: Vec<Option<Program>>, capacity: u16) -> Option<Self> {
        let fits = slots.len() == usize::from(capacity) && slots.iter().flatten().all(Program::is_correct);
        fits.then_some(Self { slots })
    }

    /// All slots in order.
    pub fn all(&self) -> &[Option<Program>] {
        &self.slots
    }

    /// How many there are.
    pub fn capacity(&self) -> u16 {
        self.slots.len() as u16
    }

    /// How many hold a program.
    pub fn count(&self) -> u16 {
        self.slots.iter().flatten().count() as u16
    }

    /// What a slot holds.
    pub fn get(&self, number: u16) -> Option<Program> {
        self.slots.get(usize::from(number).checked_sub(1)?).copied().flatten()
    }

    fn occupied(&mut self, number: u16) -> Result<&mut Option<Program>, Failed> {
        let slot = usize::from(number).checked_sub(1).and_then(|index| self.slots.get_mut(index));
        slot.filter(|slot| slot.is_some()).ok_or(Failed)
    }

    /// Puts a program into the lowest empty slot and tells which.
    ///
    /// # Errors
    /// All are full, or it is no program (ASTRO-64, ASTRO-65).
    pub fn add(&mut self, program: Program) -> Result<u16, Failed> {
        let free = self.slots.iter().position(Option::is_none).filter(|_| program.is_correct()).ok_or(Failed)?;
        self.slots[free] = Some(program);
        Ok(free as u16 + 1)
    }

    /// Puts a program in the place of another.
    ///
    /// # Errors
    /// The slot is empty, or it is no program (ASTRO-64, ASTRO-65).
    pub fn edit(&mut self, number: u16, program: Program) -> Result<u16, Failed> {
        if !program.is_correct() {
            return Err(Failed);
        }
        *self.occupied(number)? = Some(program);
        Ok(number)
    }

    /// Empties a slot.
    ///
    /// # Errors
    /// It is empty (ASTRO-64).
    pub fn clear(&mut self, number: u16) -> Result<u16, Failed> {
        *self.occupied(number)? = None;
        Ok(number)
    }

    /// Empties all slots (ASTRO-68).
    pub fn clear_all(&mut self) {
        self.slots.fill(None);
    }
}
