//! The relay at work: between two events its state is constant, so it lives from event to event, and its meters add up
//! what lies between. Knows no requests and no options.

use chrono::NaiveDateTime;
use serde::{Deserialize, Serialize};

use super::controller::{self, Move};
use super::energy::{Meters, Rates};
use super::events::{Event, EventKind, Log, Reading};
use super::grid::{Load, Measured, Scene};
use super::map::{STEP_N_SWITCH_COUNT, STEPS};
use super::protections::{KINDS, Protections, readings};
use super::settings::Settings;
use super::steps::Status;
use super::tcr::Gains;
use crate::image::Image;
use crate::map::TenThousands;
use crate::time::{Moment, civil_difference_us, civil_plus_us};

/// Errors beyond this, a million megavars, are as good as it: sums of them stay far from overflow.
const ERROR_END_MVAR: f64 = 1e15;

/// The relay's live state.
#[derive(Clone, Debug, Default)]
pub struct Relay {
    /// What EEPROM keeps of it.
    pub memory: Memory,
    /// What it measures now.
    pub measured: Measured,
    /// The world that it stands in.
    pub scene: Scene,
    /// Whether each step is in.
    pub connected: [bool; STEPS],
    settings: Settings,
    /// The running time up to which it has lived.
    at_us: i64,
    pending: Option<Pending>,
    protections: Protections,
    fan_runs: bool,
    energy_reset_us: Option<i64>,
    restart_us: Option<i64>,
    rates: Rates,
}

/// What EEPROM keeps of the relay beside registers (PFC-20).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Energies and hours.
    pub meters: Meters,
    /// Events.
    pub log: Log,
    /// Gains of the star and the delta reactor; a change of them counts from the next settings on.
    pub gains: [Gains; 2],
    /// When the energies last started anew; `None` before the first start.
    pub energy_reset: Option<NaiveDateTime>,
}

/// A step that waits for its delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pending {
    step: usize,
    since_us: i64,
}

/// What happens next. Of several at one moment the first named comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Happening {
    EnergyReset,
    Restart,
    Trip,
    Switching,
}

impl Relay {
    /// It starts: all steps have fallen out, and those that connect now count (PFC-19).
    pub fn start(&mut self, now: Moment, scene: Scene, settings: Settings, regs: &mut Image) {
        self.scene = scene;
        self.settings = settings;
        self.at_us = now.running_us;
        self.clock_moved(now);
        self.restart(now.running_us, regs);
    }

    fn restart(&mut self, at_us: i64, regs: &mut Image) {
        self.connected = [false; STEPS];
        self.pending = None;
        self.protections = Protections::default();
        self.fan_runs = false;
        self.restart_us = self.settings.restart_every_us.map(|period_us| at_us + period_us);
        self.settle(at_us, regs);
    }

    /// Lives up to `now`; gives whether anything happened.
    pub fn live(&mut self, now: Moment, regs: &mut Image) -> bool {
        let mut has_happened = false;
        while let Some((due_us, happening)) = self.next().filter(|(due_us, _)| *due_us <= now.running_us) {
            self.pass(due_us);
            self.happen(happening, moment_at(now, due_us), regs);
            has_happened = true;
        }
        self.pass(now.running_us);
        has_happened
    }

    fn next(&self) -> Option<(i64, Happening)> {
        let all = [
            self.energy_reset_us.map(|due_us| (due_us, Happening::EnergyReset)),
            self.restart_us.map(|due_us| (due_us, Happening::Restart)),
            self.protections.due_us().map(|due_us| (due_us, Happening::Trip)),
            self.pending.map(|pending| (self.due_us(pending), Happening::Switching)),
        ];
        // What is overdue because a delay was shortened happens now.
        all.into_iter().flatten().map(|(due_us, happening)| (due_us.max(self.at_us), happening)).min()
    }

    fn due_us(&self, pending: Pending) -> i64 {
        let step = &self.settings.steps[pending.step];
        let delay_us = if self.connected[pending.step] { step.switch_out_us } else { step.switch_in_us };
        pending.since_us + delay_us
    }

    fn pass(&mut self, to_us: i64) {
        let us = u64::try_from(to_us - self.at_us).unwrap_or(0);
        self.memory.meters.run(&self.rates, &self.connected, us);
        self.at_us += us as i64;
    }

