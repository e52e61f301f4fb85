//! Who has a pty open. The kernel tells of clients that open and close its node (inotify); a descriptor of our own keeps
//! the last close from hanging the pty up.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{OFlag, open};
use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::stat::Mode;
use nix::sys::termios::{FlushArg, tcflush};
use nix::unistd::read;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::time::Sleep;

use super::fd;
use crate::line::Line;

/// How often it is asked whether somebody is there after all, each time after twice as long: for an eighth of a second.
const DOUBTS_MAX: u32 = 7;

/// An event of a watched file (inotify(7)): watch, mask, cookie, and the length of a name that only files in watched folders
/// have.
const EVENT_BYTES: usize = 16;

/// Events that are read at once.
const EVENTS_AT_ONCE: usize = 16;

/// What has become of the clients since that was last settled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Nothing that matters.
    None,
    /// The last one that is known of has gone.
    Gone,
    /// The last one has gone, and another has come.
    Replaced,
    /// It has to be asked whether anybody is there ([`Clients::ask`]), because events may have been merged.
    Unsure,
}

/// The clients of a pty.
#[derive(Debug)]
pub struct Clients {
    node: PathBuf,
    /// Our own descriptor of the client's side.
    kept: Option<OwnedFd>,
    watch: Inotify,
    /// A second descriptor of the watch, which the reactor watches.
    bell: AsyncFd<OwnedFd>,
    /// Who has written before and after the last close: only asked when clients have come and gone, because each request
    /// is a writing. `None` where there is none to spare.
    pen: Option<Pen>,
    /// How many there are, as far as is known: the kernel merges two events that are alike.
    count: u32,
    change: Change,
    /// How often one has come or gone.
    events: u64,
    /// The watch will tell of our own descriptor's closing, and of its opening.
    own_events: (bool, bool),
    /// When it is asked whether anybody is there, and how often that has been done.
    doubt: Option<(Pin<Box<Sleep>>, u32)>,
}

