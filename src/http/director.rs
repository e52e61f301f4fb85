//! Changes of what all buses share, one after the other: the clock, snapshots, the numbers of faults.
//!
//! The clock of every bus is held first and brought to one moment, then changed, then let go: so all buses go on from the
//! same moment, whatever was asked of them in between. A long advance goes through the buses in short steps, so that they
//! answer all the while.

use std::collections::BTreeMap;
use std::time::{Duration, Instant as Watch};

use tokio::sync::{broadcast, mpsc, oneshot};
use tokio::time::{MissedTickBehavior, interval};

use super::app::Line;
use super::clock::{ClockView, Turn, civil_text};
use super::error::ApiError;
use super::events::Told;
use super::snapshots::SnapshotView;
use crate::bus::Snapshot;
use crate::faults::Fault;
use crate::time::{Moment, SECOND_US, civil_difference_us};

/// The way back to who asked.
pub type Answer<T> = oneshot::Sender<Result<T, ApiError>>;

/// What the director is asked for.
pub enum Order {
    /// Change the clock.
    Turn(Turn, Answer<ClockView>),
    /// Keep everything under a name.
    Keep(String, Answer<SnapshotView>),
    /// Bring back what was kept.
    Restore(String, Answer<ClockView>),
    /// Forget what was kept.
    Forget(String, Answer<()>),
    /// What is kept.
    Snapshots(Answer<Vec<SnapshotView>>),
    /// Back to the start.
    Reset(Answer<ClockView>),
    /// Add a fault to the bus of this index, and give it a number; one without a seed gets its number for a seed.
    AddFault(usize, Box<Fault>, bool, Answer<u64>),
    /// Somebody follows the events.
    Watch(Answer<()>),
}

impl Order {
    /// Asks the director, and waits for what comes of it.
    ///
    /// # Errors
    /// What the director answers.
    pub async fn send<T>(
        director: &mpsc::Sender<Order>,
        order: impl FnOnce(Answer<T>) -> Order,
    ) -> Result<T, ApiError> {
        let (answer, result) = oneshot::channel();
        let ended = || ApiError::unavailable("the program is ending");
        director.send(order(answer)).await.map_err(|_| ended())?;
        result.await.map_err(|_| ended())?
    }
}

/// Everything as it was.
#[derive(Clone, Debug)]
pub struct Kept {
    /// The buses, in their order.
    pub buses: Vec<Snapshot>,
    /// The last number that a fault had.
    last_fault: u64,
    at: Moment,
}

impl Kept {
    /// Before the buses run, at their first moment; no bus is in it yet.
    pub fn start(at: Moment) -> Self {
        Self { buses: Vec::new(), last_fault: 0, at }
    }

    fn view(&self, name: &str) -> SnapshotView {
        SnapshotView { name: name.into(), now: civil_text(self.at.civil), elapsed_s: super::clock::elapsed_s(self.at) }
    }
}

/// The most snapshots that are kept.
const SNAPSHOTS_MAX: usize = 64;

/// The most faults on a bus.
const FAULTS_MAX: usize = 256;

/// How long a step of an advance may keep a bus from answering.
const STEP: Duration = Duration::from_millis(3);

/// Simulated time of the first step, the shortest and the longest, in microseconds.
const STEP_US: (i64, i64, i64) = (60 * SECOND_US, SECOND_US, 6 * 3600 * SECOND_US);

/// How often is looked whether anybody still follows the events.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// See the module.
pub struct Director {
    lines: Vec<Line>,
    start: Kept,
    snapshots: BTreeMap<String, Kept>,
    last_fault: u64,
    events: broadcast::Sender<Told>,
    is_watching: bool,
    /// Simulated microseconds that a step of an advance took last.
    step_us: i64,
}

impl Director {
    /// The director of these buses, which started as `start` says.
    pub fn new(lines: Vec<Line>, start: Kept, events: broadcast::Sender<Told>) -> Self {
        let (snapshots, is_watching, step_us) = (BTreeMap::new(), false, STEP_US.0);
        Self { lines, start, snapshots, last_fault: 0, events, is_watching, step_us }
    }

