//! The link by which clients find a pty. It appears where the configuration says, never in the place of anything else,
//! and is gone when the program is.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{MetadataExt, symlink};
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};

/// A link that this program has made and holds.
#[derive(Debug)]
pub struct Link {
    path: PathBuf,
    target: PathBuf,
    /// An abstract socket named after the link: it belongs to one program at a time and ends with it, however it ends.
    _hold: UnixListener,
}

impl Link {
    /// Makes a link to the node of a pty, and its folder where that is missing. The link of a run that ended without
    /// removing it is replaced.
    ///
    /// # Errors
    /// A running program holds the link, something else has its name, or the folder does not take it.
    pub fn make(path: &Path, node: &Path) -> io::Result<Self> {
        let name = path.file_name().ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "the path names no link"))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(|error| annotate(&error, "its folder cannot be made"))?;
        let hold = hold(folder, name)?;
        if let Ok(found) = fs::symlink_metadata(path) {
            let is_ours = found.is_symlink() && fs::read_link(path).is_ok_and(|target| is_left_over(&target));
            if !is_ours {
                let what = if found.is_symlink() { "a link of another program" } else { "something that is no link" };
                let text = format!("{what} has this name; remove it, or name another path");
                return Err(io::Error::new(ErrorKind::AlreadyExists, text));
            }
            fs::remove_file(path).map_err(|error| annotate(&error, "the link of an earlier run stays"))?;
        }
        let target = marked(node);
        symlink(&target, path).map_err(|error| annotate(&error, "the link cannot be made"))?;
        Ok(Self { path: path.into(), target, _hold: hold })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        if fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn annotate(error: &io::Error, text: &str) -> io::Error {
    io::Error::new(error.kind(), format!("{text}: {error}"))
}

/// Takes the socket that stands for a link. The folder's device and inode name it, because a folder has many paths.
fn hold(folder: &Path, name: &OsStr) -> io::Result<UnixListener> {
    let folder = fs::metadata(folder)?;
    let mut socket = format!("standin-{:x}-{:x}-", folder.dev(), folder.ino()).into_bytes();
    match name.len() {
        0..=40 => socket.extend_from_slice(name.as_bytes()),
        _ => socket.extend_from_slice(format!("{:016x}", fnv_1a(name.as_bytes())).as_bytes()),
    }
    let address = SocketAddr::from_abstract_name(socket)?;
    UnixListener::bind_addr(&address).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => {
            io::Error::new(ErrorKind::AddrInUse, "a running program holds this link; end it, or name another path")
        }
        _ => error,
    })
}

/// The name that a link of ours gives a pty: `/dev/pts/./3` is `/dev/pts/3`, and no other program writes it so. A pty's
/// number is soon taken by another program, so a link that a killed run has left cannot be told by where it leads.
fn marked(node: &Path) -> PathBuf {
    let (folder, number) = (node.parent().unwrap_or(Path::new("/dev/pts")), node.file_name().unwrap_or_default());
    let mut target = folder.join(".").into_os_string();
    target.push("/");
    target.push(number);
    target.into()
}

/// Whether the target of a link that nobody holds is one of an earlier run: marked, or a pty that does not exist.
fn is_left_over(target: &Path) -> bool {
    let Some(number) = target.file_name() else { return false };
    let node = Path::new("/dev/pts").join(number);
    // Paths compare by their parts, and the mark is none.
    target == node && (target.as_os_str() == marked(&node).as_os_str() || !node.exists())
}

/// A hash that is the same in every build: two versions of the program agree on who holds a link.
fn fnv_1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bus_23_only_links_of_earlier_runs_are_left_over() {
        assert!(is_left_over(Path::new("/dev/pts/./0")));
        assert!(is_left_over(Path::new("/dev/pts/987654")));
        assert!(is_left_over(&marked(Path::new("/dev/pts/3"))));
        for other in ["/dev/pts/ptmx", "/dev/null", "/etc/passwd", "/dev/pts", "../line", "/nowhere", "/"] {
            assert!(!is_left_over(Path::new(other)), "{other}");
        }
    }
}
