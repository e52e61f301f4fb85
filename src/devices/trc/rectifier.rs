//! The power stage: what flows at the output with mains and without, by Ohm's and Kirchhoff's laws (TRC-10, TRC-14).
//!
//! One node joins rectifier, load and battery. The rectifier is a voltage source with a limited current that takes none
//! back; the load draws a constant current. Knows no time, and neither relays nor registers.

use super::battery::Battery;

/// What the power stage may give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectifier {
    /// Voltage that it holds at most.
    pub charge_voltage_v: f64,
    /// Most current into the battery, in ampere.
    pub charge_current_a: f64,
    /// Most current in all, in ampere.
    pub output_current_a: f64,
}

/// What flows at the output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flow {
    /// Output voltage in volts.
    pub voltage_v: f64,
    /// Current of the load, in ampere.
    pub output_a: f64,
    /// Current into the battery, in ampere; negative out of it.
    pub battery_a: f64,
}

impl Rectifier {
    /// What the hardware can give, whatever the limits say. Within the manual's ranges the limits are lower (TRC-5).
    pub const VOLTAGE_MAX_V: f64 = 30.0;

    /// What flows with mains (TRC-10). A battery above the voltage limit feeds the load until it has sunk to it.
    pub fn with_mains(&self, load_a: f64, battery: Option<&Battery>) -> Flow {
        let voltage_v = self.charge_voltage_v.min(Self::VOLTAGE_MAX_V);
        let output_a = load_a.min(self.output_current_a);
        let Some(battery) = battery else { return Flow { voltage_v, output_a, battery_a: 0.0 } };
        let most_a = self.charge_current_a.min(self.output_current_a - output_a);
        let wanted_a = battery.current_at(voltage_v);
        if (-output_a..most_a).contains(&wanted_a) {
            return Flow { voltage_v, output_a, battery_a: wanted_a };
        }
        let battery_a = wanted_a.clamp(-output_a, most_a);
        Flow { voltage_v: battery.voltage_at(battery_a), output_a, battery_a }
    }

    /// What flows without mains (TRC-11).
    pub fn without_mains(&self, load_a: f64, battery: Option<&Battery>) -> Flow {
        let Some(battery) = battery else { return Flow::default() };
        let output_a = load_a.min(self.output_current_a);
        Flow { voltage_v: battery.voltage_at(-output_a), output_a, battery_a: -output_a }
    }

    /// What flows into a short circuit (TRC-14).
    pub fn shorted(&self, mains: bool) -> Flow {
        Flow { output_a: if mains { self.output_current_a } else { 0.0 }, ..Flow::default() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FACTORY: Rectifier = Rectifier { charge_voltage_v: 27.5, charge_current_a: 2.0, output_current_a: 19.0 };

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }

    #[test]
    fn trc_10_constant_current_worked_by_hand() {
        // Half full: 23 V open, 0.2 Ω while charging; 27.5 V would drive 22.5 A, the limit is 2 A: 23.4 V.
        let flow = FACTORY.with_mains(5.0, Some(&Battery { capacity_ah: 7.0, charge: 0.5 }));
        assert!(near(flow.voltage_v, 23.4) && near(flow.output_a, 5.0) && near(flow.battery_a, 2.0));
    }

    #[test]
    fn trc_10_constant_voltage_worked_by_hand() {
        // At 0.95: 25.7 V open, 2 Ω while charging; 27.5 V drives 0.9 A.
        let flow = FACTORY.with_mains(5.0, Some(&Battery { capacity_ah: 7.0, charge: 0.95 }));
        assert!(near(flow.voltage_v, 27.5) && near(flow.battery_a, 0.9));
    }

    #[test]
    fn trc_10_a_battery_above_the_limit_shares_the_load() {
        // At 0.9: 25.4 V open, 0.1 Ω; held at 25.3 V it gives 1 A, and the rectifier the other 4 A.
        let rectifier = Rectifier { charge_voltage_v: 25.3, ..FACTORY };
        let flow = rectifier.with_mains(5.0, Some(&Battery { capacity_ah: 7.0, charge: 0.9 }));
        assert!(near(flow.voltage_v, 25.3) && near(flow.output_a, 5.0) && near(flow.battery_a, -1.0));
        // A load of 0.5 A pulls it to 25.35 V only: the rectifier gives nothing.
        let flow = rectifier.with_mains(0.5, Some(&Battery { capacity_ah: 7.0, charge: 0.9 }));
        assert!(near(flow.voltage_v, 25.35) && near(flow.battery_a, -0.5));
    }

    proptest! {
        #[test]
        fn trc_10_with_mains_the_laws_hold(
            charge_voltage_v in 21.5..29.0, charge_current_a in 0.1..3.0, output_current_a in 0.1..20.0,
            load_a in 0.0..30.0, capacity_ah in 0.1..1000.0, charge in 0.0..=1.0,
        ) {
            let rectifier = Rectifier { charge_voltage_v, charge_current_a, output_current_a };
            let battery = Battery { capacity_ah, charge };
            let flow = rectifier.with_mains(load_a, Some(&battery));
            let rectifier_a = flow.output_a + flow.battery_a;
            prop_assert!(near(flow.output_a, load_a.min(output_current_a)));
            prop_assert!((-1e-9..=output_current_a + 1e-9).contains(&rectifier_a), "{flow:?}");
            prop_assert!(flow.battery_a <= charge_current_a);
            // Ohm: current and voltage lie on the battery's curve.
            prop_assert!((battery.current_at(flow.voltage_v) - flow.battery_a).abs() < 1e-6, "{flow:?}");
            // Only a battery that needs no rectifier stands above the limit.
            prop_assert!(flow.voltage_v <= charge_voltage_v + 1e-9 || near(rectifier_a, 0.0), "{flow:?}");
            // Below the limit one of the current limits is the reason.
            let limited = near(flow.battery_a, charge_current_a) || near(rectifier_a, output_current_a);
            prop_assert!(flow.voltage_v >= charge_voltage_v - 1e-9 || limited, "{flow:?}");
        }

        #[test]
        fn trc_11_without_mains_the_battery_feeds_the_load(load_a in 0.0..30.0, charge in 0.0..=1.0) {
            let battery = Battery { capacity_ah: 7.0, charge };
            let flow = FACTORY.without_mains(load_a, Some(&battery));
            prop_assert!(near(flow.output_a, load_a.min(19.0)) && near(flow.battery_a, -flow.output_a));
            prop_assert!(near(flow.voltage_v, 20.0 + 6.0 * charge - 0.1 * flow.output_a));
        }
    }
}
