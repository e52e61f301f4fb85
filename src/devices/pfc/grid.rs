//! The grid: the load and the voltages that the world gives, and what a relay measures of them with steps and reactors
//! connected (PFC-10).

use crate::world::{Input, World};

crate::inputs! {
    /// Voltage of phase A at the relay's terminals.
    VOLTAGE_A: f64 = Input::number(0.0, 1000.0, 230.0).unit("V").cite("PFC-10");
    /// Voltage of phase B at the relay's terminals.
    VOLTAGE_B: f64 = Input::number(0.0, 1000.0, 230.0).unit("V").cite("PFC-10");
    /// Voltage of phase C at the relay's terminals.
    VOLTAGE_C: f64 = Input::number(0.0, 1000.0, 230.0).unit("V").cite("PFC-10");
    /// Frequency of the grid.
    FREQUENCY: f64 = Input::number(0.0, 1000.0, 50.0).unit("Hz").cite("PFC-10");
    /// Active power of the load on phase A; negative when it feeds back.
    LOAD_ACTIVE_A: f64 = Input::number(-10_000.0, 10_000.0, 20.0).unit("kW").cite("PFC-10");
    /// Active power of the load on phase B; negative when it feeds back.
    LOAD_ACTIVE_B: f64 = Input::number(-10_000.0, 10_000.0, 20.0).unit("kW").cite("PFC-10");
    /// Active power of the load on phase C; negative when it feeds back.
    LOAD_ACTIVE_C: f64 = Input::number(-10_000.0, 10_000.0, 20.0).unit("kW").cite("PFC-10");
    /// Reactive power of the load on phase A, + inductive.
    LOAD_REACTIVE_A: f64 = Input::number(-10_000.0, 10_000.0, 15.0).unit("kvar").cite("PFC-10");
    /// Reactive power of the load on phase B, + inductive.
    LOAD_REACTIVE_B: f64 = Input::number(-10_000.0, 10_000.0, 15.0).unit("kvar").cite("PFC-10");
    /// Reactive power of the load on phase C, + inductive.
    LOAD_REACTIVE_C: f64 = Input::number(-10_000.0, 10_000.0, 15.0).unit("kvar").cite("PFC-10");
    /// Total harmonic distortion of the currents.
    THD_CURRENT: f64 = Input::number(0.0, 500.0, 5.0).unit("%").cite("PFC-10");
    /// Total harmonic distortion of the voltages.
    THD_VOLTAGE: f64 = Input::number(0.0, 500.0, 2.0).unit("%").cite("PFC-10");
    /// Temperature at the relay.
    TEMPERATURE: f64 = Input::number(-100.0, 200.0, 25.0).unit("°C").cite("PFC-16, PFC-18");
    /// Digital input 1: the second target holds while it is on.
    INPUT_1: bool = Input::flag(false).cite("PFC-11");
    /// Digital input 2: its rise is logged.
    INPUT_2: bool = Input::flag(false).cite("PFC-17");
    /// The relay's supply: without it the relay is dark.
    SUPPLY: bool = Input::flag(true).cite("PFC-19");
}

/// The world as it stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scene {
    /// Phase voltages at the terminals.
    pub phase_v: [f64; 3],
    /// Active power of the load, phase by phase.
    pub load_kw: [f64; 3],
    /// Reactive power of the load, phase by phase.
    pub load_kvar: [f64; 3],
    /// Frequency.
    pub frequency_hz: f64,
    /// Distortion of the currents in %.
    pub thd_current: f64,
    /// Distortion of the voltages in %.
    pub thd_voltage: f64,
    /// Temperature.
    pub temperature_c: f64,
    /// Digital input 1.
    pub input_1: bool,
    /// Digital input 2.
    pub input_2: bool,
}

impl Scene {
    /// What the inputs say.
    pub fn of(world: &World) -> Self {
        Self {
            phase_v: [VOLTAGE_A, VOLTAGE_B, VOLTAGE_C].map(|input| world.number(input)),
            load_kw: [LOAD_ACTIVE_A, LOAD_ACTIVE_B, LOAD_ACTIVE_C].map(|input| world.number(input)),
            load_kvar: [LOAD_REACTIVE_A, LOAD_REACTIVE_B, LOAD_REACTIVE_C].map(|input| world.number(input)),
            frequency_hz: world.number(FREQUENCY),
            thd_current: world.number(THD_CURRENT),
            thd_voltage: world.number(THD_VOLTAGE),
            temperature_c: world.number(TEMPERATURE),
            input_1: world.flag(INPUT_1),
            input_2: world.flag(INPUT_2),
        }
    }

    /// Voltages between the phases at the terminals: AB, BC, CA.
    pub fn line_v(&self) -> [f64; 3] {
        line_voltages(&self.phase_v)
    }

    /// Whether a phase has voltage; without it nothing flows there.
    pub fn is_live(&self, phase: usize) -> bool {
        self.phase_v[phase] > 0.0
    }
}

/// Ratios of the transformers between grid and relay.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transformers {
    /// Grid volts for one volt at the relay.
    pub voltage: f64,
    /// Grid amperes for one ampere at the relay.
    pub current: f64,
}

