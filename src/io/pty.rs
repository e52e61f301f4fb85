//! A pty that serves as a serial port would (BUS-23). The program keeps a descriptor of the client's side open, so that
//! clients come and go without the kernel telling us of a hang-up each time; an inotify watch tells of them instead.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::task::{Context, Poll};

use nix::errno::Errno;
use nix::fcntl::{OFlag, open};
use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::stat::Mode;
use nix::sys::termios::{FlushArg, tcflush};
use nix::unistd::{read, write};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::fd;
use super::link::Link;
use super::outbox::Outbox;
use super::port::{Ear, Port};
use crate::bus::{Bus, DoorId, DoorKind, LineCheck};
use crate::line::Line;
use crate::time::Instant;

/// More reads than it takes to empty what the kernel keeps of a client that is gone.
const DESERTED_READS_MAX: usize = 8;

/// A pty and the link to it.
#[derive(Debug)]
pub struct Pty {
    /// Our side of it.
    master: AsyncFd<OwnedFd>,
    /// The client's side: its node, and our descriptor of it. It is only read, so that of all that close the node ours
    /// alone does not count as a client.
    node: PathBuf,
    kept: Option<OwnedFd>,
    /// Tells of clients that open and close it; and a second descriptor of that, which the reactor watches.
    clients: Inotify,
    bell: AsyncFd<OwnedFd>,
    door: DoorId,
    outbox: Outbox,
    /// A second descriptor of our side, only while the kernel takes no more: a wake-up for every byte that a client
    /// reads would double the work for a request.
    writable: Option<AsyncFd<OwnedFd>>,
    /// Whether somebody is there to hear what is sent.
    has_client: bool,
    /// The last client is gone, and the requests that it left are being carried out.
    is_deserted: bool,
    /// The watch will tell of our own opening of the node.
    is_own_open_due: bool,
    /// Speed and stop bits that the bus was told last; `None` where it does not ask.
    seen: Option<(u32, u8)>,
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
        let kept = open_client_side(&node)?;
        lay(&kept, bus.settings().line)?;
        let clients = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).map_err(|errno| {
            let remedy = "raise fs.inotify.max_user_instances";
            if errno == Errno::EMFILE { io::Error::other(format!("{errno}: {remedy}")) } else { errno.into() }
        })?;
        clients.add_watch(&node, AddWatchFlags::IN_OPEN | AddWatchFlags::IN_CLOSE_WRITE)?;
        let link = Link::make(link, &node)?;
        Ok(Self {
            master: fd::watch(master.into(), Interest::READABLE)?,
            node,
            kept: Some(kept),
            bell: fd::watch(clients.as_fd().try_clone_to_owned()?, Interest::READABLE)?,
            clients,
            door: bus.open_door(now, DoorKind::Virtual),
            outbox: Outbox::default(),
            writable: None,
            has_client: false,
            is_deserted: false,
            is_own_open_due: false,
            seen: None,
            is_checked: bus.settings().line_check != LineCheck::Off,
            link,
        })
    }

    /// Hears of clients that have come and gone.
    fn poll_clients(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) -> io::Result<()> {
        let (mut is_closed, mut is_reopened) = (false, false);
        while let Poll::Ready(guard) = self.bell.poll_read_ready(cx) {
            let mut guard = guard?;
            match self.clients.read_events() {
                Ok(events) => {
                    for event in events {
                        let is_open = event.mask.contains(AddWatchFlags::IN_OPEN);
                        if is_open && !std::mem::take(&mut self.is_own_open_due) {
                            self.has_client = true;
                            is_reopened |= is_closed;
                        }
                        is_closed |= event.mask.contains(AddWatchFlags::IN_CLOSE_WRITE);
                    }
                }
                Err(Errno::EAGAIN) => guard.clear_ready(),
                Err(errno) => return Err(errno.into()),
            }
        }
        if !is_closed {
            return Ok(());
        }
        if self.is_alone()? {
            self.has_client = false;
            self.is_deserted = true;
            ear.heard = true;
        } else if is_reopened {
            self.forget_client(ear)?;
        }
        self.welcome()
    }

    /// Whether no client has the pty open: without our own descriptor it is hung up then.
    ///
    /// The events cannot be counted instead, because the kernel merges two that are alike.
    fn is_alone(&mut self) -> io::Result<bool> {
        let was_exclusive = match self.kept.take() {
            // What a client has made exclusive could not be opened again (TIOCEXCL); a killed client leaves it so.
            Some(kept) => {
                let was_exclusive = fd::is_exclusive(&kept)?;
                fd::set_shared(&kept)?;
                was_exclusive
            }
            None => false,
        };
        let mut events = [PollFd::new(self.master.get_ref().as_fd(), PollFlags::POLLIN)];
        poll(&mut events, PollTimeout::ZERO)?;
        let is_alone = events[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP));
        match open_client_side(&self.node) {
            Ok(kept) => {
                if was_exclusive && !is_alone {
                    fd::set_exclusive(&kept)?;
                }
                self.kept = Some(kept);
                self.is_own_open_due = true;
            }
            // Another client has made it exclusive just now: it is tried again when that one closes.
            Err(error) if error.raw_os_error() == Some(libc::EBUSY) && !is_alone => {}
            Err(error) => return Err(error),
        }
        Ok(is_alone)
    }

    /// Drops what the last client has left (BUS-23).
    fn forget_client(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        ear.bus.client_closed(self.door);
        self.outbox.clear();
        self.writable = None;
        self.is_deserted = false;
        if let Some(kept) = &self.kept {
            tcflush(kept, FlushArg::TCIFLUSH)?;
        }
        Ok(())
    }

    /// Makes sure that the next client's tcsetattr changes something. The C library reports EINVAL when parity alone
    /// was asked for, because the kernel keeps no parity for ptys; CLOCAL, which nearly all clients set, means nothing
    /// to a pty.
    fn welcome(&self) -> io::Result<()> {
        let Some(kept) = &self.kept else { return Ok(()) };
        let mut settings = fd::settings(kept)?;
        settings.c_cflag &= !libc::CLOCAL;
        fd::set_settings(kept, &settings)
    }

    /// Hands in what a read has given; `false` when that was nothing.
    fn take(&mut self, count: nix::Result<usize>, ear: &mut Ear<'_>) -> io::Result<bool> {
        let count = match count {
            Ok(0) | Err(Errno::EIO) => {
                // Hung up, though our descriptor should keep it from that: somebody has revoked it. The reactor never
                // forgets a hang-up and would wake us without end, so it is told of the pty anew.
                self.kept = Some(open_client_side(&self.node)?);
                self.is_own_open_due = true;
                let master = self.master.get_ref().try_clone()?;
                self.master = fd::watch(master, Interest::READABLE)?;
                return Ok(false);
            }
            Ok(count) => count,
            Err(Errno::EAGAIN | Errno::EINTR) => return Ok(false),
            Err(errno) => return Err(errno.into()),
        };
        if self.is_checked {
            let settings = fd::settings(self.master.get_ref())?;
            let seen = (settings.c_ospeed, if settings.c_cflag & libc::CSTOPB == 0 { 1 } else { 2 });
            if self.seen.replace(seen) != Some(seen) {
                ear.bus.line_seen(self.door, seen.0, seen.1);
            }
        }
        self.has_client |= !self.is_deserted;
        ear.bytes(self.door, count);
        Ok(true)
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
        self.poll_clients(cx, ear)?;
        if self.is_deserted {
            for _ in 0..DESERTED_READS_MAX {
                let count = read(self.master.get_ref(), ear.buffer);
                if !self.take(count, ear)? {
                    break;
                }
            }
            return Ok(());
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
        if !self.has_client {
            return Ok(());
        }
        self.outbox.send(bytes, |bytes| Ok(write(self.master.get_ref(), bytes)?))
    }

    fn is_sending(&self) -> bool {
        let is_unread = |kept: &OwnedFd| fd::count_unread(kept).is_ok_and(|count| count > 0);
        !self.outbox.is_empty() || self.kept.as_ref().is_some_and(is_unread)
    }

    fn close(&mut self, bus: &mut Bus) {
        bus.close_door(self.door);
    }

    fn path(&self) -> String {
        self.link.path().display().to_string()
    }
}

