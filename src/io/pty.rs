//! A pty that serves as a serial port would (BUS-23).

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::task::{Context, Poll};

use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::libc;
use nix::poll::{PollFd, PollFlags, poll};
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::unistd::{read, write};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::clients::{Change, Clients};
use super::fd;
use super::link::Link;
use super::outbox::Outbox;
use super::port::{Ear, Port};
use crate::bus::{Bus, DoorId, DoorKind, LineCheck};
use crate::time::Instant;

/// More reads than it takes to empty what the kernel keeps of a client that is gone.
const LEFT_READS_MAX: usize = 8;

/// How long what a client has written may be on its way, in milliseconds.
const ON_ITS_WAY_MS: u8 = 2;

/// A pty and the link to it.
#[derive(Debug)]
pub struct Pty {
    /// Our side of it.
    master: AsyncFd<OwnedFd>,
    clients: Clients,
    door: DoorId,
    outbox: Outbox,
    /// A second descriptor of our side, only while the kernel takes no more: a wake-up for every byte that a client
    /// reads would double the work for a request.
    writable: Option<AsyncFd<OwnedFd>>,
    /// The last client is gone, and the requests that it left are being carried out.
    is_deserted: bool,
    /// Speed and stop bits that the bus was told last.
    seen: Option<(u32, u8)>,
    /// Whether the bus wants to know them.
    is_checked: bool,
    link: Link,
}

impl Pty {
    /// Makes a pty, its line settings those of the bus, and the link to it.
    ///
    /// # Errors
    /// The system has no pty left, or the link cannot be made: a program holds it, or something else has its name.
    pub fn open(link: &Path, bus: &mut Bus, now: Instant) -> io::Result<Self> {
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let node = PathBuf::from(ptsname_r(&master)?);
        let clients = Clients::watch(&node, bus.settings().line)?;
        let master = fd::watch(master.into(), Interest::READABLE)?;
        let link = Link::make(link, &node)?;
        Ok(Self {
            master,
            clients,
            door: bus.open_door(now, DoorKind::Virtual),
            outbox: Outbox::default(),
            writable: None,
            is_deserted: false,
            seen: None,
            is_checked: bus.settings().line_check != LineCheck::Off,
            link,
        })
    }

    /// Takes what a read has given. A client may have gone before or after it, and the next one may have come: so that
    /// is asked before anything is handed in.
    fn take(&mut self, read: nix::Result<usize>, ear: &mut Ear<'_>) -> io::Result<()> {
        match self.count(read)? {
            None => Ok(()),
            Some(count) if self.clients.look()? == Change::None => self.hand_in(count, ear),
            Some(count) => self.change_clients(count, ear),
        }
    }

    /// How much a read has given, `None` when that was nothing.
    fn count(&mut self, read: nix::Result<usize>) -> io::Result<Option<usize>> {
        match read {
            Ok(0) | Err(Errno::EIO) => {
                // Hung up, though our own descriptor should keep it from that: somebody has revoked it. The reactor never
                // forgets a hang-up and would wake us without end, so it is told of the pty anew.
                self.clients.hold()?;
                let master = self.master.get_ref().try_clone()?;
                self.master = fd::watch(master, Interest::READABLE)?;
                Ok(None)
            }
            Ok(count) => Ok(Some(count)),
            Err(Errno::EAGAIN | Errno::EINTR) => Ok(None),
            Err(errno) => Err(errno.into()),
        }
    }

    fn hand_in(&mut self, count: usize, ear: &mut Ear<'_>) -> io::Result<()> {
        self.tell_settings(ear)?;
        if !self.is_deserted {
            self.clients.spoke();
        }
        ear.bytes(self.door, count);
        Ok(())
    }

    fn tell_settings(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        if self.is_checked {
            let settings = fd::settings(self.master.get_ref())?;
            let seen = (settings.c_ospeed, if settings.c_cflag & libc::CSTOPB == 0 { 1 } else { 2 });
            if self.seen.replace(seen) != Some(seen) {
                ear.bus.line_seen(self.door, seen.0, seen.1);
            }
        }
        Ok(())
    }