impl Transformers {
    /// Ratios as the registers hold them; 0 counts as 1 (PFC-10).
    pub fn new(voltage: u16, current: u16) -> Self {
        Self { voltage: f64::from(voltage.max(1)), current: f64::from(current.max(1)) }
    }
}

/// The load alone, as it is displayed: what steps and reactors have not yet changed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Active power, phase by phase.
    pub active_kw: [f64; 3],
    /// Reactive power, phase by phase, + inductive.
    pub reactive_kvar: [f64; 3],
}

impl Load {
    /// The load of a scene behind its transformers; a phase without voltage has none (PFC-10).
    pub fn of(scene: &Scene, transformers: &Transformers) -> Self {
        let ratio = transformers.voltage * transformers.current;
        let displayed = |power: &[f64; 3]| {
            std::array::from_fn(|phase| if scene.is_live(phase) { power[phase] * ratio } else { 0.0 })
        };
        Self { active_kw: displayed(&scene.load_kw), reactive_kvar: displayed(&scene.load_kvar) }
    }
}

/// What the relay measures: one consistent state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Voltages of the phases to neutral.
    pub phase_v: [f64; 3],
    /// Voltages between the phases: AB, BC, CA.
    pub line_v: [f64; 3],
    /// Magnitude of the vector sum of the phase voltages.
    pub neutral_v: f64,
    /// Currents of the phases.
    pub phase_a: [f64; 3],
    /// Magnitude of the vector sum of the phase currents.
    pub earth_a: f64,
    /// Active power, phase by phase and in total.
    pub active_kw: [f64; 4],
    /// Reactive power, phase by phase and in total, + inductive.
    pub reactive_kvar: [f64; 4],
    /// Apparent power, phase by phase and in total.
    pub apparent_kva: [f64; 4],
    /// Power factors of the phases, + inductive, − capacitive.
    pub power_factor: [f64; 3],
}

impl Measured {
    /// The state of a grid whose phases carry these powers, as displayed (PFC-10).
    pub fn of(scene: &Scene, transformers: &Transformers, active_kw: [f64; 3], reactive_kvar: [f64; 3]) -> Self {
        let phase_v = scene.phase_v.map(|volts| volts * transformers.voltage);
        let active_kw = with_total(active_kw);
        let reactive_kvar = with_total(reactive_kvar);
        let apparent_kva: [f64; 4] = std::array::from_fn(|index| active_kw[index].hypot(reactive_kvar[index]));
        let per_volt =
            |power: f64, phase: usize| if scene.is_live(phase) { power * 1000.0 / phase_v[phase] } else { 0.0 };
        let phase_a = std::array::from_fn(|phase| per_volt(apparent_kva[phase], phase));
        // The current of an inductive load lags behind its voltage.
        let vectors =
            std::array::from_fn(|phase| (per_volt(active_kw[phase], phase), -per_volt(reactive_kvar[phase], phase)));
        Self {
            line_v: line_voltages(&phase_v),
            neutral_v: vector_sum(phase_v.map(|volts| (volts, 0.0))),
            earth_a: vector_sum(vectors),
            power_factor: std::array::from_fn(|phase| {
                power_factor(active_kw[phase], reactive_kvar[phase], apparent_kva[phase])
            }),
            phase_v,
            phase_a,
            active_kw,
            reactive_kvar,
            apparent_kva,
        }
    }

    /// Total reactive power, + inductive.
    pub fn total_kvar(&self) -> f64 {
        self.reactive_kvar[3]
    }

    /// Total active power.
    pub fn total_kw(&self) -> f64 {
        self.active_kw[3]
    }
}

fn with_total([a, b, c]: [f64; 3]) -> [f64; 4] {
    [a, b, c, a + b + c]
}

/// Where nothing flows the factor shows 1. The sign is that of the reactive power as it is displayed.
fn power_factor(active_kw: f64, reactive_kvar: f64, apparent_kva: f64) -> f64 {
    let is_capacitive = (reactive_kvar * 1000.0).round() < 0.0;
    let factor = if apparent_kva > 0.0 { active_kw.abs() / apparent_kva } else { 1.0 };
    if is_capacitive { -factor } else { factor }
}

/// Between two phases 120° apart the voltage is the third side of their triangle.
fn line_voltages(phase_v: &[f64; 3]) -> [f64; 3] {
    let between = |a: f64, b: f64| (a * a + b * b + a * b).sqrt();
    std::array::from_fn(|line| between(phase_v[line], phase_v[(line + 1) % 3]))
}

/// Magnitude of the sum of three vectors, each given against its own phase, A at 0°, B at −120°, C at 120°.
fn vector_sum(vectors: [(f64, f64); 3]) -> f64 {
    let sine = 3.0_f64.sqrt() / 2.0;
    let directions = [(1.0, 0.0), (-0.5, -sine), (-0.5, sine)];
    let turned = vectors.iter().zip(directions).map(|((x, y), (cos, sin))| (x * cos - y * sin, x * sin + y * cos));
    let (x, y) = turned.fold((0.0, 0.0), |(x, y), (dx, dy)| (x + dx, y + dy));
    x.hypot(y)
}
