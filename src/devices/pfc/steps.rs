//! A capacitor or reactor step: what its registers say, and what it does to the reactive power of each phase.

use super::map::{
    STEP_N_CONNECTION, STEP_N_DELAY_UNIT, STEP_N_POWER_DECIMALS, STEP_N_POWER_WHOLE, STEP_N_STATUS,
    STEP_N_SWITCH_IN_DELAY, STEP_N_SWITCH_OUT_DELAY, STEP_N_TYPE,
};
use crate::image::Image;
use crate::time::SECOND_US;

/// Phase voltage at which a step has the power that is set (PFC-10).
const NOMINAL_PHASE_V: f64 = 230.0;

/// Line voltage at which a step between two phases has the power that is set (PFC-10).
const NOMINAL_LINE_V: f64 = 398.0;

/// Who decides whether a step is in (PFC-12).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// The controller.
    Automatic,
    /// It is always in.
    Fixed,
    /// It is always out.
    #[default]
    Passive,
}

/// What a step lies between.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Connection {
    /// A phase, A being 0, and neutral.
    Phase(usize),
    /// Two phases: AB is 0, BC is 1, CA is 2.
    Line(usize),
    /// All three phases.
    #[default]
    ThreePhase,
}

/// The settings of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// A capacitor rather than a reactor.
    pub is_capacitive: bool,
    /// Who decides whether it is in.
    pub status: Status,
    /// Power at nominal voltage.
    pub power_kvar: f64,
    /// What it lies between.
    pub connection: Connection,
    /// How long it waits before it connects.
    pub switch_in_us: i64,
    /// How long it waits before it disconnects.
    pub switch_out_us: i64,
}

impl Step {
    /// Step `index`, 0 first, as its registers say.
    pub fn of(regs: &Image, index: usize) -> Self {
        let unit_us = match regs.get(STEP_N_DELAY_UNIT.nth(index)) {
            0 => 60 * SECOND_US,
            1 => SECOND_US,
            _ => 1000,
        };
        Self {
            is_capacitive: regs.get(STEP_N_TYPE.nth(index)) == 1,
            status: match regs.get(STEP_N_STATUS.nth(index)) {
                0 => Status::Automatic,
                1 => Status::Fixed,
                _ => Status::Passive,
            },
            power_kvar: hundredths(regs.get(STEP_N_POWER_WHOLE.nth(index)), regs.get(STEP_N_POWER_DECIMALS.nth(index))),
            connection: match regs.get(STEP_N_CONNECTION.nth(index)) {
                phase @ 0..=2 => Connection::Phase(usize::from(phase)),
                line @ 3..=5 => Connection::Line(usize::from(line - 3)),
                _ => Connection::ThreePhase,
            },
            switch_in_us: i64::from(regs.get(STEP_N_SWITCH_IN_DELAY.nth(index))) * unit_us,
            switch_out_us: i64::from(regs.get(STEP_N_SWITCH_OUT_DELAY.nth(index))) * unit_us,
        }
    }

    /// What the step, being in, adds to the reactive power of each phase in kvar, + inductive, at the voltages that it
    /// hangs on; a phase without voltage carries nothing (PFC-10).
    pub fn adds_kvar(&self, phase_v: &[f64; 3], line_v: &[f64; 3]) -> [f64; 3] {
        let signed_kvar = if self.is_capacitive { -self.power_kvar } else { self.power_kvar };
        let at_phase = |phase: usize| signed_kvar * (phase_v[phase] / NOMINAL_PHASE_V).powi(2);
        let mut kvar = [0.0; 3];
        match self.connection {
            Connection::Phase(phase) => kvar[phase] = at_phase(phase),
            Connection::Line(line) => {
                let half_kvar = signed_kvar * (line_v[line] / NOMINAL_LINE_V).powi(2) / 2.0;
                for phase in [line, (line + 1) % 3].into_iter().filter(|phase| phase_v[*phase] > 0.0) {
                    kvar[phase] = half_kvar;
                }
            }
            Connection::ThreePhase => kvar = std::array::from_fn(|phase| at_phase(phase) / 3.0),
        }
        kvar
    }
}

/// A number whose hundredths stand in a register of their own: 1 and 10 are 1.10.
pub fn hundredths(whole: u16, hundredths: u16) -> f64 {
    (f64::from(whole) * 100.0 + f64::from(hundredths)) / 100.0
}
