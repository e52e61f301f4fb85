//! The program itself, started from a configuration in a folder of its own, and clients that know nothing of it.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{self, BaudRate, ControlFlags, SetArg};
use nix::unistd::Pid;
use standin::wire::append_crc;
use tempfile::TempDir;

/// How long a reply, a start or an end may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// How long a line has to be silent before a test believes it.
pub const SILENCE: Duration = Duration::from_millis(150);

/// The TRC manual's question for registers 5 and 6 of unit 4, and its answer (TRC-1).
pub const ASK: [u8; 6] = [4, 3, 0, 5, 0, 2];
pub const ANSWER: [u8; 7] = [4, 3, 4, 0x00, 0xBE, 0x00, 0xFA];

/// A TRC at unit 4; its bus comes before it.
pub const CHARGER: &str = "[[bus.device]]\nname = \"charger\"\nmodel = \"logiccon-trc\"\nunit = 4\n";

/// A bus with a pty and the TRC, and what else is said about the bus.
pub fn charger_on_pty(more: &str) -> String {
    format!("[[bus]]\nname = \"line1\"\nport = \"pty:{{dir}}/line1\"\n{more}\n{CHARGER}")
}

/// The program, running. It is killed when it goes out of scope.
pub struct Program {
    child: Child,
    /// Where its configuration and links are; `{dir}` in a configuration.
    pub folder: Arc<TempDir>,
    /// Its start report.
    pub report: serde_json::Value,
    log: Arc<Mutex<String>>,
}

/// How the program is started.
pub fn command(folder: &Path, config: &str, args: &[&str]) -> Command {
    let file = folder.join("devices.toml");
    let place = folder.to_str().unwrap();
    fs::write(&file, config.replace("{dir}", place)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_standin"));
    command.arg("run").arg(file).arg("--json").args(args.iter().map(|arg| arg.replace("{dir}", place)));
    command.env_remove("RUST_LOG").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

impl Program {
    /// Starts a configuration and waits until it is ready.
    #[track_caller]
    pub fn start(config: &str) -> Self {
        Self::start_with(config, &[])
    }

    /// Starts a configuration with options.
    #[track_caller]
    pub fn start_with(config: &str, args: &[&str]) -> Self {
        Self::start_in(Arc::new(tempfile::tempdir().unwrap()), config, args)
    }

    /// Starts a configuration in a folder that is there already.
    #[track_caller]
    pub fn start_in(folder: Arc<TempDir>, config: &str, args: &[&str]) -> Self {
        let mut child = command(folder.path(), config, args).spawn().unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        collect(child.stderr.take().unwrap(), log.clone());
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let report = serde_json::from_str(&line);
        let mut program = Self { child, folder, report: serde_json::Value::Null, log };
        match report {
            Ok(report) => program.report = report,
            Err(_) => panic!("it does not start: {:?}, {}", program.child.wait(), program.log()),
        }
        program
    }

    /// The link of its first bus.
    pub fn line(&self) -> PathBuf {
        self.folder.path().join("line1")
    }

    /// The address that a bus' port came to have.
    pub fn address(&self, bus: usize, port: usize) -> String {
        self.report["buses"][bus]["ports"][port]["path"].as_str().unwrap().to_owned()
    }

    pub fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id() as i32)
    }

    pub fn signal(&self, signal: Signal) {
        kill(self.pid(), signal).unwrap();
    }

    /// Ends it as an operator does, and gives how it ended.
    #[track_caller]
    pub fn end(&mut self) -> ExitStatus {
        self.signal(Signal::SIGTERM);
        self.ended()
    }

    /// Waits for its end.
    #[track_caller]
    pub fn ended(&mut self) -> ExitStatus {
        wait_for(&mut self.child)
    }

    /// What it has logged until now.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Waits until the log holds a text.
    #[track_caller]
    pub fn logs(&self, text: &str) {
        until(&format!("the log says {text:?}"), || self.log().contains(text));
    }

    /// Time that it has spent on a processor.
    pub fn cpu(&self) -> Duration {
        let stat = fs::read_to_string(format!("/proc/{}/schedstat", self.child.id())).unwrap();
        Duration::from_nanos(stat.split_whitespace().next().unwrap().parse().unwrap())
    }

    /// Memory that it holds, in KiB.
    pub fn resident_kib(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn collect(mut from: impl Read + Send + 'static, log: Arc<Mutex<String>>) {
    thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            *log.lock().unwrap() += &String::from_utf8_lossy(&buffer[..count]);
        }
    });
}

/// Starts a configuration that is refused: its exit status and what it says.
#[track_caller]
pub fn refused(folder: &Path, config: &str, args: &[&str]) -> (i32, String) {
    let mut child = command(folder, config, args).spawn().unwrap();
    let log = Arc::new(Mutex::new(String::new()));
    collect(child.stderr.take().unwrap(), log.clone());
    let status = wait_for(&mut child);
    thread::sleep(Duration::from_millis(20));
    let log = log.lock().unwrap().clone();
    (status.code().expect("an exit status"), log)
}