fn open_client_side(node: &Path) -> io::Result<OwnedFd> {
    let flags = OFlag::O_RDONLY | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
    Ok(open(node, flags, Mode::empty())?)
}

/// Raw, and at the bus' speed, for clients that set nothing.
fn lay(tty: &OwnedFd, line: Line) -> io::Result<()> {
    let mut settings = fd::settings(tty)?;
    (settings.c_iflag, settings.c_oflag, settings.c_lflag) = (0, 0, 0);
    settings.c_cflag = libc::CS8 | libc::CREAD | speed_flag(line.baud);
    if line.stop_bits == 2 {
        settings.c_cflag |= libc::CSTOPB;
    }
    (settings.c_ispeed, settings.c_ospeed) = (line.baud, line.baud);
    (settings.c_cc[libc::VMIN], settings.c_cc[libc::VTIME]) = (1, 0);
    fd::set_settings(tty, &settings)
}

/// The flag of a speed; those that have none are told by number.
fn speed_flag(baud: u32) -> libc::tcflag_t {
    match baud {
        1200 => libc::B1200,
        2400 => libc::B2400,
        4800 => libc::B4800,
        9600 => libc::B9600,
        19_200 => libc::B19200,
        38_400 => libc::B38400,
        57_600 => libc::B57600,
        115_200 => libc::B115200,
        230_400 => libc::B230400,
        _ => libc::BOTHER,
    }
}
