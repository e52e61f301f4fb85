//! The battery: a source of its own whose voltage follows its charge, behind a resistance that grows as it fills up.
//!
//! Everything but the charge is a ruling of TRC-10 and TRC-11. Knows no mains and no relay.

/// Microseconds in an hour.
const HOUR_US: f64 = 3.6e9;

/// A lead battery of twelve cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// What it holds when full, in ampere hours; above 0.
    pub capacity_ah: f64,
    /// Share of its capacity that it holds, 0 to 1.
    pub charge: f64,
}

impl Battery {
    /// Open-circuit voltage of an empty battery. It equals [`Battery::CUT_OFF_V`], so that a load always opens the
    /// contactor before the charge is used up.
    pub const EMPTY_V: f64 = 20.0;
    /// Open-circuit voltage of a full battery.
    pub const FULL_V: f64 = 26.0;
    /// Resistance times capacity, in ohm ampere hours: a battery of twice the capacity has half the resistance.
    pub const RESISTANCE_OHM_AH: f64 = 0.7;
    /// The contactor opens below this voltage (TRC-11).
    pub const CUT_OFF_V: f64 = 20.0;

    /// Its voltage without current.
    pub fn open_circuit_v(&self) -> f64 {
        Self::EMPTY_V + (Self::FULL_V - Self::EMPTY_V) * self.charge
    }

    /// Its voltage while `current_a` flows into it (negative: out of it). A full battery takes no current.
    pub fn voltage_at(&self, current_a: f64) -> f64 {
        match current_a > 0.0 {
            true => self.open_circuit_v() + current_a * self.resistance_ohm() / (1.0 - self.charge),
            false => self.open_circuit_v() + current_a * self.resistance_ohm(),
        }
    }

    /// The current that flows into it (negative: out of it) when `voltage_v` is laid on.
    pub fn current_at(&self, voltage_v: f64) -> f64 {
        let current_a = (voltage_v - self.open_circuit_v()) / self.resistance_ohm();
        if current_a > 0.0 { current_a * (1.0 - self.charge) } else { current_a }
    }

    /// Moves the charge by the integral of a current over `us` microseconds.
    pub fn take(&mut self, current_a: f64, us: i64) {
        // The bounds only swallow the last bit of rounding: the current vanishes as the battery fills, and the contactor
        // opens before it is empty.
        self.charge = (self.charge + current_a * us as f64 / HOUR_US / self.capacity_ah).clamp(0.0, 1.0);
    }

    fn resistance_ohm(&self) -> f64 {
        Self::RESISTANCE_OHM_AH / self.capacity_ah
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn trc_10_voltage_worked_by_hand() {
        // 20 + 6 · 0.5 = 23; 0.7 Ω·Ah / 7 Ah = 0.1 Ω, twice that when half full; 2 A: 23.4 V charging, 22.8 V on load.
        let battery = Battery { capacity_ah: 7.0, charge: 0.5 };
        assert!((battery.open_circuit_v() - 23.0).abs() < 1e-9);
        assert!((battery.voltage_at(2.0) - 23.4).abs() < 1e-9);
        assert!((battery.voltage_at(-2.0) - 22.8).abs() < 1e-9);
    }

    #[test]
    fn trc_10_an_hour_at_seven_ampere_is_the_capacity() {
        let mut battery = Battery { capacity_ah: 7.0, charge: 0.0 };
        battery.take(7.0, 3_600_000_000);
        assert!((battery.charge - 1.0).abs() < 1e-12);
        battery.take(-3.5, 3_600_000_000);
        assert!((battery.charge - 0.5).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn trc_10_current_and_voltage_are_one_curve(
            capacity_ah in 0.1..10_000.0, charge in 0.0..0.999, voltage_v in 18.0..30.0,
        ) {
            let battery = Battery { capacity_ah, charge };
            let current_a = battery.current_at(voltage_v);
            prop_assert!((battery.voltage_at(current_a) - voltage_v).abs() < 1e-6);
            prop_assert_eq!(current_a > 0.0, voltage_v > battery.open_circuit_v());
        }

        #[test]
        fn trc_10_the_curve_rises_without_a_jump(capacity_ah in 0.1..10_000.0, charge in 0.0..=1.0, voltage_v in 18.0..30.0) {
            let battery = Battery { capacity_ah, charge };
            let rise_a = battery.current_at(voltage_v + 1e-6) - battery.current_at(voltage_v);
            let steepest_a_per_v = capacity_ah / Battery::RESISTANCE_OHM_AH;
            prop_assert!((0.0..=1.001e-6 * steepest_a_per_v).contains(&rise_a));
        }
    }
}