    /// Does what is asked until nobody is left to ask.
    pub async fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        let mut look = interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                order = orders.recv() => match order {
                    Some(order) => self.obey(order).await,
                    None => return,
                },
                _ = look.tick() => {
                    if self.is_watching && self.events.receiver_count() == 0 {
                        // A bus that has ended needs no looking after.
                        let _ = self.watch(false).await;
                    }
                }
            }
        }
    }

    /// Whoever asked may have gone, and then nobody hears the answer.
    async fn obey(&mut self, order: Order) {
        match order {
            Order::Turn(turn, mut answer) => {
                let result = self.turn(turn, &mut answer).await;
                let _ = answer.send(result);
            }
            Order::Keep(name, answer) => {
                let _ = answer.send(self.keep(name).await);
            }
            Order::Restore(name, answer) => {
                let _ = answer.send(self.restore(&name).await);
            }
            Order::Forget(name, answer) => {
                let found = self.snapshots.remove(&name).map(|_| ());
                let _ = answer.send(found.ok_or_else(|| self.no_snapshot(&name)));
            }
            Order::Snapshots(answer) => {
                let views = self.snapshots.iter().map(|(name, kept)| kept.view(name)).collect();
                let _ = answer.send(Ok(views));
            }
            Order::Reset(answer) => {
                let _ = answer.send(self.reset().await);
            }
            Order::AddFault(bus, fault, has_seed, answer) => {
                let _ = answer.send(self.add_fault(bus, *fault, has_seed).await);
            }
            Order::Watch(answer) => {
                let _ = answer.send(self.watch(true).await);
            }
        }
    }

    fn no_snapshot(&self, name: &str) -> ApiError {
        ApiError::none_of("snapshot", name, self.snapshots.keys().map(String::as_str))
    }

    /// Stops the clocks of all buses at one moment; gives it, and the rate that they had.
    async fn hold(&mut self) -> Result<(Moment, f64), ApiError> {
        let mut held: Option<(Moment, f64)> = None;
        for line in &self.lines {
            let (moment, rate) = line.call(|bus, now| (bus.hold(now), bus.rate())).await?;
            held = Some(match held {
                Some((other, rate)) if other.running_us >= moment.running_us => {
                    (Moment { elapsed: moment.elapsed, ..other }, rate)
                }
                _ => (moment, rate),
            });
        }
        let (moment, rate) = held.ok_or_else(|| ApiError::unavailable("there is no bus"))?;
        for line in &self.lines {
            line.call(move |bus, now| bus.align(now, moment)).await?;
        }
        Ok((moment, rate))
    }

    /// Lets all clocks run again from one moment; gives it.
    async fn let_go(&mut self, rate: f64) -> Result<ClockView, ApiError> {
        let mut from = None;
        for line in &self.lines {
            let moment = line.call(|bus, now| bus.moment(now)).await?;
            from = Some(Moment { elapsed: moment.elapsed, ..from.unwrap_or(moment) });
        }
        let from = from.ok_or_else(|| ApiError::unavailable("there is no bus"))?;
        for line in &self.lines {
            line.call(move |bus, now| bus.resume(now, from, rate)).await?;
        }
        Ok(ClockView::at(from, rate))
    }

    async fn turn(&mut self, turn: Turn, answer: &mut Answer<ClockView>) -> Result<ClockView, ApiError> {
        let (moment, mut rate) = self.hold().await?;
        let done = match turn {
            Turn::Now(civil) => self.jump(civil).await,
            Turn::Rate(new) => {
                rate = new;
                Ok(())
            }
            Turn::Advance(us) => self.advance(us, answer).await,
            Turn::Until(civil) => match civil_difference_us(civil, moment.civil) {
                us if us < 0 => {
                    let now = civil_text(moment.civil);
                    let message = format!("until takes a time ahead of now, {now}; to go back, set now");
                    Err(ApiError::value(message).of("until"))
                }
                us => self.advance(us, answer).await,
            },
        };
        let view = self.let_go(rate).await?;
        done.map(|()| view)
    }

    async fn jump(&mut self, civil: chrono::NaiveDateTime) -> Result<(), ApiError> {
        for line in &self.lines {
            line.call(move |bus, now| bus.jump_clock(now, civil)).await?;
        }
        Ok(())
    }

    /// Lets simulated time pass on all buses, in steps that they have time for between two requests. It passes the end of
    /// 2099 as it does at a rate: what clocks of devices show then is theirs to say (ASTRO-14).
    async fn advance(&mut self, us: i64, answer: &mut Answer<ClockView>) -> Result<(), ApiError> {
        let mut left_us = us;
        while left_us > 0 && !answer.is_closed() {
            let step_us = self.step_us.min(left_us);
            let mut longest = Duration::ZERO;
            for line in &self.lines {
                let took = line.call(move |bus, now| {
                    let watch = Watch::now();
                    bus.advance_clock(now, step_us);
                    watch.elapsed()
                });
                longest = longest.max(took.await?);
            }
            left_us -= step_us;
            let share = STEP.as_secs_f64() / longest.as_secs_f64().max(1e-6);
            let next_us = (self.step_us as f64 * share.clamp(0.25, 2.0)) as i64;
            self.step_us = next_us.clamp(STEP_US.1, STEP_US.2);
        }
        // What moves by itself has moved far, and would be lost with the program (BUS-19).
        for line in &self.lines {
            line.call(|bus, now| bus.save_all(now)).await?;
        }
        Ok(())
    }

    async fn keep(&mut self, name: String) -> Result<SnapshotView, ApiError> {
        if self.snapshots.len() >= SNAPSHOTS_MAX && !self.snapshots.contains_key(&name) {
            return Err(ApiError::state(format!("{SNAPSHOTS_MAX} snapshots are kept already; delete one")));
        }
        let (at, rate) = self.hold().await?;
        let mut buses = Vec::new();
        for line in &self.lines {
            buses.push(line.call(|bus, now| bus.snapshot(now)).await?);
        }
        self.let_go(rate).await?;
        let kept = Kept { buses, last_fault: self.last_fault, at };
        let view = kept.view(&name);
        self.snapshots.insert(name, kept);
        Ok(view)
    }

    async fn restore(&mut self, name: &str) -> Result<ClockView, ApiError> {
        let kept = self.snapshots.get(name).cloned().ok_or_else(|| self.no_snapshot(name))?;
        self.bring_back(kept, Journals::Keep).await
    }

    async fn reset(&mut self) -> Result<ClockView, ApiError> {
        self.bring_back(self.start.clone(), Journals::Empty).await
    }

    async fn bring_back(&mut self, kept: Kept, journals: Journals) -> Result<ClockView, ApiError> {
        let mut rate = 0.0;
        for (line, snapshot) in self.lines.iter().zip(kept.buses) {
            let restored = line.call(move |bus, now| {
                bus.restore(now, &snapshot);
                if journals == Journals::Empty {
                    bus.forget();
                }
                bus.rate()
            });
            rate = restored.await?;
        }
        self.last_fault = kept.last_fault;
        self.let_go(rate).await
    }

    async fn add_fault(&mut self, bus: usize, fault: Fault, has_seed: bool) -> Result<u64, ApiError> {
        let line = &self.lines[bus];
        let id = self.last_fault + 1;
        let seed = if has_seed { fault.seed } else { id };
        let added = line.call(move |bus, now| {
            let has_room = bus.faults().list().len() < FAULTS_MAX;
            if has_room {
                bus.add_fault(now, Fault { id, seed, ..fault });
            }
            has_room
        });
        if !added.await? {
            return Err(ApiError::state(format!("there are {FAULTS_MAX} faults on this bus already; delete some")));
        }
        self.last_fault = id;
        Ok(id)
    }

    async fn watch(&mut self, is_watched: bool) -> Result<(), ApiError> {
        if self.is_watching != is_watched {
            for line in &self.lines {
                line.call(move |bus, _| bus.watch(is_watched)).await?;
            }
            self.is_watching = is_watched;
        }
        Ok(())
    }
}

/// What happens to journals when something is brought back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Journals {
    Keep,
    Empty,
}
