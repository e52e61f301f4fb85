//! EEPROM images on disk: one readable JSON file per device in the `state` folder, written whole or not at all (BUS-19),
//! and never replaced when it cannot be read (BUS-20).

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use serde::Deserialize;

use crate::station::{SAVED_VERSION, Saved, Setup};

/// The `state` folder, held by this program alone.
#[derive(Debug)]
pub struct Store {
    images: Images,
    /// The folder itself: locked, and synced when a name in it changes.
    lock: Flock<File>,
}

/// The images of a `state` folder, to be read: they are whole at any moment, also while a program writes them.
#[derive(Clone, Debug)]
pub struct Images {
    folder: PathBuf,
}

/// Why memory cannot be kept or read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder cannot be used.
    #[error("the state folder {} cannot be used: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Another program uses it.
    #[error(
        "the state folder {} is in use by another standin; end that one, or give this one a folder of its own",
        folder.display()
    )]
    Held {
        /// The folder.
        folder: PathBuf,
    },
    /// An image cannot be used; it is left as it is.
    #[error(
        "the memory image {} {problem}; {remedy}, or take it away with `standin memory reset {device} --state {}`",
        file.display(),
        file.parent().unwrap_or(Path::new(".")).display()
    )]
    Image {
        /// The file.
        file: PathBuf,
        /// The device that it belongs to.
        device: String,
        /// What is wrong with it.
        problem: String,
        /// What else would help.
        remedy: &'static str,
    },
    /// An image cannot be written.
    #[error("{} cannot be written: {source}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// There is no image of that device.
    #[error("the state folder {} has no image of {device}{}", folder.display(), known(names))]
    Unknown {
        /// The folder.
        folder: PathBuf,
        /// The device that was asked for.
        device: String,
        /// The devices that have images.
        names: Vec<String>,
    },
}

fn known(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!("; it has those of {}", names.join(", ")) }
}

/// The version of an image, which is read before the rest is believed.
#[derive(Deserialize)]
struct Versioned {
    version: u32,
}

/// The ending of an image's name, and of the file that it is written to first.
const ENDINGS: (&str, &str) = (".json", ".json.new");

impl Store {
    /// Opens the folder, which is made if missing, and holds it against other programs.
    ///
    /// # Errors
    /// It cannot be made, locked or written to.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let failed = |source: io::Error| StoreError::Folder { folder: folder.into(), source };
        fs::create_dir_all(folder).map_err(failed)?;
        let file = File::open(folder).map_err(failed)?;
        let lock = Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
            Errno::EWOULDBLOCK => StoreError::Held { folder: folder.into() },
            _ => failed(errno.into()),
        })?;
        // What an interrupted write has left is no image; a folder that takes no file is found out now, not at a write.
        for entry in fs::read_dir(folder).map_err(failed)?.flatten() {
            if entry.file_name().to_string_lossy().ends_with(ENDINGS.1) {
                fs::remove_file(entry.path()).map_err(failed)?;
            }
        }
        let probe = folder.join(format!("probe{}", ENDINGS.1));
        File::create(&probe).and_then(|_| fs::remove_file(&probe)).map_err(failed)?;
        Ok(Self { images: Images::at(folder), lock })
    }

    /// The images in it.
    pub fn images(&self) -> &Images {
        &self.images
    }

    /// Writes the image of a device: when this returns, it is on the disk, and at no moment is there half of one.
    ///
    /// # Errors
    /// It could not be written; the image that was there is still there.
    pub fn write(&self, device: &str, saved: &Saved) -> Result<(), StoreError> {
        let file = self.images.file(device);
        let new = self.images.folder.join(stem(device) + ENDINGS.1);
        self.write_through(&new, &file, saved).map_err(|source| {
            // The error that counts is the first; what stays behind is removed at the next start at the latest.
            let _ = fs::remove_file(&new);
            StoreError::Write { file, source }
        })
    }

    fn write_through(&self, new: &Path, file: &Path, saved: &Saved) -> io::Result<()> {
        let mut opened = File::create(new)?;
        opened.write_all(saved.text().as_bytes())?;
        opened.sync_all()?;
        fs::rename(new, file)?;
        self.lock.sync_all()
    }

    /// Takes the image of a device away, whatever is in it: with the next start the device is as from the factory.
    ///
    /// # Errors
    /// There is none, or it cannot be removed.
    pub fn reset(&self, device: &str) -> Result<(), StoreError> {
        let file = self.images.file(device);
        match fs::remove_file(&file).and_then(|()| self.lock.sync_all()) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(self.images.unknown(device)),
            Err(source) => Err(StoreError::Write { file, source }),
        }
    }
}

impl Images {
    /// The images of a folder, whether it exists or not.
    pub fn at(folder: &Path) -> Self {
        Self { folder: folder.into() }
    }

