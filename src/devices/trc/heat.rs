//! Temperature and fan: the current of the output warms the rectifier, the fan cools it (TRC-12, all of it a ruling).

/// The rectifier's temperature, and whether its fan runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heat {
    /// Temperature in °C.
    pub temperature_c: f64,
    /// Whether the fan runs.
    pub fan: bool,
}

impl Heat {
    /// How far each ampere of the output lifts the temperature above the room's in the end, without the fan.
    pub const RISE_C_PER_A: f64 = 1.5;
    /// The same with the fan.
    pub const RISE_FAN_C_PER_A: f64 = 0.4;
    /// Time constant of the way there without the fan, in seconds.
    pub const TIME_CONSTANT_S: f64 = 300.0;
    /// The same with the fan.
    pub const TIME_CONSTANT_FAN_S: f64 = 120.0;

    /// A rectifier as warm as the room.
    pub fn cold(ambient_c: f64) -> Self {
        Self { temperature_c: ambient_c, fan: false }
    }

    /// Lets `us` microseconds pass.
    pub fn pass(&mut self, output_a: f64, ambient_c: f64, us: i64) {
        let (rise_c_per_a, time_constant_s) = match self.fan {
            true => (Self::RISE_FAN_C_PER_A, Self::TIME_CONSTANT_FAN_S),
            false => (Self::RISE_C_PER_A, Self::TIME_CONSTANT_S),
        };
        let end_c = ambient_c + rise_c_per_a * output_a;
        self.temperature_c += (end_c - self.temperature_c) * (us as f64 / 1e6 / time_constant_s);
    }

    /// Switches the fan by the measured temperature: where both limits call, "on" wins.
    pub fn switch_fan(&mut self, on_c: i64, off_c: i64) {
        let measured_c = self.measured_c();
        self.fan = measured_c >= on_c || (self.fan && measured_c > off_c);
    }

    /// The temperature as the device measures it, in whole °C.
    pub fn measured_c(&self) -> i64 {
        self.temperature_c.round() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trc_12_without_load_it_stays_at_the_ambient() {
        let mut heat = Heat::cold(25.0);
        (0..3600).for_each(|_| heat.pass(0.0, 25.0, 1_000_000));
        assert_eq!(heat.temperature_c, 25.0);
    }

    #[test]
    fn trc_12_after_one_time_constant_63_percent_of_the_rise() {
        // 10 A end at 25 + 15 °C; after 300 s it is 1 - 1/e of the way: 34.5 °C.
        let mut heat = Heat::cold(25.0);
        (0..300).for_each(|_| heat.pass(10.0, 25.0, 1_000_000));
        assert!((heat.temperature_c - 34.48).abs() < 0.05, "{heat:?}");
        // With the fan 10 A end at 25 + 4 °C; after 120 s 1/e of the 5.48 °C above it are left: 31.0 °C.
        heat.fan = true;
        (0..120).for_each(|_| heat.pass(10.0, 25.0, 1_000_000));
        assert!((heat.temperature_c - 31.02).abs() < 0.05, "{heat:?}");
    }

    #[test]
    fn trc_12_fan_between_its_limits_stays_as_it_was() {
        let fan_at = |before: bool, temperature_c: f64| {
            let mut heat = Heat { temperature_c, fan: before };
            heat.switch_fan(40, 30);
            heat.fan
        };
        assert_eq!([29.0, 30.0, 31.0, 39.0, 40.0].map(|c| fan_at(false, c)), [false, false, false, false, true]);
        assert_eq!([29.0, 30.0, 31.0, 39.0, 40.0].map(|c| fan_at(true, c)), [false, false, true, true, true]);
    }

    #[test]
    fn trc_12_on_wins_where_both_hold() {
        let mut heat = Heat { temperature_c: 25.0, fan: false };
        heat.switch_fan(20, 45);
        assert!(heat.fan);
    }
}
