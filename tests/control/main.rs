//! The control interface of the built program, over HTTP, with a Modbus client beside it (`control.md`).
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod access;
mod clock;
mod ctl;
mod devices;
mod events;
mod faults;
mod journal;
mod program;
mod snapshots;
