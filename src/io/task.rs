//! The task of one bus: it owns the bus and its ports, and is all that ever touches them.

use std::future::poll_fn;
use std::io;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tracing::warn;

use super::clock::{Alarm, RealClock};
use super::port::{Ear, Port, Slot};
use crate::bus::{Bus, DoorId, Output};
use crate::config;
use crate::station::Saved;
use crate::store::Store;
use crate::time::Instant;

/// Something that is done to a bus by its own task.
pub type Command = Box<dyn FnOnce(&mut Bus, Instant) + Send>;

/// What sees every [`Output::Exchange`] and [`Output::Event`] of a bus.
pub type Watcher = Box<dyn FnMut(&Bus, &Output) + Send>;

/// Bytes that are read at once.
const READ_MAX: usize = 4096;

/// Commands that wait for a bus; whoever sends more waits too.
const COMMANDS_MAX: usize = 64;

/// How long the end of the program waits for replies that are under way, and for clients to take them.
const FAREWELL: (Duration, Duration) = (Duration::from_secs(2), Duration::from_millis(200));

/// What a bus' task is told.
enum Message {
    Command(Command),
    Stop,
}

/// A bus that runs, for those who want something of it.
#[derive(Clone, Debug)]
pub struct BusHandle {
    /// Its name.
    pub name: String,
    /// Its ports as devices.toml names them, and what a client opens.
    pub ports: Vec<(config::Port, String)>,
    sender: mpsc::Sender<Message>,
}

impl BusHandle {
    /// Lets the bus' task do something, and waits for what comes of it; `None` when the bus has ended.
    pub async fn call<R: Send + 'static>(
        &self,
        act: impl FnOnce(&mut Bus, Instant) -> R + Send + 'static,
    ) -> Option<R> {
        let (sender, result) = oneshot::channel();
        let command: Command = Box::new(move |bus, now| {
            // Whoever asked may have gone.
            let _ = sender.send(act(bus, now));
        });
        self.sender.send(Message::Command(command)).await.ok()?;
        result.await.ok()
    }

    /// Tells the bus to finish what it is answering, keep its memory and end.
    pub(super) async fn stop(&self) {
        // A bus that has ended needs no telling.
        let _ = self.sender.send(Message::Stop).await;
    }
}

/// A bus, its ports and its memory.
pub(super) struct BusTask {
    bus: Bus,
    slots: Vec<Slot>,
    store: Option<Arc<Store>>,
    clock: RealClock,
    alarm: Alarm,
    messages: mpsc::Receiver<Message>,
    watchers: Vec<Watcher>,
    buffer: Box<[u8]>,
}

/// Why a bus' task goes on.
enum Wake {
    /// Something came in, or it is time for something.
    Line(Instant),
    Message(Message),
}

impl BusTask {
    /// Opens the ports of a bus.
    ///
    /// # Errors
    /// Which port cannot be opened and why.
    pub(super) fn new(
        mut bus: Bus,
        plan: &config::BusConfig,
        store: Option<Arc<Store>>,
        clock: RealClock,
        watchers: Vec<Watcher>,
    ) -> Result<(Self, BusHandle), (Option<config::Port>, io::Error)> {
        let mut slots = Vec::new();
        let mut paths = Vec::new();
        for port in &plan.ports {
            let slot = Slot::open(port.clone(), plan.max_clients, &mut bus, clock.now())
                .map_err(|error| (Some(port.clone()), error))?;
            paths.push((port.clone(), slot.path().unwrap_or_default()));
            slots.push(slot);
        }
        let (sender, messages) = mpsc::channel(COMMANDS_MAX);
        let handle = BusHandle { name: bus.name().into(), ports: paths, sender };
        let alarm = Alarm::new().map_err(|error| (None, error))?;
        let buffer = vec![0; READ_MAX].into();
        let task = Self { bus, slots, store, clock, alarm, messages, watchers, buffer };
        Ok((task, handle))
    }

    /// Serves the bus until it is told to stop.
    pub(super) async fn run(mut self) -> io::Result<()> {
        loop {
            let message = match poll_fn(|cx| self.poll_wake(cx)).await? {
                Wake::Line(now) => {
                    self.drain(now).await;
                    // A line that is never silent must not keep commands waiting.
                    self.messages.try_recv().ok()
                }
                Wake::Message(message) => Some(message),
            };
            match message {
                Some(Message::Command(command)) => {
                    let now = self.clock.now();
                    command(&mut self.bus, now);
                    self.drain(now).await;
                    // Commands may come without a gap, as the steps of an advance do: what has come in by the ports in
                    // between is only seen when the runtime has its turn.
                    tokio::task::yield_now().await;
                }
                Some(Message::Stop) => break,
                None => {}
            }
        }
        self.finish().await
    }

