//! The shell around the buses: ports, real time, files and signals. One task owns one [`Bus`](crate::bus::Bus) and
//! everything that leads to it, so nothing here is shared and nothing is locked. Knows no device.

mod clients;
mod clock;
mod fd;
mod link;
mod outbox;
mod port;
mod pty;
mod report;
mod run;
mod serial;
mod task;
mod tcp;
mod trace;

pub use run::{RunError, RunOptions, run};
pub use task::{BusHandle, Command, Watcher};
