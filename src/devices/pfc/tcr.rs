//! Thyristor-controlled reactors: they absorb without steps what is over-compensated (PFC-13).

use serde::{Deserialize, Serialize};

use super::map::{
    DELTA_TCR_POWER_DECIMALS, DELTA_TCR_POWER_WHOLE, DELTA_TCR_STATUS, STAR_TCR_POWER_DECIMALS, STAR_TCR_POWER_WHOLE,
    STAR_TCR_STATUS,
};
use crate::image::Image;

/// The settings of one reactor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tcr {
    /// Its power in hundredths of a kvar.
    pub power: u32,
    /// Whether it works.
    pub is_active: bool,
}

/// The gains kp and ki of one reactor's control. Both are made from the reactor's power alone, so the power that they
/// were made for stands for them: the control drives the reactor up to that power and no further.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// The power that they were made for, in hundredths of a kvar.
    pub made_for: u32,
}

impl Tcr {
    /// The star reactor, between phases and neutral, and the delta reactor, between phases.
    pub fn both(regs: &Image) -> [Self; 2] {
        let tcr = |whole, decimals, status| Self {
            power: u32::from(regs.get(whole)) * 100 + u32::from(regs.get(decimals)),
            is_active: regs.get(status) == 1,
        };
        [
            tcr(STAR_TCR_POWER_WHOLE, STAR_TCR_POWER_DECIMALS, STAR_TCR_STATUS),
            tcr(DELTA_TCR_POWER_WHOLE, DELTA_TCR_POWER_DECIMALS, DELTA_TCR_STATUS),
        ]
    }

    /// Gains made from its power.
    pub fn gains(&self) -> Gains {
        Gains { made_for: self.power }
    }

    /// The most that it can absorb in kvar: its power, as far as its gains reach.
    pub fn reach_kvar(&self, gains: Gains) -> f64 {
        if self.is_active { f64::from(self.power.min(gains.made_for)) / 100.0 } else { 0.0 }
    }
}