    /// Bytes come before the timer, so that no delay of this program is mistaken for silence on the line.
    fn poll_wake(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<Wake>> {
        let now = self.clock.now();
        let wake_at = self.bus.wake_at();
        let at = wake_at.map_or(now, |at| at.min(now));
        let Self { bus, buffer, slots, .. } = self;
        let mut ear = Ear { bus, buffer, at, now, heard: false };
        let mut heard = false;
        for slot in slots.iter_mut() {
            slot.poll(cx, &mut ear);
            heard |= std::mem::take(&mut ear.heard);
        }
        let is_due = wake_at.is_some_and(|at| at <= now);
        if is_due {
            for slot in slots.iter_mut() {
                slot.with(&mut ear, |port, ear| port.look(ear));
            }
        }
        if heard || is_due {
            return Poll::Ready(Ok(Wake::Line(now)));
        }
        if let Poll::Ready(message) = self.messages.poll_recv(cx) {
            return Poll::Ready(Ok(Wake::Message(message.unwrap_or(Message::Stop))));
        }
        self.alarm.poll_ring(cx, wake_at, now).map_ok(|()| Wake::Line(self.clock.now()))
    }

    /// Does what the bus wants done now: first what is to be kept, then what is to be sent.
    async fn drain(&mut self, now: Instant) {
        while let Some(output) = self.bus.poll(now) {
            match output {
                Output::Transmit { door, transaction, bytes } => self.transmit(door, transaction, &bytes),
                Output::Persist { station, saved } => self.keep(station, saved).await,
                Output::Exchange(_) | Output::Event(_) => {
                    for watcher in &mut self.watchers {
                        watcher(&self.bus, &output);
                    }
                }
                Output::Note(note) => warn!("{}: {note}", self.bus.name()),
            }
        }
    }

    fn transmit(&mut self, door: DoorId, transaction: Option<u16>, bytes: &[u8]) {
        let owner = self.slots.iter_mut().find(|slot| slot.port().is_some_and(|port| port.has_door(door)));
        let Some(slot) = owner else { return };
        let now = self.clock.now();
        let mut ear = Ear { bus: &mut self.bus, buffer: &mut self.buffer, at: now, now, heard: false };
        slot.with(&mut ear, |port, _| port.transmit(door, transaction, bytes));
    }

    /// Writes an image. The disk is waited for, the other buses are not.
    async fn keep(&mut self, station: usize, saved: Saved) {
        let Some(store) = self.store.clone() else { return };
        let name = self.bus.stations()[station].name().to_owned();
        let kept = tokio::task::spawn_blocking(move || store.write(&name, &saved)).await;
        let failure = match kept {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        self.bus.keep_failed(station, &failure);
    }

    /// Lets every port that works do something.
    fn each_port(&mut self, now: Instant, mut act: impl FnMut(&mut dyn Port, &mut Ear<'_>) -> io::Result<()>) {
        let Self { bus, buffer, slots, .. } = self;
        let mut ear = Ear { bus, buffer, at: now, now, heard: false };
        for slot in slots {
            slot.with(&mut ear, &mut act);
        }
    }

    /// Ends: answers what is being answered, keeps the memory, and gives clients a moment to take the last replies.
    async fn finish(mut self) -> io::Result<()> {
        let (patience, farewell) = FAREWELL;
        let end = self.clock.now().plus_us(patience.as_micros() as u64);
        loop {
            let now = self.clock.now();
            self.each_port(now, |port, ear| port.look(ear));
            self.drain(now).await;
            let due = self.bus.wake_at().filter(|due| self.bus.is_answering() && *due <= end);
            let Some(due) = due else { break };
            tokio::time::sleep(Duration::from_micros(due.since_us(self.clock.now()))).await;
        }
        let now = self.clock.now();
        self.bus.save_all(now);
        self.drain(now).await;
        let end = now.plus_us(farewell.as_micros() as u64);
        loop {
            // Also lets the kernel carry over what was written last.
            tokio::time::sleep(Duration::from_millis(5)).await;
            let is_sending = self.slots.iter().any(|slot| slot.port().is_some_and(Port::is_sending));
            let now = self.clock.now();
            if !is_sending || now >= end {
                return Ok(());
            }
            poll_fn(|cx| {
                self.each_port(now, |port, ear| port.poll_receive(cx, ear));
                Poll::Ready(())
            })
            .await;
        }
    }
}
