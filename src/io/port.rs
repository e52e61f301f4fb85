//! What ports have in common: they hand what comes in to the bus, send what it answers, and come back when they fail.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::Sleep;
use tracing::{info, warn};

use super::pty::Pty;
use super::serial::Serial;
use super::tcp::Tcp;
use crate::bus::{Bus, DoorId};
use crate::config;
use crate::time::Instant;

/// A way into a bus. It never waits: what it cannot do now it does when its task polls it again.
pub trait Port: Send {
    /// Hands to the bus what has come in, and asks for a wake-up when more does.
    ///
    /// # Errors
    /// The port is of no use any more.
    fn poll_receive(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) -> io::Result<()>;

    /// Hands to the bus what has come in, whether or not the reactor has heard of it: asked before silence is believed.
    ///
    /// # Errors
    /// The port is of no use any more.
    fn look(&mut self, ear: &mut Ear<'_>) -> io::Result<()>;

    /// Whether this door is one of the port's.
    fn has_door(&self, door: DoorId) -> bool;

    /// Sends a reply.
    ///
    /// # Errors
    /// The port is of no use any more.
    fn transmit(&mut self, door: DoorId, transaction: Option<u16>, bytes: &[u8]) -> io::Result<()>;

    /// Whether a client has yet to take what was sent.
    fn is_sending(&self) -> bool;

    /// Takes its doors from the bus.
    fn close(&mut self, bus: &mut Bus);

    /// What a client opens.
    fn path(&self) -> String;
}

/// Where ports hand in what they hear.
pub struct Ear<'a> {
    /// The bus.
    pub bus: &'a mut Bus,
    /// Room for what is read.
    pub buffer: &'a mut [u8],
    /// The time that what is heard counts from: never later than a silence that the bus still waits for.
    pub at: Instant,
    /// The time.
    pub now: Instant,
    /// Whether something was handed in, so that the bus has to be asked what follows.
    pub heard: bool,
}

impl Ear<'_> {
    /// Hands in the first `count` bytes of the buffer.
    pub fn bytes(&mut self, door: DoorId, count: usize) {
        self.bus.receive(self.at, door, &self.buffer[..count]);
        self.bus.heard_until(self.now, door);
        self.heard = true;
    }

    /// Hands in the first `count` bytes of the buffer, which may begin with what a client before has half sent (BUS-23).
    pub fn mixed_bytes(&mut self, door: DoorId, count: usize) {
        self.bus.receive_mixed(self.at, door, &self.buffer[..count]);
        self.bus.heard_until(self.now, door);
        self.heard = true;
    }
}

/// A port that the configuration names, whether it works at the moment or not.
pub struct Slot {
    plan: config::Port,
    max_clients: usize,
    state: State,
}

enum State {
    Open(Box<dyn Port>),
    Down { retry: Pin<Box<Sleep>>, pause: Duration },
}

/// The first and the longest pause before a port that failed is tried again.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

impl Slot {
    /// Opens a port, where it is a TCP port for so many clients at once.
    ///
    /// # Errors
    /// Why it cannot be opened.
    pub fn open(plan: config::Port, max_clients: usize, bus: &mut Bus, now: Instant) -> io::Result<Self> {
        let port = open(&plan, max_clients, bus, now)?;
        Ok(Self { plan, max_clients, state: State::Open(port) })
    }

    /// What a client opens.
    pub fn path(&self) -> Option<String> {
        self.port().map(|port| port.path())
    }

    /// The port, while it works.
    pub fn port(&self) -> Option<&dyn Port> {
        match &self.state {
            State::Open(port) => Some(port.as_ref()),
            State::Down { .. } => None,
        }
    }

    /// Lets the port do something. A port that fails is closed and tried again later; the bus goes on.
    pub fn with(&mut self, ear: &mut Ear<'_>, act: impl FnOnce(&mut dyn Port, &mut Ear<'_>) -> io::Result<()>) {
        let State::Open(port) = &mut self.state else { return };
        let Err(error) = act(port.as_mut(), ear) else { return };
        let (pause, _) = PAUSES;
        warn!("{} failed: {error}; it is tried again every {} s at most", self.plan, PAUSES.1.as_secs());
        port.close(ear.bus);
        ear.heard = true;
        self.state = State::Down { retry: Box::pin(tokio::time::sleep(pause)), pause };
    }

    /// Hands to the bus what has come in, or opens the port again when it is time.
    pub fn poll(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) {
        while let State::Down { retry, pause } = &mut self.state {
            if retry.as_mut().poll(cx) == Poll::Pending {
                return;
            }
            match open(&self.plan, self.max_clients, ear.bus, ear.now) {
                Ok(port) => {
                    info!("{} is back", self.plan);
                    self.state = State::Open(port);
                }
                Err(error) => {
                    *pause = (*pause * 2).min(PAUSES.1);
                    tracing::debug!("{} is still down: {error}", self.plan);
                    *retry = Box::pin(tokio::time::sleep(*pause));
                }
            }
        }
        self.with(ear, |port, ear| port.poll_receive(cx, ear));
    }
}

fn open(plan: &config::Port, max_clients: usize, bus: &mut Bus, now: Instant) -> io::Result<Box<dyn Port>> {
    Ok(match plan {
        config::Port::Pty(link) => Box::new(Pty::open(link, bus, now)?),
        config::Port::Serial(path) => Box::new(Serial::open(path, bus, now)?),
        config::Port::Tcp(addr) => Box::new(Tcp::open_rtu(*addr, max_clients)?),
        config::Port::ModbusTcp(addr) => Box::new(Tcp::open_modbus(*addr, max_clients)?),
    })
}
