//! The registers of the PFC24S-TCR as its manual prints them (PFC-1), its line settings and its options.

use crate::line::{Line, LineOffer, Parity};
use crate::map::{
    Row, TenThousands, UnsignedWholeAndDecimals, WholeAndDecimals, coil, command, holding, input, ro, rw,
};
use crate::registers;

/// A pair that is never negative.
type Pair = UnsignedWholeAndDecimals;

/// A pair with a sign.
type SignedPair = WholeAndDecimals;

/// Capacitor and reactor steps.
pub const STEPS: usize = 24;

/// Events that the log keeps.
pub const EVENTS: usize = 8;

registers! { STEP_COILS at coil(0).repeat(24, 1);
    /// The step is connected.
    +0 STEP_N: bool = ro().cite("PFC-1, PFC-11");
}

registers! { PORTS at coil(24);
    /// Output 1 is closed.
    +0 OUTPUT_1: bool = ro().cite("PFC-1, PFC-16");
    /// Output 2 is closed.
    +1 OUTPUT_2: bool = ro().cite("PFC-1, PFC-16");
    /// Input 1 is on: the second target holds.
    +2 INPUT_1: bool = ro().cite("PFC-1, PFC-11");
    /// Input 2 is on: its rise is logged.
    +3 INPUT_2: bool = ro().cite("PFC-1, PFC-17");
}

registers! { VOLTAGES at input(0);
    /// Voltage of phase A to neutral.
    +0 VOLTAGE_AN: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Voltage of phase B to neutral.
    +2 VOLTAGE_BN: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Voltage of phase C to neutral.
    +4 VOLTAGE_CN: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Voltage between phases A and B.
    +6 VOLTAGE_AB: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Voltage between phases B and C.
    +8 VOLTAGE_BC: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Voltage between phases C and A.
    +10 VOLTAGE_CA: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
    /// Magnitude of the vector sum of the three phase voltages.
    +12 VOLTAGE_NEUTRAL: Pair = ro().unit("V").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENTS_AND_POWERS at input(14);
    /// Current of phase A.
    +0 CURRENT_A: Pair = ro().unit("A").scale(2).cite("PFC-1, PFC-10");
    /// Current of phase B.
    +2 CURRENT_B: Pair = ro().unit("A").scale(2).cite("PFC-1, PFC-10");
    /// Current of phase C.
    +4 CURRENT_C: Pair = ro().unit("A").scale(2).cite("PFC-1, PFC-10");
    /// Magnitude of the vector sum of the three phase currents.
    +6 CURRENT_EARTH: Pair = ro().unit("A").scale(2).cite("PFC-1, PFC-10");
    /// Active power of phase A.
    +8 ACTIVE_POWER_A: SignedPair = ro().unit("kW").scale(3).cite("PFC-1, PFC-10");
    /// Active power of phase B.
    +10 ACTIVE_POWER_B: SignedPair = ro().unit("kW").scale(3).cite("PFC-1, PFC-10");
    /// Active power of phase C.
    +12 ACTIVE_POWER_C: SignedPair = ro().unit("kW").scale(3).cite("PFC-1, PFC-10");
    /// Active power of all phases.
    +14 ACTIVE_POWER_TOTAL: SignedPair = ro().unit("kW").scale(3).cite("PFC-1, PFC-10");
    /// Reactive power, + inductive, of phase A.
    +16 REACTIVE_POWER_A: SignedPair = ro().unit("kvar").scale(3).cite("PFC-1, PFC-10");
    /// Reactive power, + inductive, of phase B.
    +18 REACTIVE_POWER_B: SignedPair = ro().unit("kvar").scale(3).cite("PFC-1, PFC-10");
    /// Reactive power, + inductive, of phase C.
    +20 REACTIVE_POWER_C: SignedPair = ro().unit("kvar").scale(3).cite("PFC-1, PFC-10");
    /// Reactive power, + inductive, of all phases.
    +22 REACTIVE_POWER_TOTAL: SignedPair = ro().unit("kvar").scale(3).cite("PFC-1, PFC-10");
    /// Apparent power of phase A.
    +24 APPARENT_POWER_A: Pair = ro().unit("kVA").scale(3).cite("PFC-1, PFC-10");
    /// Apparent power of phase B.
    +26 APPARENT_POWER_B: Pair = ro().unit("kVA").scale(3).cite("PFC-1, PFC-10");
    /// Apparent power of phase C.
    +28 APPARENT_POWER_C: Pair = ro().unit("kVA").scale(3).cite("PFC-1, PFC-10");
    /// Apparent power of all phases: the root of the squares of the totals.
    +30 APPARENT_POWER_TOTAL: Pair = ro().unit("kVA").scale(3).cite("PFC-1, PFC-10");
    /// Power factor of phase A, + inductive, - capacitive.
    +32 POWER_FACTOR_A: SignedPair = ro().unit("").scale(3).cite("PFC-1, PFC-10");
    /// Power factor of phase B, + inductive, - capacitive.
    +34 POWER_FACTOR_B: SignedPair = ro().unit("").scale(3).cite("PFC-1, PFC-10");
    /// Power factor of phase C, + inductive, - capacitive.
    +36 POWER_FACTOR_C: SignedPair = ro().unit("").scale(3).cite("PFC-1, PFC-10");
    /// Frequency.
    +38 FREQUENCY: Pair = ro().unit("Hz").scale(3).cite("PFC-1, PFC-10");
    /// Unusable, reads 0.
    +40 UNUSABLE_54: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +41 UNUSABLE_55: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +42 UNUSABLE_56: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +43 UNUSABLE_57: u16 = ro().cite("PFC-1");
}

