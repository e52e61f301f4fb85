//! A real serial port.

use std::io;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_serial::{ClearBuffer, DataBits, FlowControl, SerialPort, SerialStream, StopBits};

use super::outbox::Outbox;
use super::port::{Ear, Port};
use crate::bus::{Bus, DoorId, DoorKind};
use crate::line::{Line, Parity};
use crate::time::Instant;

/// A serial port that is open.
#[derive(Debug)]
pub struct Serial {
    stream: SerialStream,
    path: PathBuf,
    door: DoorId,
    outbox: Outbox,
}

impl Serial {
    /// Opens a serial port with the bus' line settings, for this program alone.
    ///
    /// # Errors
    /// It cannot be opened, or does not take the settings.
    pub fn open(path: &Path, bus: &mut Bus, now: Instant) -> io::Result<Self> {
        let line = bus.settings().line;
        let parity = match line.parity {
            Parity::None => tokio_serial::Parity::None,
            Parity::Even => tokio_serial::Parity::Even,
            Parity::Odd => tokio_serial::Parity::Odd,
        };
        let stop_bits = if line.stop_bits == 2 { StopBits::Two } else { StopBits::One };
        let name = path.to_str().ok_or_else(|| io::Error::other("the path is not UTF-8"))?;
        let builder = tokio_serial::new(name, line.baud)
            .data_bits(DataBits::Eight)
            .parity(parity)
            .stop_bits(stop_bits)
            .flow_control(FlowControl::None);
        let stream = SerialStream::open(&builder)?;
        let taken = (stream.baud_rate()?, stream.parity()?, stream.stop_bits()?, stream.data_bits()?);
        if !is_close(taken.0, line) || (taken.1, taken.2, taken.3) != (parity, stop_bits, DataBits::Eight) {
            let (baud, parity, stop_bits, data_bits) = taken;
            let text = format!(
                "the port does not take {line}: it is at {baud} baud, parity {parity}, data bits {data_bits}, stop bits {stop_bits}"
            );
            return Err(io::Error::other(text));
        }
        stream.clear(ClearBuffer::Input)?;
        Ok(Self { stream, path: path.into(), door: bus.open_door(now, DoorKind::Wire), outbox: Outbox::default() })
    }
}

/// Whether a speed is so close that receivers follow it: adapters divide a clock and come to a nearby one.
fn is_close(baud: u32, line: Line) -> bool {
    baud.abs_diff(line.baud) <= line.baud / 50
}

impl Port for Serial {
    fn poll_receive(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) -> io::Result<()> {
        let Self { stream, outbox, .. } = self;
        if !outbox.is_empty() {
            outbox.flush(|bytes| match Pin::new(&mut *stream).poll_write(cx, bytes) {
                Poll::Ready(written) => written,
                Poll::Pending => Err(io::ErrorKind::WouldBlock.into()),
            })?;
        }
        if !ear.bus.has_room(self.door) {
            return Ok(());
        }
        let mut buffer = ReadBuf::new(ear.buffer);
        match Pin::new(stream).poll_read(cx, &mut buffer)? {
            Poll::Pending => Ok(()),
            Poll::Ready(()) => match buffer.filled().len() {
                0 => Err(gone()),
                count => {
                    ear.bytes(self.door, count);
                    Ok(())
                }
            },
        }
    }

    fn look(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        match self.stream.try_read(ear.buffer) {
            Ok(0) => Err(gone()),
            Ok(count) => {
                ear.bytes(self.door, count);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn has_door(&self, door: DoorId) -> bool {
        self.door == door
    }

    fn transmit(&mut self, _: DoorId, _: Option<u16>, bytes: &[u8]) -> io::Result<()> {
        self.outbox.send(bytes, |bytes| self.stream.try_write(bytes))
    }

    fn is_sending(&self) -> bool {
        !self.outbox.is_empty() || self.stream.bytes_to_write().is_ok_and(|count| count > 0)
    }

    fn close(&mut self, bus: &mut Bus) {
        bus.close_door(self.door);
    }

    fn path(&self) -> String {
        self.path.display().to_string()
    }
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::NotConnected, "the device is gone")
}
