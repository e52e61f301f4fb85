//! Degrees Celsius and Fahrenheit: the limits of each, and what a change of the unit makes of the registers (VOL-30).

use serde::{Deserialize, Serialize};

use super::map::*;
use crate::image::{Change, Image, Txn};
use crate::map::Point;

/// The unit that all temperature registers count in, in hundredths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Degrees Celsius.
    Celsius,
    /// Degrees Fahrenheit.
    Fahrenheit,
}

/// What depends on the unit, all in hundredths of a degree.
#[derive(Debug)]
pub struct Degrees {
    /// The correction's largest amount.
    pub correction_max: i16,
    /// Least and greatest eco temperature.
    pub eco: (u16, u16),
    /// The lowest minimum and the highest maximum of the target.
    pub target: (u16, u16),
    /// The least distance from minimum to maximum (VOL-14).
    pub gap: u16,
    /// How far above the eco temperature the protection ends (VOL-45).
    pub protection_band: i32,
    /// The distance from the target at which the automatic fan runs at 100 % (VOL-43).
    pub full_fan: i32,
}

const CELSIUS: Degrees = Degrees {
    correction_max: 800,
    eco: (200, 2200),
    target: (500, 4000),
    gap: 500,
    protection_band: 100,
    full_fan: 500,
};

const FAHRENHEIT: Degrees = Degrees {
    correction_max: 1440,
    eco: (3600, 7200),
    target: (4100, 10_400),
    gap: 900,
    protection_band: 180,
    full_fan: 900,
};

/// Temperatures are kept in steps of half a degree (VOL-10).
pub const HALF_DEGREE: u16 = 50;

impl Unit {
    /// The unit that the registers are in.
    pub fn of(regs: &Image) -> Self {
        if regs.get(TEMP_UNIT) { Self::Fahrenheit } else { Self::Celsius }
    }

    /// What depends on it.
    pub const fn degrees(self) -> &'static Degrees {
        match self {
            Self::Celsius => &CELSIUS,
            Self::Fahrenheit => &FAHRENHEIT,
        }
    }

    /// A temperature in °C as hundredths of this unit, to the nearest.
    pub fn hundredths(self, celsius: f64) -> i32 {
        match self {
            Self::Celsius => (celsius * 100.0).round() as i32,
            Self::Fahrenheit => (celsius * 180.0).round() as i32 + 3200,
        }
    }

    /// A temperature of the other unit in this one, to the nearest half degree.
    fn take_temperature(self, other: u16) -> u16 {
        let (other, step) = (i32::from(other), i32::from(HALF_DEGREE));
        let steps = match self {
            Self::Fahrenheit => nearest(other * 9 + 5 * 3200, 5 * step),
            Self::Celsius => nearest((other - 3200) * 5, 9 * step),
        };
        (steps * step).clamp(0, i32::from(u16::MAX)) as u16
    }

    /// A correction of the other unit in this one, to the nearest hundredth.
    fn take_correction(self, other: i16) -> i16 {
        match self {
            Self::Fahrenheit => nearest(i32::from(other) * 9, 5) as i16,
            Self::Celsius => nearest(i32::from(other) * 5, 9) as i16,
        }
    }

    /// A temperature in °C as the registers of this unit would hold it.
    pub fn setting(self, celsius_hundredths: u16) -> u16 {
        match self {
            Self::Celsius => celsius_hundredths,
            Self::Fahrenheit => self.take_temperature(celsius_hundredths),
        }
    }
}

/// The whole number nearest to `number / divisor`.
fn nearest(number: i32, divisor: i32) -> i32 {
    (2 * number + divisor).div_euclid(2 * divisor)
}

/// The temperatures as they stood in the other unit, and what they became, so that a change there and back gives the
/// old ones though half a degree Celsius is coarser than half a degree Fahrenheit (VOL-30).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    correct: Option<Pair<i16>>,
    eco: Option<Pair<u16>>,
    min: Option<Pair<u16>>,
    max: Option<Pair<u16>>,
    target: Option<Pair<u16>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair<T> {
    was: T,
    became: T,
}

fn recall<T: Copy + PartialEq>(pair: Option<Pair<T>>, now: T) -> Option<T> {
    pair.filter(|pair| pair.became == now).map(|pair| pair.was)
}

impl Memory {
    /// Puts what a write leaves alone into the unit that it sets; what it carries is in that unit already.
    pub fn convert(&self, txn: &mut Txn) {
        let unit = Unit::of(txn.after);
        if unit == Unit::of(txn.before) {
            return;
        }
        let degrees = unit.degrees();
        if !txn.touches(NTC_1_CORRECT) {
            let now = txn.was(NTC_1_CORRECT);
            let correct = recall(self.correct, now).unwrap_or_else(|| unit.take_correction(now));
            txn.set(NTC_1_CORRECT, correct.clamp(-degrees.correction_max, degrees.correction_max));
        }
        let convert = |point: Point<u16>, pair, (least, most): (u16, u16), before: &Image| {
            let now = before.get(point);
            recall(pair, now).unwrap_or_else(|| unit.take_temperature(now)).clamp(least, most)
        };
        let (lowest, highest) = degrees.target;
        let min_range = (lowest, highest - degrees.gap);
        let max_range = (lowest + degrees.gap, highest);
        let eco = convert(ZONE_TEMPERATURE_ECO, self.eco, degrees.eco, txn.before);
        let target = convert(ZONE_TEMPERATURE_TARGET, self.target, degrees.target, txn.before);
        let mut min = convert(ZONE_TEMPERATURE_MIN, self.min, min_range, txn.before);
        let mut max = convert(ZONE_TEMPERATURE_MAX, self.max, max_range, txn.before);
        if max < min + degrees.gap {
            // One of them is remembered and the other was written since: only conversion keeps their distance.
            min = convert(ZONE_TEMPERATURE_MIN, None, min_range, txn.before);
            max = convert(ZONE_TEMPERATURE_MAX, None, max_range, txn.before);
        }
        let converted = [
            (ZONE_TEMPERATURE_ECO, eco),
            (ZONE_TEMPERATURE_MIN, min),
            (ZONE_TEMPERATURE_MAX, max),
            (ZONE_TEMPERATURE_TARGET, target.max(min).min(max)),
        ];
        for (point, value) in converted {
            if !txn.touches(point) {
                txn.set(point, value);
            }
        }
    }

    /// Remembers how a write that changed the unit converted the registers; gives whether it did.
    pub fn remember(&mut self, change: &Change, regs: &Image) -> bool {
        if Unit::of(change.before) == Unit::of(regs) {
            return false;
        }
        let pair = |point: Point<u16>| {
            (!change.touches(point)).then(|| Pair { was: change.was(point), became: regs.get(point) })
        };
        let correct = Pair { was: change.was(NTC_1_CORRECT), became: regs.get(NTC_1_CORRECT) };
        *self = Self {
            correct: (!change.touches(NTC_1_CORRECT)).then_some(correct),
            eco: pair(ZONE_TEMPERATURE_ECO),
            min: pair(ZONE_TEMPERATURE_MIN),
            max: pair(ZONE_TEMPERATURE_MAX),
            target: pair(ZONE_TEMPERATURE_TARGET),
        };
        true
    }
}
