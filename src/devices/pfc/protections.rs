//! Protections: limits that are watched, and what happens beyond them (PFC-16); the fan (PFC-18).

use super::events::{EventKind, Reading};
use super::grid::{Measured, Scene};
use super::map::{
    FAN_OFF_TEMPERATURE, FAN_ON_TEMPERATURE, FAN_OUTPUT, HARMONIC_ACTION, HARMONIC_LIMIT, HARMONIC_OUTPUT,
    OVERCURRENT_ACTION, OVERCURRENT_LIMIT, OVERCURRENT_OUTPUT, OVERVOLTAGE_ACTION, OVERVOLTAGE_LIMIT,
    OVERVOLTAGE_OUTPUT, TEMPERATURE_ACTION, TEMPERATURE_LIMIT, TEMPERATURE_OUTPUT, UNDERVOLTAGE_ACTION,
    UNDERVOLTAGE_LIMIT, UNDERVOLTAGE_OUTPUT,
};
use crate::image::Image;
use crate::time::SECOND_US;

/// The kinds of protection, in the order of their events.
pub const KINDS: [EventKind; 5] = [
    EventKind::Overvoltage,
    EventKind::Undervoltage,
    EventKind::Overcurrent,
    EventKind::HarmonicDistortion,
    EventKind::HighTemperature,
];

/// How long a value must be beyond its limit.
const HOLD_US: i64 = SECOND_US;

/// What a protection does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Action {
    /// Nothing.
    #[default]
    Passive,
    /// It logs, closes its output and takes all automatic steps out.
    Fault,
    /// It logs and closes its output.
    Alarm,
}

/// The settings of one protection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Protection {
    /// The limit in the unit of the value.
    pub limit: i64,
    /// What it does.
    pub action: Action,
    /// The output that it closes; 0 none.
    pub output: u16,
}

impl Protection {
    /// All protections in the order of [`KINDS`].
    pub fn all(regs: &Image) -> [Self; 5] {
        let protection = |limit, action, output| Self {
            limit: i64::from(regs.get(limit)),
            action: match regs.get(action) {
                1 => Action::Fault,
                2 => Action::Alarm,
                _ => Action::Passive,
            },
            output: regs.get(output),
        };
        [
            protection(OVERVOLTAGE_LIMIT, OVERVOLTAGE_ACTION, OVERVOLTAGE_OUTPUT),
            protection(UNDERVOLTAGE_LIMIT, UNDERVOLTAGE_ACTION, UNDERVOLTAGE_OUTPUT),
            protection(OVERCURRENT_LIMIT, OVERCURRENT_ACTION, OVERCURRENT_OUTPUT),
            protection(HARMONIC_LIMIT, HARMONIC_ACTION, HARMONIC_OUTPUT),
            protection(TEMPERATURE_LIMIT, TEMPERATURE_ACTION, TEMPERATURE_OUTPUT),
        ]
    }

    fn is_beyond(&self, kind: EventKind, milli: i64) -> bool {
        let limit_milli = self.limit * 1000;
        if kind == EventKind::Undervoltage { milli < limit_milli } else { milli > limit_milli }
    }

    /// Back by 2 % of the limit.
    fn is_normal(&self, kind: EventKind, milli: i64) -> bool {
        if kind == EventKind::Undervoltage { milli >= self.limit * 1020 } else { milli <= self.limit * 980 }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Standing {
    #[default]
    Normal,
    Beyond {
        since_us: i64,
    },
    Tripped,
}

/// Where each protection stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Protections {
    standings: [Standing; 5],
}

impl Protections {
    /// Looks at the values at a running time: a protection begins to wait, gives up waiting or comes back to normal.
    pub fn watch(&mut self, settings: &[Protection; 5], readings: &[Reading; 5], at_us: i64) {
        for (index, standing) in self.standings.iter_mut().enumerate() {
            let (kind, protection, milli) = (KINDS[index], settings[index], readings[index].milli);
            *standing = match *standing {
                _ if protection.action == Action::Passive => Standing::Normal,
                Standing::Tripped if protection.is_normal(kind, milli) => Standing::Normal,
                Standing::Tripped => Standing::Tripped,
                _ if !protection.is_beyond(kind, milli) => Standing::Normal,
                Standing::Normal => Standing::Beyond { since_us: at_us },
                waiting => waiting,
            };
        }
    }

