//! What the system offers for descriptors and has no safe wrapper: the one module with `unsafe`.
//!
//! Every function takes a descriptor that is owned or borrowed, so it is open for as long as it is used, and passes
//! each ioctl the type that the kernel's header gives it. What is passed is integers, of which any bytes are a value.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

use nix::libc;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// Speed, character format and modes of a terminal.
pub use nix::libc::termios2 as Settings;

mod ioctl {
    use nix::libc;

    nix::ioctl_read_bad!(get_settings, libc::TCGETS2, libc::termios2);
    nix::ioctl_write_ptr_bad!(set_settings, libc::TCSETS2, libc::termios2);
    nix::ioctl_read_bad!(get_exclusive, libc::TIOCGEXCL, libc::c_int);
    nix::ioctl_none_bad!(set_exclusive, libc::TIOCEXCL);
    nix::ioctl_none_bad!(set_shared, libc::TIOCNXCL);
    nix::ioctl_read_bad!(count_unread, libc::FIONREAD, libc::c_int);
}

/// Has the reactor of the running task watch a descriptor.
///
/// # Errors
/// The reactor does not take it.
pub fn watch(fd: OwnedFd, interest: Interest) -> io::Result<AsyncFd<OwnedFd>> {
    // SAFETY: an owned descriptor stays open and the same until it is dropped, and the result owns it.
    Ok(unsafe { AsyncFd::register_with_interest(fd, interest) }?)
}

/// The settings of a terminal.
///
/// # Errors
/// It is no terminal.
pub fn settings(tty: &impl AsFd) -> io::Result<Settings> {
    // SAFETY: see the module's comment.
    unsafe {
        let mut settings = std::mem::zeroed();
        ioctl::get_settings(tty.as_fd().as_raw_fd(), &mut settings)?;
        Ok(settings)
    }
}

/// Changes the settings of a terminal at once.
///
/// # Errors
/// It is no terminal.
pub fn set_settings(tty: &impl AsFd, settings: &Settings) -> io::Result<()> {
    // SAFETY: see the module's comment.
    unsafe { ioctl::set_settings(tty.as_fd().as_raw_fd(), settings) }?;
    Ok(())
}

/// Whether a terminal refuses to be opened again (TIOCEXCL).
///
/// # Errors
/// It is no terminal.
pub fn is_exclusive(tty: &impl AsFd) -> io::Result<bool> {
    let mut exclusive: libc::c_int = 0;
    // SAFETY: see the module's comment.
    unsafe { ioctl::get_exclusive(tty.as_fd().as_raw_fd(), &mut exclusive) }?;
    Ok(exclusive != 0)
}

/// Lets a terminal refuse to be opened again.
///
/// # Errors
/// It is no terminal.
pub fn set_exclusive(tty: &impl AsFd) -> io::Result<()> {
    // SAFETY: see the module's comment.
    unsafe { ioctl::set_exclusive(tty.as_fd().as_raw_fd()) }?;
    Ok(())
}

/// Lets a terminal be opened by all.
///
/// # Errors
/// It is no terminal.
pub fn set_shared(tty: &impl AsFd) -> io::Result<()> {
    // SAFETY: see the module's comment.
    unsafe { ioctl::set_shared(tty.as_fd().as_raw_fd()) }?;
    Ok(())
}

/// How many bytes a descriptor has to be read.
///
/// # Errors
/// The descriptor is of a kind that does not tell.
pub fn count_unread(fd: &impl AsFd) -> io::Result<usize> {
    let mut count: libc::c_int = 0;
    // SAFETY: see the module's comment.
    unsafe { ioctl::count_unread(fd.as_fd().as_raw_fd(), &mut count) }?;
    Ok(usize::try_from(count).unwrap_or(0))
}