    /// The image of a device, if there is one, fit for the device that devices.toml describes now (BUS-20).
    ///
    /// # Errors
    /// The image cannot be read, is of a newer version, or belongs to a device of another model or unit.
    pub fn load(&self, setup: &Setup) -> Result<Option<Saved>, StoreError> {
        let Some(saved) = self.read(&setup.name)? else { return Ok(None) };
        let refuse = |problem: String| {
            let remedy = "change devices.toml back";
            Err(StoreError::Image { file: self.file(&setup.name), device: setup.name.clone(), problem, remedy })
        };
        if saved.model != setup.kind.name {
            return refuse(format!("is of a {}, and {} is a {} now", saved.model, setup.name, setup.kind.name));
        }
        if saved.configured_unit != setup.address.unit {
            let (was, is) = (saved.configured_unit, setup.address.unit);
            return refuse(format!("was made when devices.toml gave {} unit {was}; it is unit {is} now", setup.name));
        }
        Ok(Some(saved))
    }

    fn read(&self, device: &str) -> Result<Option<Saved>, StoreError> {
        let file = self.file(device);
        let refuse = |problem: String, remedy| {
            Err(StoreError::Image { file: file.clone(), device: device.into(), problem, remedy })
        };
        let bytes = match fs::read(&file) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return refuse(format!("cannot be read: {error}"), "make it readable"),
        };
        let restore = "bring it back from a copy";
        let version = match serde_json::from_slice::<Versioned>(&bytes) {
            Ok(Versioned { version }) => version,
            Err(error) => return refuse(format!("is cut or no image: {error}"), restore),
        };
        if version != SAVED_VERSION {
            let problem = format!("is of version {version}; this standin writes and reads version {SAVED_VERSION}");
            return refuse(problem, "use the standin that wrote it");
        }
        match serde_json::from_slice(&bytes) {
            Ok(saved) => Ok(Some(saved)),
            Err(error) => refuse(format!("is damaged: {error}"), restore),
        }
    }

    /// What is wrong with an image that could be read but that the device does not take.
    pub fn refused(&self, device: &str, problem: String) -> StoreError {
        let remedy = "mend it by hand, bring it back from a copy";
        StoreError::Image { file: self.file(device), device: device.into(), problem, remedy }
    }

    /// The devices that have images, sorted.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn list(&self) -> Result<Vec<String>, StoreError> {
        let failed = |source: io::Error| StoreError::Folder { folder: self.folder.clone(), source };
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            names.extend(name.to_str().and_then(|name| name.strip_suffix(ENDINGS.0)).and_then(device));
        }
        names.sort();
        Ok(names)
    }

    /// The image of a device, as it is.
    ///
    /// # Errors
    /// There is none, or it cannot be read.
    pub fn show(&self, device: &str) -> Result<Saved, StoreError> {
        self.read(device)?.map_or_else(|| Err(self.unknown(device)), Ok)
    }

    fn unknown(&self, device: &str) -> StoreError {
        let names = self.list().unwrap_or_default();
        StoreError::Unknown { folder: self.folder.clone(), device: device.into(), names }
    }

    /// Where the image of a device is.
    pub fn file(&self, device: &str) -> PathBuf {
        self.folder.join(stem(device) + ENDINGS.0)
    }
}

/// A device's name as a file's: what file systems do not take everywhere is written %41.
fn stem(device: &str) -> String {
    let mut stem = String::new();
    for (index, byte) in device.bytes().enumerate() {
        let is_plain = byte.is_ascii_alphanumeric() || b"_-".contains(&byte) || (byte == b'.' && index > 0);
        if is_plain {
            stem.push(char::from(byte));
        } else {
            stem += &format!("%{byte:02X}");
        }
    }
    stem
}

/// The device that a file is named after; `None` where no device would name it so.
fn device(name: &str) -> Option<String> {
    let mut bytes = Vec::new();
    let mut rest = name.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte == b'%' {
            let digits = rest.split_at_checked(2).and_then(|(digits, after)| {
                rest = after;
                std::str::from_utf8(digits).ok()
            });
            bytes.push(u8::from_str_radix(digits?, 16).ok()?);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok().filter(|device| stem(device) == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices_survive_the_file_system() {
        for name in ["yard", "Room 3.1", "../../etc/passwd", ".hidden", "ölüm", "%41", "a%", ""] {
            assert_eq!(device(&stem(name)).as_deref(), Some(name));
            assert!(!stem(name).contains('/'));
        }
        assert_eq!(stem("Heizung Süd/1"), "Heizung%20S%C3%BCd%2F1");
        assert_eq!((device("%4"), device("%41"), device("a b")), (None, None, None));
    }
}