impl Clients {
    /// Watches the node of a pty, whose client's side is laid out for this line.
    ///
    /// # Errors
    /// The node cannot be opened or watched.
    pub fn watch(node: &Path, line: Line) -> io::Result<Self> {
        let kept = open_node(node)?;
        lay(&kept, line)?;
        let watch = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).map_err(|errno| {
            let remedy = "raise fs.inotify.max_user_instances";
            if errno == Errno::EMFILE { io::Error::other(format!("{errno}: {remedy}")) } else { errno.into() }
        })?;
        watch.add_watch(node, AddWatchFlags::IN_OPEN | AddWatchFlags::IN_CLOSE)?;
        let pen = Pen::watch(node);
        let bell = fd::watch(watch.as_fd().try_clone_to_owned()?, Interest::READABLE)?;
        let node = node.to_owned();
        let (change, own_events) = (Change::None, (false, false));
        Ok(Self { node, kept: Some(kept), watch, bell, pen, count: 0, change, events: 0, own_events, doubt: None })
    }

    /// Whether there is one.
    pub fn are_there(&self) -> bool {
        self.count > 0
    }

    /// One has sent something, so it is there.
    pub fn spoke(&mut self) {
        self.count = self.count.max(1);
    }

    /// Asks for a wake-up when clients come or go, and gives what has become of them.
    ///
    /// # Errors
    /// The watch fails.
    pub fn poll(&mut self, cx: &mut Context<'_>) -> io::Result<Change> {
        while let Poll::Ready(guard) = self.bell.poll_read_ready(cx) {
            guard?.clear_ready();
            self.look()?;
        }
        if let Some((sleep, _)) = &mut self.doubt
            && self.change == Change::None
            && sleep.as_mut().poll(cx).is_ready()
        {
            self.change = Change::Unsure;
        }
        Ok(self.change)
    }

    /// What has become of them until this moment.
    ///
    /// # Errors
    /// The watch fails.
    pub fn look(&mut self) -> io::Result<Change> {
        let mut events = [AddWatchFlags::empty(); EVENTS_AT_ONCE];
        loop {
            let count = read_events(&self.watch, &mut events)?;
            if count == 0 {
                return Ok(self.change);
            }
            for event in &events[..count] {
                self.take(*event);
            }
        }
    }

    /// What has become of them until the last look.
    pub fn change(&self) -> Change {
        self.change
    }

    /// How often one had come or gone until the last look.
    pub fn events(&self) -> u64 {
        self.events
    }

    /// Whether something was written behind the last close, as far as is known: so by a client that is there. What one
    /// that is gone has written is told before its close, for certain.
    ///
    /// # Errors
    /// The watch fails.
    pub fn have_written(&mut self) -> io::Result<bool> {
        let Some(pen) = &self.pen else { return Ok(true) };
        let mut events = [AddWatchFlags::empty(); EVENTS_AT_ONCE];
        let (mut is_anything_written, mut is_last_a_writing) = (false, false);
        loop {
            let count = read_events(&pen.0, &mut events)?;
            if count == 0 {
                // Bytes that nobody has been told of yet cannot be of one that is gone.
                return Ok(is_last_a_writing || !is_anything_written);
            }
            for event in &events[..count] {
                is_last_a_writing = event.contains(AddWatchFlags::IN_MODIFY);
                is_anything_written |= is_last_a_writing;
            }
        }
    }

    fn take(&mut self, event: AddWatchFlags) {
        let (own_close, own_open) = &mut self.own_events;
        if event.contains(AddWatchFlags::IN_OPEN) {
            if std::mem::take(own_open) {
                return;
            }
            self.events += 1;
            self.count += 1;
            if self.change == Change::Gone {
                self.change = Change::Replaced;
            }
            return;
        }
        // Ours is the only one that is opened just to be read.
        if event.contains(AddWatchFlags::IN_CLOSE_NOWRITE) && std::mem::take(own_close) {
            return;
        }
        self.events += 1;
        self.count = self.count.saturating_sub(1);
        match self.count {
            0 => (self.change, self.doubt) = (Change::Gone, None),
            _ => self.doubt_after(0),
        }
    }

    fn doubt_after(&mut self, doubts: u32) {
        let pause = Duration::from_millis(1 << doubts);
        self.doubt = (doubts < DOUBTS_MAX).then(|| (Box::pin(tokio::time::sleep(pause)), doubts + 1));
    }

    /// Finds out whether anybody is there: without our own descriptor, a pty that nobody has open is hung up. Where the
    /// count says that nobody is, it may have missed one: the kernel merges two openings in one moment, a client's and
    /// ours among them.
    ///
    /// # Errors
    /// The node cannot be opened again.
    pub fn ask(&mut self, master: BorrowedFd<'_>) -> io::Result<Change> {
        // What is exclusive could not be opened again (TIOCEXCL).
        let mut was_exclusive = false;
        if let Some(kept) = self.kept.take() {
            was_exclusive = fd::is_exclusive(&kept)?;
            fd::set_shared(&kept)?;
            self.own_events.0 = true;
        }
        let mut events = [PollFd::new(master, PollFlags::POLLIN)];
        poll(&mut events, PollTimeout::ZERO)?;
        let is_alone = events[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP));
        if is_alone {
            (self.count, self.change, self.doubt) = (0, Change::Gone, None);
        }
        // Before our own opening, which the kernel would merge with a client's.
        self.look()?;
        match open_node(&self.node) {
            Ok(kept) => {
                if was_exclusive && !is_alone {
                    fd::set_exclusive(&kept)?;
                }
                self.kept = Some(kept);
                self.own_events.1 = true;
                // And before a client's comes right after it.
                self.look()?;
            }
            // A client has made it exclusive just now: it is tried again when that one closes.
            Err(error) if error.raw_os_error() == Some(libc::EBUSY) && !is_alone => {}
            Err(error) => return Err(error),
        }
        if !is_alone && matches!(self.change, Change::Gone | Change::Unsure) {
            self.count = self.count.max(1);
            self.change = Change::None;
            let doubts = self.doubt.take().map_or(0, |(_, doubts)| doubts);
            self.doubt_after(doubts);
        }
        Ok(self.change)
    }

    /// What has become of them is dealt with. The next client finds the pty as a serial port: not exclusive, though the
    /// last one may have been killed while it was (TIOCNXCL); and so that its tcsetattr changes something. The C library
    /// reports EINVAL when parity alone was asked for, because the kernel keeps none for ptys; CLOCAL, which nearly all
    /// clients set, means nothing to a pty.
    ///
    /// # Errors
    /// The pty fails.
    pub fn settle(&mut self) -> io::Result<()> {
        let change = std::mem::replace(&mut self.change, Change::None);
        // What was written until now is dealt with, too.
        self.have_written()?;
        if self.kept.is_none() {
            self.hold()?;
        }
        let Some(kept) = self.kept.as_ref().filter(|_| change != Change::None) else { return Ok(()) };
        if change == Change::Gone {
            fd::set_shared(kept)?;
        }
        let mut settings = fd::settings(kept)?;
        settings.c_cflag &= !libc::CLOCAL;
        fd::set_settings(kept, &settings)
    }

    /// Opens our own descriptor anew.
    ///
    /// # Errors
    /// The node cannot be opened.
    pub fn hold(&mut self) -> io::Result<()> {
        self.own_events.0 |= self.kept.is_some();
        self.kept = Some(open_node(&self.node)?);
        self.own_events.1 = true;
        Ok(())
    }

    /// Drops what is on its way to a client and has not been read.
    ///
    /// # Errors
    /// The pty fails.
    pub fn drop_unread(&self) -> io::Result<()> {
        let Some(kept) = &self.kept else { return Ok(()) };
        Ok(tcflush(kept, FlushArg::TCIFLUSH)?)
    }

    /// Whether a client has yet to read something.
    pub fn have_unread(&self) -> bool {
        self.kept.as_ref().is_some_and(|kept| fd::count_unread(kept).is_ok_and(|count| count > 0))
    }
}