registers! { CURRENT_A_DISTORTION at input(58);
    /// Total harmonic distortion of the current of phase A.
    +0 CURRENT_A_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENT_A_ORDERS at input(60).repeat(31, 2);
    /// Harmonic of the current of phase A, against its fundamental.
    +0 CURRENT_A_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENT_B_DISTORTION at input(122);
    /// Total harmonic distortion of the current of phase B.
    +0 CURRENT_B_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENT_B_ORDERS at input(124).repeat(31, 2);
    /// Harmonic of the current of phase B, against its fundamental.
    +0 CURRENT_B_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENT_C_DISTORTION at input(186);
    /// Total harmonic distortion of the current of phase C.
    +0 CURRENT_C_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { CURRENT_C_ORDERS at input(188).repeat(31, 2);
    /// Harmonic of the current of phase C, against its fundamental.
    +0 CURRENT_C_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_A_DISTORTION at input(250);
    /// Total harmonic distortion of the voltage of phase A.
    +0 VOLTAGE_A_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_A_ORDERS at input(252).repeat(31, 2);
    /// Harmonic of the voltage of phase A, against its fundamental.
    +0 VOLTAGE_A_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_B_DISTORTION at input(314);
    /// Total harmonic distortion of the voltage of phase B.
    +0 VOLTAGE_B_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_B_ORDERS at input(316).repeat(31, 2);
    /// Harmonic of the voltage of phase B, against its fundamental.
    +0 VOLTAGE_B_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_C_DISTORTION at input(378);
    /// Total harmonic distortion of the voltage of phase C.
    +0 VOLTAGE_C_THD: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { VOLTAGE_C_ORDERS at input(380).repeat(31, 2);
    /// Harmonic of the voltage of phase C, against its fundamental.
    +0 VOLTAGE_C_HARMONIC_N: Pair = ro().unit("%").scale(2).cite("PFC-1, PFC-10");
}

registers! { SWITCH_COUNTS at input(442).repeat(24, 2);
    /// How often the step was connected or disconnected.
    +0 STEP_N_SWITCH_COUNT: TenThousands = ro().eeprom().cite("PFC-1, PFC-14");
}

registers! { HOURS at input(490).repeat(24, 2);
    /// How long the step was connected.
    +0 STEP_N_HOURS_IN: Pair = ro().unit("h").scale(3).kept_by_device().cite("PFC-1, PFC-14");
}

registers! { ENERGIES at input(538);
    /// Unusable, reads 0.
    +0 UNUSABLE_538: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +1 UNUSABLE_539: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +2 UNUSABLE_540: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +3 UNUSABLE_541: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +4 UNUSABLE_542: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +5 UNUSABLE_543: u16 = ro().cite("PFC-1");
    /// Active energy taken.
    +6 ACTIVE_ENERGY_TOTAL: Pair = ro().unit("kWh").scale(3).kept_by_device().cite("PFC-1, PFC-15");
    /// Unusable, reads 0.
    +8 UNUSABLE_546: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +9 UNUSABLE_547: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +10 UNUSABLE_548: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +11 UNUSABLE_549: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +12 UNUSABLE_550: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +13 UNUSABLE_551: u16 = ro().cite("PFC-1");
    /// Inductive reactive energy.
    +14 INDUCTIVE_ENERGY_TOTAL: Pair = ro().unit("kvarh").scale(3).kept_by_device().cite("PFC-1, PFC-15");
    /// Unusable, reads 0.
    +16 UNUSABLE_554: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +17 UNUSABLE_555: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +18 UNUSABLE_556: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +19 UNUSABLE_557: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +20 UNUSABLE_558: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +21 UNUSABLE_559: u16 = ro().cite("PFC-1");
    /// Capacitive reactive energy.
    +22 CAPACITIVE_ENERGY_TOTAL: Pair = ro().unit("kvarh").scale(3).kept_by_device().cite("PFC-1, PFC-15");
    /// Unusable, reads 0.
    +24 UNUSABLE_562: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +25 UNUSABLE_563: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +26 UNUSABLE_564: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +27 UNUSABLE_565: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +28 UNUSABLE_566: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +29 UNUSABLE_567: u16 = ro().cite("PFC-1");
    /// Inductive energy, against the active energy.
    +30 INDUCTIVE_ENERGY_RATIO: Pair = ro().unit("%").scale(3).cite("PFC-1, PFC-15");
    /// Unusable, reads 0.
    +32 UNUSABLE_570: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +33 UNUSABLE_571: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +34 UNUSABLE_572: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +35 UNUSABLE_573: u16 = ro().cite("PFC-1");
    /// Unusable, reads 0.
    +36 UNUSABLE_574: u16 = ro().cite("PFC-1");
    /// The whole part of the capacitive energy ratio, where the manual prints it.
    +37 CAPACITIVE_ENERGY_RATIO_WHOLE: u16 = ro().unit("%").cite("PFC-1, PFC-15");
    /// Capacitive energy, against the active energy.
    +38 CAPACITIVE_ENERGY_RATIO: Pair = ro().unit("%").scale(3).cite("PFC-1, PFC-15");
}

registers! { LOG at input(578).repeat(8, 10);
    /// Kind of the event, 1 being the newest: 0 none, 1 overvoltage, 2 undervoltage, 3 overcurrent, 4 harmonic
    /// distortion, 5 high temperature, 6 digital input, 7 power loss.
    +0 EVENT_N_KIND: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// The measured value that was out of its limit.
    +1 EVENT_N_VALUE: Pair = ro().scale(3).kept_by_device().cite("PFC-1, PFC-16");
    /// Its phase: 0 none, 1 A, 2 B, 3 C.
    +3 EVENT_N_PHASE: u16 = ro().kept_by_device().cite("PFC-1, PFC-16");
    /// Day of the event.
    +4 EVENT_N_DAY: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// Month of the event.
    +5 EVENT_N_MONTH: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// Year of the event, 0 being 2000.
    +6 EVENT_N_YEAR: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// Second of the event.
    +7 EVENT_N_SECOND: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// Minute of the event.
    +8 EVENT_N_MINUTE: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
    /// Hour of the event.
    +9 EVENT_N_HOUR: u16 = ro().kept_by_device().cite("PFC-1, PFC-17");
}

registers! { STEP_SETTINGS at holding(1).repeat(24, 8);
    /// Type of the step: 0 inductive, 1 capacitive.
    +0 STEP_N_TYPE: u16 = rw().within(0, 1).default(1).eeprom().cite("PFC-1, PFC-11");
    /// Status of the step: 0 active (automatic), 1 fixed (always in), 2 passive (always out).
    +1 STEP_N_STATUS: u16 = rw().within(0, 2).defaults(STEP_STATUSES).eeprom().cite("PFC-1, PFC-12");
    /// Power of the step, whole part.
    +2 STEP_N_POWER_WHOLE: u16 = rw().within(0, 9999).defaults(STEP_POWERS).unit("kvar").eeprom().cite("PFC-1");
    /// Power of the step, hundredths.
    +3 STEP_N_POWER_DECIMALS: u16 = rw().within(0, 99).unit("kvar").scale(2).eeprom().cite("PFC-1");
    /// Connection of the step: 0 AN, 1 BN, 2 CN, 3 AB, 4 BC, 5 CA, 6 three-phase.
    +4 STEP_N_CONNECTION: u16 = rw().within(0, 6).default(6).eeprom().cite("PFC-1, PFC-10");
    /// How long the step waits before it connects, in its delay unit.
    +5 STEP_N_SWITCH_IN_DELAY: u16 = rw().within(0, 999).default(10).eeprom().cite("PFC-1, PFC-11");
    /// How long the step waits before it disconnects, in its delay unit.
    +6 STEP_N_SWITCH_OUT_DELAY: u16 = rw().within(0, 999).default(10).eeprom().cite("PFC-1, PFC-11");
    /// Unit of the step's delays: 0 minute, 1 second, 2 millisecond.
    +7 STEP_N_DELAY_UNIT: u16 = rw().within(0, 2).default(1).eeprom().cite("PFC-1, PFC-11");
}

/// Of 24 steps the first twelve are automatic (PFC-1).
const STEP_STATUSES: &[i64] = &[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2];

/// Powers of the first twelve steps in kvar (PFC-1).
const STEP_POWERS: &[i64] = &[1, 2, 2, 5, 5, 5, 10, 10, 10, 10, 20, 20, 0];

registers! { SETTINGS at holding(193);
    /// First target cos phi, whole part.
    +0 COS_PHI_1_WHOLE: u16 = rw().within(0, 1).default(1).eeprom().cite("PFC-1, PFC-11");
    /// First target cos phi, hundredths.
    +1 COS_PHI_1_DECIMALS: u16 = rw().within(0, 99).scale(2).eeprom().cite("PFC-1, PFC-11");
    /// Sign of the first target cos phi: 0 inductive, 1 capacitive.
    +2 COS_PHI_1_SIGN: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// Second target cos phi, whole part.
    +3 COS_PHI_2_WHOLE: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// Second target cos phi, hundredths.
    +4 COS_PHI_2_DECIMALS: u16 = rw().within(0, 99).default(95).scale(2).eeprom().cite("PFC-1, PFC-11");
    /// Sign of the second target cos phi: 0 inductive, 1 capacitive.
    +5 COS_PHI_2_SIGN: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// First target reactive power.
    +6 REFERENCE_VAR_1: u16 = rw().within(0, 999).unit("kvar").eeprom().cite("PFC-1, PFC-11");
    /// Sign of the first target reactive power: 0 inductive, 1 capacitive.
    +7 REFERENCE_SIGN_1: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// Second target reactive power.
    +8 REFERENCE_VAR_2: u16 = rw().within(0, 999).unit("kvar").eeprom().cite("PFC-1, PFC-11");
    /// Sign of the second target reactive power: 0 inductive, 1 capacitive.
    +9 REFERENCE_SIGN_2: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// Reserved; stored without effect.
    +10 RESERVED_203: u16 = rw().within(0, 65_535).eeprom().cite("PFC-1");
    /// Reserved; stored without effect.
    +11 RESERVED_204: u16 = rw().within(0, 65_535).eeprom().cite("PFC-1");
    /// Reserved; stored without effect.
    +12 RESERVED_205: u16 = rw().within(0, 65_535).eeprom().cite("PFC-1");
    /// Reserved; stored without effect.
    +13 RESERVED_206: u16 = rw().within(0, 65_535).eeprom().cite("PFC-1");
    /// What is controlled: 0 cos phi, 1 reference reactive power.
    +14 TARGET: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-11");
    /// Ratio of the current transformers; 0 counts as 1.
    +15 CURRENT_TRANSFORMER_RATIO: u16 = rw().within(0, 9999).default(1).eeprom().cite("PFC-1, PFC-10");
    /// Current transformers: 0 three phase, 1 single phase. Stored without effect.
    +16 CURRENT_TRANSFORMER_CONNECTION: u16 = rw().within(0, 1).eeprom().cite("PFC-1");
    /// Ratio of the voltage transformers; 0 counts as 1.
    +17 VOLTAGE_TRANSFORMER_RATIO: u16 = rw().within(0, 999).default(1).eeprom().cite("PFC-1, PFC-10");
    /// Voltage transformers: 0 three phase N, 1 single phase N, 2 phase-phase. Stored without effect.
    +18 VOLTAGE_TRANSFORMER_CONNECTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1");
    /// Power of the thyristor-controlled reactor between phases and neutral, whole part.
    +19 STAR_TCR_POWER_WHOLE: u16 = rw().within(0, 9999).unit("kvar").eeprom().cite("PFC-1, PFC-13");
    /// Power of the thyristor-controlled reactor between phases and neutral, hundredths.
    +20 STAR_TCR_POWER_DECIMALS: u16 = rw().within(0, 99).unit("kvar").scale(2).eeprom().cite("PFC-1, PFC-13");
    /// The thyristor-controlled reactor between phases and neutral: 0 passive, 1 active.
    +21 STAR_TCR_STATUS: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-13");
    /// 1 recomputes the gains of the reactor between phases and neutral from its power; reads 0.
    +22 STAR_TCR_UPDATE_KP_KI: u16 = command().within(1, 1).cite("PFC-1, PFC-6, PFC-13");
    /// Power of the thyristor-controlled reactor between phases, whole part.
    +23 DELTA_TCR_POWER_WHOLE: u16 = rw().within(0, 9999).unit("kvar").eeprom().cite("PFC-1, PFC-13");
    /// Power of the thyristor-controlled reactor between phases, hundredths.
    +24 DELTA_TCR_POWER_DECIMALS: u16 = rw().within(0, 99).unit("kvar").scale(2).eeprom().cite("PFC-1, PFC-13");
    /// The thyristor-controlled reactor between phases: 0 passive, 1 active.
    +25 DELTA_TCR_STATUS: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-13");
    /// 1 recomputes the gains of the reactor between phases from its power; reads 0.
    +26 DELTA_TCR_UPDATE_KP_KI: u16 = command().within(1, 1).cite("PFC-1, PFC-6, PFC-13");
    /// Harmonic distortion of the current above which the protection acts.
    +27 HARMONIC_LIMIT: u16 = rw().within(0, 99).default(20).unit("%").eeprom().cite("PFC-1, PFC-16");
    /// What this protection does: 0 nothing, 1 fault, 2 alarm.
    +28 HARMONIC_ACTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Output that this protection closes: 0 none, 1 output 1, 2 output 2.
    +29 HARMONIC_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Phase voltage above which the protection acts.
    +30 OVERVOLTAGE_LIMIT: u16 = rw().within(0, 65_535).default(260).unit("V").eeprom().cite("PFC-1, PFC-16");
    /// What this protection does: 0 nothing, 1 fault, 2 alarm.
    +31 OVERVOLTAGE_ACTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Output that this protection closes: 0 none, 1 output 1, 2 output 2.
    +32 OVERVOLTAGE_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Phase voltage below which the protection acts.
    +33 UNDERVOLTAGE_LIMIT: u16 = rw().within(0, 65_535).default(180).unit("V").eeprom().cite("PFC-1, PFC-16");
    /// What this protection does: 0 nothing, 1 fault, 2 alarm.
    +34 UNDERVOLTAGE_ACTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Output that this protection closes: 0 none, 1 output 1, 2 output 2.
    +35 UNDERVOLTAGE_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Phase current above which the protection acts.
    +36 OVERCURRENT_LIMIT: u16 = rw().within(0, 9999).default(1000).unit("A").eeprom().cite("PFC-1, PFC-16");
    /// What this protection does: 0 nothing, 1 fault, 2 alarm.
    +37 OVERCURRENT_ACTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Output that this protection closes: 0 none, 1 output 1, 2 output 2.
    +38 OVERCURRENT_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Temperature above which the protection acts.
    +39 TEMPERATURE_LIMIT: u16 = rw().within(0, 99).default(60).unit("°C").eeprom().cite("PFC-1, PFC-16");
    /// What this protection does: 0 nothing, 1 fault, 2 alarm.
    +40 TEMPERATURE_ACTION: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Output that this protection closes: 0 none, 1 output 1, 2 output 2.
    +41 TEMPERATURE_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-16");
    /// Temperature at which the fan starts.
    +42 FAN_ON_TEMPERATURE: u16 = rw().within(0, 99).default(40).unit("°C").eeprom().cite("PFC-1, PFC-18");
    /// Temperature at which the fan stops.
    +43 FAN_OFF_TEMPERATURE: u16 = rw().within(0, 99).default(30).unit("°C").eeprom().cite("PFC-1, PFC-18");
    /// Output of the fan: 0 none, 1 output 1, 2 output 2.
    +44 FAN_OUTPUT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-18");
    /// Reserved; stored without effect.
    +45 RESERVED_238: u16 = rw().within(0, 1).eeprom().cite("PFC-1");
    /// Reserved; stored without effect.
    +46 RESERVED_239: u16 = rw().within(0, 1).eeprom().cite("PFC-1");
    /// Compensation: 0 passive, 1 active.
    +47 COMPENSATION: u16 = rw().within(0, 1).default(1).eeprom().cite("PFC-1, PFC-11, PFC-12");
    /// Password of the front panel.
    +48 PASSWORD: u16 = rw().within(0, 9999).eeprom().cite("PFC-1");
    /// Language of the front panel: 0 English, 1 Turkish.
    +49 LANGUAGE: u16 = rw().within(0, 1).default(1).eeprom().cite("PFC-1");
    /// Unit number on the bus; 0 is reached by broadcasts only.
    +50 UNIT: u16 = rw().within(0, 255).default(1).eeprom().cite("PFC-1, PFC-8");
    /// Speed of the line: 0 is 2400, 1 is 4800, 2 is 9600, 3 is 19200, 4 is 38400, 5 is 57600 baud.
    +51 BAUD: u16 = rw().within(0, 5).default(3).eeprom().cite("PFC-1, PFC-6, PFC-8");
    /// Character format: 0 is 8E1, 1 is 8O1, 2 is 8N1, 3 is 8N2.
    +52 PARITY: u16 = rw().within(0, 3).default(2).eeprom().cite("PFC-1, PFC-8");
    /// Days, months or years after which the energies start anew; 0 never.
    +53 ENERGY_RESET_PERIOD: u16 = rw().within(0, 99).eeprom().cite("PFC-1, PFC-15");
    /// Unit of the energy reset period: 0 day, 1 month, 2 year.
    +54 ENERGY_RESET_UNIT: u16 = rw().within(0, 2).eeprom().cite("PFC-1, PFC-15");
    /// Seconds or minutes after which the device restarts; 0 never.
    +55 DEVICE_RESET_PERIOD: u16 = rw().within(0, 99).eeprom().cite("PFC-1, PFC-19");
    /// Unit of the device reset period: 0 second, 1 minute.
    +56 DEVICE_RESET_UNIT: u16 = rw().within(0, 1).eeprom().cite("PFC-1, PFC-19");
}

/// All tables, as the model lists them.
pub const MAP: &[&[Row]] = &[
    STEP_COILS,
    PORTS,
    VOLTAGES,
    CURRENTS_AND_POWERS,
    CURRENT_A_DISTORTION,
    CURRENT_A_ORDERS,
    CURRENT_B_DISTORTION,
    CURRENT_B_ORDERS,
    CURRENT_C_DISTORTION,
    CURRENT_C_ORDERS,
    VOLTAGE_A_DISTORTION,
    VOLTAGE_A_ORDERS,
    VOLTAGE_B_DISTORTION,
    VOLTAGE_B_ORDERS,
    VOLTAGE_C_DISTORTION,
    VOLTAGE_C_ORDERS,
    SWITCH_COUNTS,
    HOURS,
    ENERGIES,
    LOG,
    STEP_SETTINGS,
    SETTINGS,
];

/// What the line registers offer (PFC-8).
pub const LINE: LineOffer = LineOffer {
    unit: UNIT,
    units: (0, 255),
    baud: BAUD,
    bauds: &[(2400, 0), (4800, 1), (9600, 2), (19_200, 3), (38_400, 4), (57_600, 5)],
    formats: &[
        (Parity::Even, 1, &[(PARITY, 0)]),
        (Parity::Odd, 1, &[(PARITY, 1)]),
        (Parity::None, 1, &[(PARITY, 2)]),
        (Parity::None, 2, &[(PARITY, 3)]),
    ],
    factory: Line { baud: 19_200, parity: Parity::None, stop_bits: 1 },
};