    fn happen(&mut self, happening: Happening, at: Moment, regs: &mut Image) {
        match happening {
            Happening::EnergyReset => {
                self.memory.meters.reset_energies();
                self.memory.energy_reset = Some(at.civil);
                self.plan_energy_reset(at);
            }
            Happening::Restart => self.restart(at.running_us, regs),
            Happening::Trip => {
                let readings = readings(&self.measured, &self.scene);
                for index in self.protections.trip(at.running_us) {
                    self.memory.log.push(Event { kind: KINDS[index], reading: readings[index], time: at.civil });
                }
                self.settle(at.running_us, regs);
            }
            Happening::Switching => {
                if let Some(pending) = self.pending.take() {
                    self.switch(pending.step, regs);
                }
                self.settle(at.running_us, regs);
            }
        }
    }

    /// The world has changed, now that the relay has lived up to `now`.
    pub fn set_scene(&mut self, scene: Scene, now: Moment, regs: &mut Image) {
        let has_risen = scene.input_2 && !self.scene.input_2;
        self.scene = scene;
        if has_risen {
            self.log(EventKind::DigitalInput, now.civil);
        }
        self.settle(now.running_us, regs);
    }

    /// The settings have changed, now that the relay has lived up to `now`.
    pub fn set_settings(&mut self, settings: Settings, now: Moment, regs: &mut Image) {
        let restarts_otherwise = settings.restart_every_us != self.settings.restart_every_us;
        self.settings = settings;
        if restarts_otherwise {
            self.restart_us = self.settings.restart_every_us.map(|period_us| now.running_us + period_us);
        }
        self.plan_energy_reset(now);
        self.settle(now.running_us, regs);
    }

    /// The civil clock was moved, or read again for the first time.
    pub fn clock_moved(&mut self, now: Moment) {
        // A clock that was set back would put the next reset far off.
        let last = self.memory.energy_reset.unwrap_or(now.civil);
        self.memory.energy_reset = Some(last.min(now.civil));
        self.plan_energy_reset(now);
    }

    fn plan_energy_reset(&mut self, now: Moment) {
        let last = self.memory.energy_reset.unwrap_or(now.civil);
        let due = self.settings.energy_reset.due(last, now.civil);
        self.energy_reset_us = due.map(|due| now.running_us + civil_difference_us(due, now.civil));
    }

    /// Logs an event that has neither value nor phase.
    pub fn log(&mut self, kind: EventKind, time: NaiveDateTime) {
        self.memory.log.push(Event { kind, reading: Reading::default(), time });
    }

    /// The moment up to which it has lived, no jump of the clock being between that and `now`.
    pub fn lived_to(&self, now: Moment) -> Moment {
        moment_at(now, self.at_us)
    }

    /// Whether an output, 1 or 2, is closed.
    pub fn closes(&self, output: u16) -> bool {
        self.protections.closes(output, &self.settings.protections)
            || (self.fan_runs && self.settings.fan.output == output)
    }

    /// Draws all conclusions from scene, settings and steps at this moment. Done again it changes nothing.
    fn settle(&mut self, at_us: i64, regs: &mut Image) {
        loop {
            self.enforce(regs);
            let had_fault = self.has_fault();
            let error_kvar = self.measure();
            self.protections.watch(&self.settings.protections, &readings(&self.measured, &self.scene), at_us);
            if self.has_fault() == had_fault {
                self.plan(error_kvar, at_us, regs);
                break;
            }
        }
        self.fan_runs = self.settings.fan.runs(self.fan_runs, self.scene.temperature_c);
        self.rates = Rates::of(self.measured.total_kw(), self.measured.total_kvar());
    }

    fn has_fault(&self) -> bool {
        self.protections.has_fault(&self.settings.protections)
    }

    /// Puts in and out without delay the steps that are not the controller's to decide (PFC-12, PFC-16).
    fn enforce(&mut self, regs: &mut Image) {
        let is_controlled = self.settings.is_compensating && !self.has_fault();
        for step in 0..STEPS {
            let wanted = match self.settings.steps[step].status {
                Status::Fixed => true,
                Status::Passive => false,
                Status::Automatic => self.connected[step] && is_controlled,
            };
            if self.connected[step] != wanted {
                self.switch(step, regs);
            }
        }
    }