/// A watch of what is written to a node.
#[derive(Debug)]
struct Pen(Inotify);

/// How many there are in this program.
static PENS: AtomicUsize = AtomicUsize::new(0);

/// The most of them: by default the system gives a user 128 watches, and each pty needs another.
const PENS_MAX: usize = 16;

impl Pen {
    /// `None` where there are enough already, or the system gives none.
    fn watch(node: &Path) -> Option<Self> {
        let spare = |count| (count < PENS_MAX).then_some(count + 1);
        PENS.fetch_update(Ordering::Relaxed, Ordering::Relaxed, spare).ok()?;
        let watch = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).and_then(|watch| {
            watch.add_watch(node, AddWatchFlags::IN_MODIFY | AddWatchFlags::IN_CLOSE_WRITE)?;
            Ok(watch)
        });
        if watch.is_err() {
            PENS.fetch_sub(1, Ordering::Relaxed);
        }
        watch.ok().map(Self)
    }
}

impl Drop for Pen {
    fn drop(&mut self) {
        PENS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Reads the next events of a watch, as many as fit, and gives how many. Not `Inotify::read_events`, which clears a
/// hundred kilobytes before each look, and there is one for each request.
fn read_events(watch: &Inotify, events: &mut [AddWatchFlags; EVENTS_AT_ONCE]) -> io::Result<usize> {
    let mut buffer = [0; EVENT_BYTES * EVENTS_AT_ONCE];
    let count = match read(watch.as_fd(), &mut buffer) {
        Ok(count) => count,
        Err(Errno::EAGAIN) => 0,
        Err(errno) => return Err(errno.into()),
    };
    for (event, bytes) in events.iter_mut().zip(buffer[..count].chunks_exact(EVENT_BYTES)) {
        let mask = [bytes[4], bytes[5], bytes[6], bytes[7]];
        *event = AddWatchFlags::from_bits_truncate(u32::from_ne_bytes(mask));
    }
    Ok(count / EVENT_BYTES)
}

fn open_node(node: &Path) -> io::Result<OwnedFd> {
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