    /// Clients have gone; `count` bytes have been read and not handed in. Whole requests that the last one has left are
    /// carried out, as on a line, and nothing else of it reaches the next (BUS-23).
    ///
    /// Its bytes are read before it is asked who has come: what is there when nobody has is all of the one that is gone.
    /// What is not asked any more, who comes and goes after that, is told at the next look.
    fn change_clients(&mut self, mut count: usize, ear: &mut Ear<'_>) -> io::Result<()> {
        ear.heard = true;
        for _ in 0..LEFT_READS_MAX {
            if self.clients.look()? == Change::Replaced {
                break;
            }
            if count == ear.buffer.len() {
                self.hand_in(std::mem::take(&mut count), ear)?;
            }
            let events = self.clients.events();
            let read = read(self.master.get_ref(), &mut ear.buffer[count..]);
            match self.count(read)? {
                Some(more) => count += more,
                None => {
                    self.clients.look()?;
                    if self.clients.events() == events {
                        break;
                    }
                }
            }
        }
        if matches!(self.clients.change(), Change::Gone | Change::Unsure) {
            self.clients.ask(self.master.get_ref().as_fd())?;
        }
        match self.clients.change() {
            Change::Gone => self.is_deserted = true,
            Change::Replaced => {
                count += self.read_on_its_way(&mut ear.buffer[count..])?;
                if self.clients.have_written()? {
                    self.forget_client(ear)?;
                    self.clients.settle()?;
                    return self.hand_in_mixed(count, ear);
                }
                self.is_deserted = true;
            }
            Change::None | Change::Unsure => {}
        }
        self.clients.settle()?;
        if count > 0 { self.hand_in(count, ear) } else { Ok(()) }
    }

    /// Reads what has been written and is on its way in the kernel for a moment: it tells whose the bytes before it are.
    fn read_on_its_way(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        poll(&mut [PollFd::new(self.master.get_ref().as_fd(), PollFlags::POLLIN)], ON_ITS_WAY_MS)?;
        let read = if buffer.is_empty() { Err(Errno::EAGAIN) } else { read(self.master.get_ref(), buffer) };
        Ok(self.count(read)?.unwrap_or(0))
    }

    /// Hands in what is there when one client has gone and another has come and written: nobody tells whose it is.
    fn hand_in_mixed(&mut self, count: usize, ear: &mut Ear<'_>) -> io::Result<()> {
        if count > 0 {
            self.tell_settings(ear)?;
            self.clients.spoke();
            ear.mixed_bytes(self.door, count);
        }
        Ok(())
    }

    /// Drops what the last client has left (BUS-23).
    fn forget_client(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        ear.bus.client_closed(self.door);
        self.outbox.clear();
        self.writable = None;
        self.is_deserted = false;
        self.clients.drop_unread()
    }

    fn poll_send(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        while !self.outbox.is_empty() {
            let writable = match &self.writable {
                Some(writable) => writable,
                None => {
                    let master = self.master.get_ref().try_clone()?;
                    self.writable.insert(fd::watch(master, Interest::WRITABLE)?)
                }
            };
            let Poll::Ready(guard) = writable.poll_write_ready(cx) else { return Ok(()) };
            let mut guard = guard?;
            self.outbox.flush(|bytes| Ok(write(self.master.get_ref(), bytes)?))?;
            guard.clear_ready();
        }
        self.writable = None;
        Ok(())
    }
}

impl Port for Pty {
    fn poll_receive(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) -> io::Result<()> {
        if self.is_deserted {
            self.forget_client(ear)?;
        }
        if self.clients.poll(cx)? != Change::None {
            return self.change_clients(0, ear);
        }
        self.poll_send(cx)?;
        while !ear.heard && ear.bus.has_room(self.door) {
            let Poll::Ready(guard) = self.master.poll_read_ready(cx) else { break };
            let mut guard = guard?;
            let count = read(guard.get_inner(), ear.buffer);
            if count != Ok(ear.buffer.len()) {
                // A read that leaves room has emptied the pty, so that no second one need be tried.
                guard.clear_ready();
            }
            self.take(count, ear)?;
        }
        Ok(())
    }

    fn look(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        if !self.is_deserted && ear.bus.has_room(self.door) {
            let count = read(self.master.get_ref(), ear.buffer);
            self.take(count, ear)?;
        }
        Ok(())
    }

    fn has_door(&self, door: DoorId) -> bool {
        self.door == door
    }

    fn transmit(&mut self, _: DoorId, _: Option<u16>, bytes: &[u8]) -> io::Result<()> {
        // Whoever asked may have gone since, and the next one must not find this reply (BUS-23).
        if self.clients.look()? == Change::Gone {
            self.clients.ask(self.master.get_ref().as_fd())?;
        }
        let has_gone = matches!(self.clients.change(), Change::Gone | Change::Replaced);
        if self.is_deserted || has_gone || !self.clients.are_there() {
            return Ok(());
        }
        self.outbox.send(bytes, |bytes| Ok(write(self.master.get_ref(), bytes)?))
    }

    fn is_sending(&self) -> bool {
        !self.outbox.is_empty() || self.clients.have_unread()
    }

    fn close(&mut self, bus: &mut Bus) {
        bus.close_door(self.door);
    }

    fn path(&self) -> String {
        self.link.path().display().to_string()
    }
}
