//! All settings of the relay as its holding registers say, in the shape in which the relay works with them.

use super::energy::ResetPeriod;
use super::grid::Transformers;
use super::map::{
    COMPENSATION, COS_PHI_1_DECIMALS, COS_PHI_1_SIGN, COS_PHI_1_WHOLE, COS_PHI_2_DECIMALS, COS_PHI_2_SIGN,
    COS_PHI_2_WHOLE, CURRENT_TRANSFORMER_RATIO, DEVICE_RESET_PERIOD, DEVICE_RESET_UNIT, ENERGY_RESET_PERIOD,
    ENERGY_RESET_UNIT, REFERENCE_SIGN_1, REFERENCE_SIGN_2, REFERENCE_VAR_1, REFERENCE_VAR_2, STEPS, TARGET,
    VOLTAGE_TRANSFORMER_RATIO,
};
use super::protections::{Fan, Protection};
use super::steps::{Step, hundredths};
use super::tcr::Tcr;
use crate::image::Image;
use crate::time::SECOND_US;

/// The settings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// The steps.
    pub steps: [Step; STEPS],
    /// The first target, and the one that holds while input 1 is on (PFC-11).
    pub targets: [Target; 2],
    /// The transformers.
    pub transformers: Transformers,
    /// The star and the delta reactor.
    pub tcrs: [Tcr; 2],
    /// The protections.
    pub protections: [Protection; 5],
    /// The fan.
    pub fan: Fan,
    /// Whether the automatic steps are switched at all (PFC-12).
    pub is_compensating: bool,
    /// How often the energies start anew (PFC-15).
    pub energy_reset: ResetPeriod,
    /// How often the device restarts (PFC-19).
    pub restart_every_us: Option<i64>,
}

impl Settings {
    /// What the registers say.
    pub fn of(regs: &Image) -> Self {
        let restart_unit_us = if regs.get(DEVICE_RESET_UNIT) == 0 { SECOND_US } else { 60 * SECOND_US };
        let restart_every_us = i64::from(regs.get(DEVICE_RESET_PERIOD)) * restart_unit_us;
        Self {
            steps: std::array::from_fn(|index| Step::of(regs, index)),
            targets: Target::both(regs),
            transformers: Transformers::new(regs.get(VOLTAGE_TRANSFORMER_RATIO), regs.get(CURRENT_TRANSFORMER_RATIO)),
            tcrs: Tcr::both(regs),
            protections: Protection::all(regs),
            fan: Fan::of(regs),
            is_compensating: regs.get(COMPENSATION) == 1,
            energy_reset: ResetPeriod::new(regs.get(ENERGY_RESET_PERIOD), regs.get(ENERGY_RESET_UNIT)),
            restart_every_us: (restart_every_us > 0).then_some(restart_every_us),
        }
    }
}

/// What the total reactive power is brought to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The power that gives a tangent of phi, + inductive.
    TanPhi(f64),
    /// A reactive power in kvar, + inductive.
    Reference(f64),
}

impl Default for Target {
    fn default() -> Self {
        Self::TanPhi(0.0)
    }
}

impl Target {
    /// Both sets of targets.
    fn both(regs: &Image) -> [Self; 2] {
        let signed = |value: f64, sign| if regs.get(sign) == 1 { -value } else { value };
        if regs.get(TARGET) == 1 {
            return [(REFERENCE_VAR_1, REFERENCE_SIGN_1), (REFERENCE_VAR_2, REFERENCE_SIGN_2)]
                .map(|(value, sign)| Self::Reference(signed(f64::from(regs.get(value)), sign)));
        }
        [(COS_PHI_1_WHOLE, COS_PHI_1_DECIMALS, COS_PHI_1_SIGN), (COS_PHI_2_WHOLE, COS_PHI_2_DECIMALS, COS_PHI_2_SIGN)]
            .map(|(whole, decimals, sign)| {
                let cos_phi = hundredths(regs.get(whole), regs.get(decimals)).clamp(0.01, 1.0);
                Self::TanPhi(signed((1.0 - cos_phi * cos_phi).sqrt() / cos_phi, sign))
            })
    }

    /// The total reactive power that is aimed at, in kvar, while the total active power is `active_kw` (PFC-11).
    pub fn kvar(self, active_kw: f64) -> f64 {
        match self {
            Self::TanPhi(tan_phi) => active_kw.abs() * tan_phi,
            Self::Reference(kvar) => kvar,
        }
    }
}