/// Waits for the end of a process; one that does not end is killed, and fails the test.
#[track_caller]
pub fn wait_for(child: &mut Child) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > PATIENCE {
            let _ = child.kill();
            panic!("the process does not end");
        }
        thread::sleep(Duration::from_millis(2));
    }
}

/// Waits until something holds.
#[track_caller]
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "it never comes that {what}");
        thread::sleep(Duration::from_millis(2));
    }
}

/// A frame: the bytes and their CRC.
pub fn framed(bytes: &[u8]) -> Vec<u8> {
    let mut frame = bytes.to_vec();
    append_crc(&mut frame);
    frame
}

/// A client that reads and writes bytes: a terminal or a connection that does not block.
pub struct Client<T> {
    pub port: T,
}

/// A client of a pty or a serial port.
pub fn open(path: &Path) -> Client<File> {
    let flags = libc::O_NOCTTY | libc::O_NONBLOCK;
    let port = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path);
    Client { port: port.unwrap_or_else(|error| panic!("{}: {error}", path.display())) }
}

/// A client of a TCP port.
pub fn connect(address: &str) -> Client<TcpStream> {
    let port = TcpStream::connect(address).unwrap();
    port.set_nonblocking(true).unwrap();
    port.set_nodelay(true).unwrap();
    Client { port }
}

impl Client<File> {
    /// Sets speed and stop bits, as a client library does.
    pub fn configure(&self, baud: BaudRate, stop_bits: u8) {
        let mut settings = termios::tcgetattr(&self.port).unwrap();
        termios::cfmakeraw(&mut settings);
        termios::cfsetspeed(&mut settings, baud).unwrap();
        settings.control_flags |= ControlFlags::CLOCAL | ControlFlags::CREAD;
        settings.control_flags.set(ControlFlags::CSTOPB, stop_bits == 2);
        termios::tcsetattr(&self.port, SetArg::TCSANOW, &settings).unwrap();
    }
}

impl<T: Read + Write + AsFd> Client<T> {
    /// Sends bytes, waiting for room as long as it takes.
    #[track_caller]
    pub fn send(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            match self.port.write(bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                    assert!(self.wait(PollFlags::POLLOUT, PATIENCE), "the port takes nothing");
                }
                Err(error) => panic!("the port takes nothing: {error}"),
            }
        }
    }

    fn wait(&self, what: PollFlags, within: Duration) -> bool {
        let mut polled = [PollFd::new(self.port.as_fd(), what)];
        let within = PollTimeout::try_from(within).unwrap();
        poll(&mut polled, within).unwrap() > 0
    }

    /// What comes in within a time; returns as soon as `count` bytes are there. Empty when the other side has closed.
    #[track_caller]
    pub fn receive(&mut self, count: usize, within: Duration) -> Vec<u8> {
        let end = Instant::now() + within;
        let mut bytes = vec![0; count];
        let mut filled = 0;
        while filled < count {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() || !self.wait(PollFlags::POLLIN, left) {
                break;
            }
            match self.port.read(&mut bytes[filled..]) {
                Ok(0) => break,
                Ok(more) => filled += more,
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(error) => panic!("the port gives nothing: {error}"),
            }
        }
        bytes.truncate(filled);
        bytes
    }

    /// A reply of so many bytes; `None` when the other side ends before it has come.
    pub fn reply_or_end(&mut self, count: usize) -> Option<Vec<u8>> {
        let end = Instant::now() + PATIENCE;
        let mut bytes = vec![0; count];
        let mut filled = 0;
        while filled < count && Instant::now() < end {
            self.wait(PollFlags::POLLIN, PATIENCE);
            match self.port.read(&mut bytes[filled..]) {
                Ok(0) => return None,
                Ok(more) => filled += more,
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(_) => return None,
            }
        }
        (filled == count).then_some(bytes)
    }

    /// Sends a request and expects this reply; both without CRC.
    #[track_caller]
    pub fn expect(&mut self, request: &[u8], reply: &[u8]) {
        self.send(&framed(request));
        self.expect_frame(reply);
    }

    /// Expects a reply, given without its CRC.
    #[track_caller]
    pub fn expect_frame(&mut self, reply: &[u8]) {
        let wanted = framed(reply);
        let got = self.receive(wanted.len(), PATIENCE);
        assert_eq!(hex(&got), hex(&wanted));
    }

    /// Expects the TRC to answer its manual's question.
    #[track_caller]
    pub fn expect_answer(&mut self) {
        self.expect(&ASK, &ANSWER);
    }

    /// Expects that nothing comes.
    #[track_caller]
    pub fn expect_silence(&mut self) {
        let got = self.receive(1, SILENCE);
        assert_eq!(hex(&got), "", "the line should be silent");
    }
}

/// Bytes for people.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X} ")).collect()
}
