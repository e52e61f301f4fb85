//! The display: measured values in their registers, in as many decimal digits as the options say (PFC-4, PFC-5).

use super::grid::{Measured, Scene};
use super::harmonics::orders;
use super::map::*;
use crate::image::Image;
use crate::map::{Bank, Format, Point, Row, UnsignedWholeAndDecimals, WholeAndDecimals};
use crate::options::{CRC_ERROR_REPLY, OptionRange, OptionRow, Options};

/// Decimal digits of voltages, currents and harmonics.
const NOTE_2: OptionRow = OptionRow {
    name: "decimal_digits.note2",
    about: "decimal digits of voltages, currents and harmonics, the manual's missing note 2",
    range: OptionRange::Integer(0, 4, 2),
    cite: "PFC-5",
};

/// Decimal digits of powers, frequency, hours, energies, ratios and event values.
const NOTE_3: OptionRow = OptionRow {
    name: "decimal_digits.note3",
    about: "decimal digits of powers, frequency, hours, energies, ratios and event values, the manual's missing note 3",
    range: OptionRange::Integer(0, 4, 3),
    cite: "PFC-5",
};

/// Decimal digits of power factors.
const NOTE_4: OptionRow = OptionRow {
    name: "decimal_digits.note4",
    about: "decimal digits of power factors, the manual's missing note 4",
    range: OptionRange::Integer(0, 4, 3),
    cite: "PFC-5",
};

/// The options of the model.
pub const OPTIONS: &[OptionRow] = &[CRC_ERROR_REPLY, NOTE_2, NOTE_3, NOTE_4];

/// Decimal digits of the manual's notes, which are missing from it (PFC-5).
#[derive(Clone, Copy, Debug)]
pub struct Digits {
    /// Voltages, currents, harmonics.
    pub note_2: u8,
    /// Powers, frequency, hours, energies, ratios, event values.
    pub note_3: u8,
    /// Power factors.
    pub note_4: u8,
}

impl Digits {
    /// What the options say.
    pub fn of(options: &Options) -> Self {
        let digits = |row: &OptionRow| options.integer(row.name) as u8;
        Self { note_2: digits(&NOTE_2), note_3: digits(&NOTE_3), note_4: digits(&NOTE_4) }
    }

    /// The digits of a row.
    pub fn of_row(&self, row: &Row) -> u8 {
        let is_pair = matches!(row.format, Format::WholeAndDecimals | Format::UnsignedWholeAndDecimals);
        if row.bank != Bank::Input || !is_pair {
            return row.scale;
        }
        let power_factors = POWER_FACTOR_A.addr()..=POWER_FACTOR_C.addr();
        let hours_and_later = STEP_N_HOURS_IN.addr()..;
        let powers_and_frequency = ACTIVE_POWER_A.addr()..=FREQUENCY.addr();
        match row.addr {
            addr if power_factors.contains(&addr) => self.note_4,
            addr if hours_and_later.contains(&addr) || powers_and_frequency.contains(&addr) => self.note_3,
            _ => self.note_2,
        }
    }
}

/// A pair that is never negative; what does not fit stands at the end of its registers.
pub fn unsigned_pair(value: f64, digits: u8) -> UnsignedWholeAndDecimals {
    let unit = 10_i64.pow(u32::from(digits));
    let raw = ((value * unit as f64).round() as i64).clamp(0, 65_536 * unit - 1);
    UnsignedWholeAndDecimals { whole: (raw / unit) as u16, decimals: (raw % unit) as u16 }
}

/// A pair whose words both carry the sign (PFC-4); what does not fit stands at the end of its registers.
pub fn signed_pair(value: f64, digits: u8) -> WholeAndDecimals {
    let unit = 10_i64.pow(u32::from(digits));
    let end = 32_768 * unit - 1;
    let raw = ((value * unit as f64).round() as i64).clamp(-end, end);
    WholeAndDecimals { whole: (raw / unit) as i16, decimals: (raw % unit) as i16 }
}

/// Puts all measured values into their registers: one consistent state (PFC-10).
pub fn show(measured: &Measured, scene: &Scene, digits: &Digits, regs: &mut Image) {
    show_unsigned(&[VOLTAGE_AN, VOLTAGE_BN, VOLTAGE_CN], &measured.phase_v, digits.note_2, regs);
    show_unsigned(&[VOLTAGE_AB, VOLTAGE_BC, VOLTAGE_CA], &measured.line_v, digits.note_2, regs);
    show_unsigned(&[VOLTAGE_NEUTRAL], &[measured.neutral_v], digits.note_2, regs);
    show_unsigned(&[CURRENT_A, CURRENT_B, CURRENT_C], &measured.phase_a, digits.note_2, regs);
    show_unsigned(&[CURRENT_EARTH], &[measured.earth_a], digits.note_2, regs);
    let active = [ACTIVE_POWER_A, ACTIVE_POWER_B, ACTIVE_POWER_C, ACTIVE_POWER_TOTAL];
    show_signed(&active, &measured.active_kw, digits.note_3, regs);
    let reactive = [REACTIVE_POWER_A, REACTIVE_POWER_B, REACTIVE_POWER_C, REACTIVE_POWER_TOTAL];
    show_signed(&reactive, &measured.reactive_kvar, digits.note_3, regs);
    let apparent = [APPARENT_POWER_A, APPARENT_POWER_B, APPARENT_POWER_C, APPARENT_POWER_TOTAL];
    show_unsigned(&apparent, &measured.apparent_kva, digits.note_3, regs);
    let factors = [POWER_FACTOR_A, POWER_FACTOR_B, POWER_FACTOR_C];
    show_signed(&factors, &measured.power_factor, digits.note_4, regs);
    show_unsigned(&[FREQUENCY], &[scene.frequency_hz], digits.note_3, regs);
    show_harmonics(&[CURRENT_A_THD, CURRENT_B_THD, CURRENT_C_THD], CURRENT_ORDERS, scene.thd_current, digits, regs);
    show_harmonics(&[VOLTAGE_A_THD, VOLTAGE_B_THD, VOLTAGE_C_THD], VOLTAGE_ORDERS, scene.thd_voltage, digits, regs);
}

type Pair = Point<UnsignedWholeAndDecimals>;

const CURRENT_ORDERS: &[Pair] = &[CURRENT_A_HARMONIC_N, CURRENT_B_HARMONIC_N, CURRENT_C_HARMONIC_N];
const VOLTAGE_ORDERS: &[Pair] = &[VOLTAGE_A_HARMONIC_N, VOLTAGE_B_HARMONIC_N, VOLTAGE_C_HARMONIC_N];

fn show_unsigned(points: &[Pair], values: &[f64], digits: u8, regs: &mut Image) {
    for (point, value) in points.iter().zip(values) {
        regs.set(*point, unsigned_pair(*value, digits));
    }
}

fn show_signed(points: &[Point<WholeAndDecimals>], values: &[f64], digits: u8, regs: &mut Image) {
    for (point, value) in points.iter().zip(values) {
        regs.set(*point, signed_pair(*value, digits));
    }
}

fn show_harmonics(thd: &[Pair], phases: &[Pair], percent: f64, digits: &Digits, regs: &mut Image) {
    let orders = orders(percent).map(|percent| unsigned_pair(percent, digits.note_2));
    show_unsigned(thd, &[percent; 3], digits.note_2, regs);
    for phase in phases {
        for (order, pair) in orders.iter().enumerate() {
            regs.set(phase.nth(order), *pair);
        }
    }
}
