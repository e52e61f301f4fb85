//! Real time: the elapsed time that buses live by, and the alarm that wakes their tasks.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::task::{Context, Poll};
use std::time::Duration;

use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::fd;
use crate::time::Instant;

/// Elapsed time since the program started.
#[derive(Clone, Copy, Debug)]
pub struct RealClock {
    started: std::time::Instant,
}

impl RealClock {
    /// A clock that reads 0 now.
    pub fn start() -> Self {
        Self { started: std::time::Instant::now() }
    }

    /// What it reads now.
    pub fn now(&self) -> Instant {
        Instant(self.started.elapsed().as_micros() as u64)
    }
}

/// Wakes a task at a moment, to some microseconds: tokio's own timer rounds up to whole milliseconds, which is half a
/// frame at 115200 baud (BUS-17).
#[derive(Debug)]
pub struct Alarm {
    timer: TimerFd,
    /// A second descriptor of the timer, which the reactor watches.
    bell: AsyncFd<OwnedFd>,
    set_for: Option<Instant>,
}

impl Alarm {
    /// An alarm that is not set.
    ///
    /// # Errors
    /// The system has no timer left.
    pub fn new() -> io::Result<Self> {
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, TimerFlags::TFD_CLOEXEC | TimerFlags::TFD_NONBLOCK)?;
        let bell = fd::watch(timer.as_fd().try_clone_to_owned()?, Interest::READABLE)?;
        Ok(Self { timer, bell, set_for: None })
    }

    /// Ready when `at` has come, or earlier: an alarm that is set for too early a moment is left to ring in vain, which
    /// costs less than setting it anew with every request.
    ///
    /// # Errors
    /// The system refuses the timer.
    pub fn poll_ring(&mut self, cx: &mut Context<'_>, at: Option<Instant>, now: Instant) -> Poll<io::Result<()>> {
        if let Some(at) = at {
            if at <= now {
                return Poll::Ready(Ok(()));
            }
            if self.set_for.is_none_or(|set_for| at < set_for || set_for <= now) {
                let ahead = TimeSpec::from_duration(Duration::from_micros(at.since_us(now)));
                self.timer.set(Expiration::OneShot(ahead), TimerSetTimeFlags::empty())?;
                self.set_for = Some(at);
            }
        }
        self.bell.poll_read_ready(cx).map(|guard| {
            guard?.clear_ready();
            self.set_for = None;
            Ok(())
        })
    }
}
