//! `standin`: a stand-in for field devices, a Modbus RTU slave simulator whose devices behave as their manuals say.
//!
//! From the bottom up: [`wire`] turns bytes into requests; [`map`], [`image`] and [`device`] are the vocabulary in which
//! [`devices`] are written; [`station`] is one slave, [`bus`] many of them on a line.

pub mod bus;
pub mod cli;
pub mod config;
pub mod ctl;
pub mod device;
pub mod devices;
pub mod export;
pub mod faults;
pub mod http;
pub mod image;
pub mod io;
pub mod journal;
pub mod line;
pub mod map;
pub mod options;
pub mod station;
pub mod store;
pub mod time;
pub mod wire;
pub mod world;
