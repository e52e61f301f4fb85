//! The relays that watch a voltage: each comes beyond its limit and goes well within it (TRC-13).

/// How far inside its limit a value must be for its relay to go, in units of the register (TRC-13).
pub const HYSTERESIS: i64 = 2;

/// The four relays with a limit and a memory. The others follow their cause at once and need none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Watch {
    /// Relay 8: mains voltage too high.
    pub ac_high: bool,
    /// Relay 9: mains voltage too low.
    pub ac_low: bool,
    /// Relay 10: output voltage too high.
    pub dc_high: bool,
    /// Relay 11: output voltage too low.
    pub dc_low: bool,
}

/// The limits of a voltage, in units of its register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Above this it is too high.
    pub high: i64,
    /// Below this it is too low.
    pub low: i64,
}

impl Watch {
    /// Looks at the mains voltage as measured, in volts.
    pub fn look_at_mains(&mut self, voltage: i64, limits: Limits) {
        self.ac_high = is_high(self.ac_high, voltage, limits.high);
        self.ac_low = is_low(self.ac_low, voltage, limits.low);
    }

    /// Looks at the output voltage as measured, in 0.1 V.
    pub fn look_at_output(&mut self, voltage: i64, limits: Limits) {
        self.dc_high = is_high(self.dc_high, voltage, limits.high);
        self.dc_low = is_low(self.dc_low, voltage, limits.low);
    }

    /// Whether the rectifier may use the mains: relays 8 and 9 are off (TRC-10).
    pub fn mains_is_good(&self) -> bool {
        !self.ac_high && !self.ac_low
    }
}

fn is_high(was: bool, value: i64, limit: i64) -> bool {
    value > limit || (was && value > limit - HYSTERESIS)
}

fn is_low(was: bool, value: i64, limit: i64) -> bool {
    value < limit || (was && value < limit + HYSTERESIS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trc_13_comes_beyond_the_limit_and_goes_two_inside() {
        let limits = Limits { high: 250, low: 180 };
        let mut watch = Watch::default();
        let mut high = |voltage| {
            watch.look_at_mains(voltage, limits);
            watch.ac_high
        };
        assert_eq!([250, 251, 250, 249, 248, 249, 250].map(&mut high), [false, true, true, true, false, false, false]);
        let mut low = |voltage| {
            watch.look_at_mains(voltage, limits);
            watch.ac_low
        };
        assert_eq!([180, 179, 180, 181, 182, 181, 180].map(&mut low), [false, true, true, true, false, false, false]);
    }
}
