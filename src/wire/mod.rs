//! The Modbus RTU wire: bytes to [`Request`] and back. Knows no device, no register and no I/O.

mod crc;
mod framer;
mod pdu;

pub use crc::{append_crc, crc16};
pub use framer::{FRAME_MAX, Frame, Framer};
pub use pdu::{Exception, Request, function, function_name};