    fn switch(&mut self, step: usize, regs: &mut Image) {
        self.connected[step] = !self.connected[step];
        let TenThousands(count) = regs.get(STEP_N_SWITCH_COUNT.nth(step));
        regs.set(STEP_N_SWITCH_COUNT.nth(step), TenThousands(count.saturating_add(1)));
    }

    /// Measures; gives how far the total reactive power is from the target before the reactors absorb.
    fn measure(&mut self) -> f64 {
        let Load { active_kw, mut reactive_kvar } = Load::of(&self.scene, &self.settings.transformers);
        for step in (0..STEPS).filter(|step| self.connected[*step]) {
            let adds_kvar = self.adds_kvar(step);
            for phase in 0..3 {
                reactive_kvar[phase] += adds_kvar[phase];
            }
        }
        let target = self.settings.targets[usize::from(self.scene.input_1)];
        let error_kvar = reactive_kvar.iter().sum::<f64>() - target.kvar(active_kw.iter().sum());
        let absorbed_kvar = (-error_kvar).clamp(0.0, self.reach_kvar());
        let live = (0..3).filter(|phase| self.scene.is_live(*phase)).count().max(1) as f64;
        for phase in (0..3).filter(|phase| self.scene.is_live(*phase)) {
            reactive_kvar[phase] += absorbed_kvar / live;
        }
        self.measured = Measured::of(&self.scene, &self.settings.transformers, active_kw, reactive_kvar);
        error_kvar
    }

    fn adds_kvar(&self, step: usize) -> [f64; 3] {
        self.settings.steps[step].adds_kvar(&self.scene.phase_v, &self.scene.line_v())
    }

    /// The most that both reactors can absorb together; a phase without voltage takes its third away.
    fn reach_kvar(&self) -> f64 {
        let live = (0..3).filter(|phase| self.scene.is_live(*phase)).count() as f64;
        let reach = self.settings.tcrs.iter().zip(self.memory.gains).map(|(tcr, gains)| tcr.reach_kvar(gains));
        reach.sum::<f64>() * live / 3.0
    }

    /// Lets the controller choose. A step that already waits goes on waiting as long as it is part of the plan.
    fn plan(&mut self, error_kvar: f64, at_us: i64, regs: &Image) {
        let is_controlled = self.settings.is_compensating && !self.has_fault();
        let moves = if is_controlled { self.moves(error_kvar, regs) } else { Vec::new() };
        let error_mvar = (error_kvar * 1e6).clamp(-ERROR_END_MVAR, ERROR_END_MVAR).round() as i64;
        let reach_mvar = (self.reach_kvar() * 1e6).round() as i64;
        self.pending = controller::plan(error_mvar, reach_mvar, &moves).map(|plan| {
            let waiting = self.pending.filter(|pending| plan.steps[pending.step]);
            waiting.unwrap_or(Pending { step: plan.first, since_us: at_us })
        });
    }

    /// The automatic steps whose switching leads towards the target.
    fn moves(&self, error_kvar: f64, regs: &Image) -> Vec<Move> {
        let automatic = (0..STEPS).filter(|step| self.settings.steps[*step].status == Status::Automatic);
        let moves = automatic.map(|step| {
            let adds_kvar: f64 = self.adds_kvar(step).iter().sum();
            let change_kvar = if self.connected[step] { -adds_kvar } else { adds_kvar };
            let effect_kvar = if error_kvar > 0.0 { -change_kvar } else { change_kvar };
            let TenThousands(switch_count) = regs.get(STEP_N_SWITCH_COUNT.nth(step));
            Move { step, effect_mvar: (effect_kvar * 1e6).round() as i64, switch_count }
        });
        moves.filter(|one| one.effect_mvar > 0).collect()
    }
}

/// The moment of a running time that lies before `now`, no jump of the clock being in between.
fn moment_at(now: Moment, running_us: i64) -> Moment {
    Moment { running_us, civil: civil_plus_us(now.civil, running_us - now.running_us), ..now }
}