    /// The running time at which the next one trips.
    pub fn due_us(&self) -> Option<i64> {
        let due = |standing: &Standing| match standing {
            Standing::Beyond { since_us } => Some(since_us + HOLD_US),
            _ => None,
        };
        self.standings.iter().filter_map(due).min()
    }

    /// Trips those whose time has come, and gives their numbers in [`KINDS`].
    pub fn trip(&mut self, at_us: i64) -> impl Iterator<Item = usize> {
        let mut tripped = [false; 5];
        for (standing, tripped) in self.standings.iter_mut().zip(&mut tripped) {
            if matches!(standing, Standing::Beyond { since_us } if *since_us + HOLD_US <= at_us) {
                *standing = Standing::Tripped;
                *tripped = true;
            }
        }
        (0..5).filter(move |index| tripped[*index])
    }

    /// Whether a fault keeps the automatic steps out.
    pub fn has_fault(&self, settings: &[Protection; 5]) -> bool {
        self.tripped(settings).any(|protection| protection.action == Action::Fault)
    }

    /// Whether an output is closed by one of them.
    pub fn closes(&self, output: u16, settings: &[Protection; 5]) -> bool {
        self.tripped(settings).any(|protection| protection.output == output)
    }

    fn tripped<'a>(&self, settings: &'a [Protection; 5]) -> impl Iterator<Item = &'a Protection> {
        let standings = self.standings;
        settings
            .iter()
            .zip(standings)
            .filter(|(_, standing)| *standing == Standing::Tripped)
            .map(|(setting, _)| setting)
    }
}

/// What the protections watch, in the order of [`KINDS`]: the value of the worst phase and that phase, the first of
/// several that are alike.
pub fn readings(measured: &Measured, scene: &Scene) -> [Reading; 5] {
    let phases = |values: &[f64; 3]| -> [Reading; 3] {
        std::array::from_fn(|phase| Reading { milli: milli(values[phase]), phase: phase as u16 + 1 })
    };
    let highest = |values: &[f64; 3]| phases(values).into_iter().rev().max_by_key(|reading| reading.milli);
    let lowest = |values: &[f64; 3]| phases(values).into_iter().min_by_key(|reading| reading.milli);
    [
        highest(&measured.phase_v).unwrap_or_default(),
        lowest(&measured.phase_v).unwrap_or_default(),
        highest(&measured.phase_a).unwrap_or_default(),
        Reading { milli: milli(scene.thd_current), phase: 1 },
        Reading { milli: milli(scene.temperature_c), phase: 0 },
    ]
}

fn milli(value: f64) -> i64 {
    (value * 1000.0).round() as i64
}

/// The settings of the fan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fan {
    /// It starts at this temperature.
    pub on_c: f64,
    /// It stops at this temperature.
    pub off_c: f64,
    /// The output that it closes; 0 none.
    pub output: u16,
}

impl Fan {
    /// What the registers say.
    pub fn of(regs: &Image) -> Self {
        Self {
            on_c: f64::from(regs.get(FAN_ON_TEMPERATURE)),
            off_c: f64::from(regs.get(FAN_OFF_TEMPERATURE)),
            output: regs.get(FAN_OUTPUT),
        }
    }

    /// Whether it runs now: on at and above one temperature, off at and below the other, between them as it was; where
    /// both hold, on wins (PFC-18).
    pub fn runs(&self, ran: bool, temperature_c: f64) -> bool {
        temperature_c >= self.on_c || (ran && temperature_c > self.off_c)
    }
}
