//! devices.toml: read, judged as a whole, and turned into a [`Config`] that can be run. All errors of a file are
//! reported together, each with line and column, what is wrong and what would be right.
//!
//! Knows the models only through their tables. Starts nothing, and opens no port.

mod bus;
mod device;
mod plan;
mod reader;

use std::collections::HashMap;
use std::fmt;
use std::io::Read;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use chrono::{Datelike, NaiveDateTime};
use toml::de::{DeTable, DeValue};

use crate::bus::Settings;
use crate::image::Layout;
use crate::station::Setup;
use crate::time::{SimClock, into_century};
use reader::{Entry, Found, Problems, Table, number, shown};

/// The example configuration: all models on one pty bus, commented. It runs where no devices.toml is.
pub const EXAMPLE: &str = include_str!("../../devices.toml");

/// The name of the file that is read where none is named.
pub const DEFAULT_FILE: &str = "devices.toml";

/// Most bytes that a devices.toml may have; what is larger is something else.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// A configuration that has passed every check.
#[derive(Clone, Debug)]
pub struct Config {
    /// Folder of the EEPROM images; `None`: memory lasts as long as the program (BUS-19).
    pub state: Option<PathBuf>,
    /// Where the simulated clock starts.
    pub start: Start,
    /// Simulated seconds a real second, 0 to 86400.
    pub rate: f64,
    /// The control interface; `None`: there is none.
    pub control: Option<Control>,
    /// The buses, at least one, in the order of the file.
    pub buses: Vec<BusConfig>,
    /// What is allowed and perhaps not meant, each with its place.
    pub warnings: Vec<String>,
}

/// Where the simulated clock starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// At the host's local time.
    Host,
    /// At this local time, in 2000 to 2099.
    At(NaiveDateTime),
}

impl Start {
    /// The time to start at, where the host's clock shows `host`.
    pub fn or_host(self, host: NaiveDateTime) -> NaiveDateTime {
        match self {
            Start::Host => into_century(host),
            Start::At(time) => time,
        }
    }
}

/// The control interface (CTL-1).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// Where it listens: loopback only, unless there is a token.
    pub listen: SocketAddr,
    /// What every request must show; never empty.
    pub token: Option<String>,
    /// Host names, in lower case, that requests may use beside the address and localhost.
    pub hosts: Vec<String>,
}

/// One bus and the devices on it.
#[derive(Clone, Debug)]
pub struct BusConfig {
    /// Its name, unique in the file.
    pub name: String,
    /// The doors to it, at least one.
    pub ports: Vec<Port>,
    /// The most clients that each of its TCP ports serves at once.
    pub max_clients: usize,
    /// Line, timing and what a client at the wrong speed gets.
    pub settings: Settings,
    /// The devices, in the order of the file.
    pub devices: Vec<Setup>,
}

/// A door to a bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// A pty with this link to it.
    Pty(PathBuf),
    /// A serial port.
    Serial(PathBuf),
    /// RTU frames over a TCP port.
    Tcp(SocketAddr),
    /// Modbus TCP.
    ModbusTcp(SocketAddr),
}

impl fmt::Display for Port {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Port::Pty(path) => write!(out, "pty:{}", path.display()),
            Port::Serial(path) => write!(out, "serial:{}", path.display()),
            Port::Tcp(addr) => write!(out, "tcp:{addr}"),
            Port::ModbusTcp(addr) => write!(out, "modbus-tcp:{addr}"),
        }
    }
}

/// What the command line says in place of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overrides {
    /// `--state`.
    pub state: Option<PathBuf>,
    /// `--start`.
    pub start: Option<Start>,
    /// `--rate`.
    pub rate: Option<f64>,
    /// `--listen`.
    pub listen: Option<SocketAddr>,
}

/// Everything that is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub struct ConfigError {
    /// The file, as it was named.
    pub file: String,
    /// What is wrong, in the order of the file; never empty.
    pub problems: Vec<Problem>,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line and column from 1, columns in characters; `None` where the file as a whole or the command line is meant.
    pub place: Option<(usize, usize)>,
    /// What is wrong and what would be right.
    pub message: String,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            let separator = if index == 0 { "" } else { "\n" };
            match problem.place {
                Some((line, column)) => {
                    write!(out, "{separator}{}:{line}:{column}: {}", self.file, problem.message)?;
                }
                None => write!(out, "{separator}{}: {}", self.file, problem.message)?,
            }
        }
        Ok(())
    }
}

impl Config {
    /// Reads and judges a file. Start values are judged at the configured start of the clock, or at `host`, the host's
    /// local time.
    ///
    /// # Errors
    /// All that is wrong with it.
    pub fn read(path: &Path, overrides: &Overrides, host: NaiveDateTime) -> Result<Self, ConfigError> {
        let file = path.display().to_string();
        let whole =
            |message: String| ConfigError { file: file.clone(), problems: vec![Problem { place: None, message }] };
        let mut bytes = Vec::new();
        std::fs::File::open(path).and_then(|opened| opened.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes)).map_err(
            |error| {
                let is_missing = error.kind() == std::io::ErrorKind::NotFound;
                let remedy = if is_missing { "; `standin init` prints an example" } else { "" };
                whole(format!("cannot be read: {error}{remedy}"))
            },
        )?;
        if bytes.len() as u64 > FILE_BYTES_MAX {
            return Err(whole(format!("is larger than {FILE_BYTES_MAX} bytes: no devices.toml")));
        }
        Self::parse(&file, &bytes, overrides, host)
    }

    /// Judges the bytes of a file that is called `file`.
    ///
    /// # Errors
    /// All that is wrong with them.
    pub fn parse(file: &str, bytes: &[u8], overrides: &Overrides, host: NaiveDateTime) -> Result<Self, ConfigError> {
        let error = |problems: Vec<Problem>| ConfigError { file: file.into(), problems };
        let text = std::str::from_utf8(bytes).map_err(|not_utf8| {
            let (good, _) = bytes.split_at(not_utf8.valid_up_to());
            let line_start = good.iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
            let line = good.iter().filter(|byte| **byte == b'\n').count() + 1;
            let column = String::from_utf8_lossy(&good[line_start..]).chars().count() + 1;
            let message = "not UTF-8 text, which TOML files are".into();
            error(vec![Problem { place: Some((line, column)), message }])
        })?;
        let (document, broken) = DeTable::parse_recoverable(text);
        let mut problems = Problems::new(text);
        for broken in &broken {
            let span = broken.span().unwrap_or(text.len()..text.len());
            let given = text.get(span.clone()).unwrap_or("");
            if is_bare_word(broken.message(), given) {
                // The parser goes on with a value that nobody wrote.
                problems.error(span.start, format!("not TOML: {UNQUOTED}, such as \"{given}\""));
                problems.settle(span.start);
                continue;
            }
            let message = match broken.message() {
                DUPLICATE_KEY => format!("key {given} stands here a second time"),
                message => format!("not TOML: {message}"),
            };
            problems.error(span.start, message);
        }
        let is_clear = broken.iter().all(|broken| leaves_the_rest_clear(broken.message()));
        let config = is_clear.then(|| read_document(document.get_ref(), overrides, host, &mut problems));
        let (errors, warnings) = problems.into_parts();
        let mut problems: Vec<Problem> =
            errors.into_iter().map(|(place, message)| Problem { place: Some(place), message }).collect();
        let Some(mut config) = config else { return Err(error(problems)) };
        if let Err(message) = judge_control(config.control.as_ref(), overrides) {
            problems.push(Problem { place: None, message });
        }
        if !problems.is_empty() {
            return Err(error(problems));
        }
        let said = |((line, column), message): &Found| format!("{file}:{line}:{column}: {message}");
        config.warnings = warnings.iter().map(said).collect();
        Ok(config)
    }

    /// The simulated clock at the start of the program, where the host's clock shows `host`.
    pub fn clock(&self, host: NaiveDateTime) -> SimClock {
        SimClock::new(self.start.or_host(host), self.rate)
    }
}

/// The parser's words for a key that a table has already.
const DUPLICATE_KEY: &str = "duplicate key";

/// The parser's words for text without quotes.
const UNQUOTED: &str = "string values must be quoted";

/// The parser's words for text without quotes that begins as `true`, `false`, `inf` or `nan` do.
const WORDS: [&str; 2] = ["invalid boolean", "invalid float"];

/// Whether a value is text without quotes that the parser takes for another word: `none` for `nan`, `fast` for `false`.
fn is_bare_word(message: &str, given: &str) -> bool {
    let words = ["true", "false", "inf", "nan"];
    WORDS.iter().any(|word| message.starts_with(word))
        && given.starts_with(|first: char| first.is_ascii_alphabetic())
        && !words.iter().any(|word| given.eq_ignore_ascii_case(word))
}

/// What a document with broken lines means is a guess, which would only add wrong errors to right ones. These faults
/// leave no doubt, so the rest of the file is judged too.
fn leaves_the_rest_clear(message: &str) -> bool {
    message == DUPLICATE_KEY || message.starts_with(UNQUOTED) || WORDS.iter().any(|word| message.starts_with(word))
}

/// What is unique in a file, with the place of the first, and what is made once for all devices of a model.
#[derive(Debug, Default)]
struct Seen {
    buses: HashMap<String, usize>,
    devices: HashMap<String, usize>,
    doors: HashMap<String, usize>,
    layouts: HashMap<&'static str, Arc<Layout>>,
}

fn read_document(entries: &DeTable, overrides: &Overrides, host: NaiveDateTime, problems: &mut Problems) -> Config {
    let mut root = Table::new("the file", 0, entries);
    let mut seen = Seen::default();
    let state = root.get("state").and_then(|entry| path(entry, problems));
    let clock = root.table("clock", problems);
    let (start, rate) = clock.map_or((Start::Host, 1.0), |clock| read_clock(clock, problems));
    let control = root.table("control", problems).and_then(|table| read_control(table, overrides, &mut seen, problems));
    let (start, rate) = (overrides.start.unwrap_or(start), overrides.rate.unwrap_or(rate));
    let clock = SimClock::new(start.or_host(host), rate);
    let before = problems.errors_so_far();
    let tables = root.tables("bus", "[[bus]]", problems);
    if tables.is_empty() && problems.errors_so_far() == before {
        let parts = "a bus needs name, port and its [[bus.device]]s";
        problems.error(0, format!("there is no [[bus]]: {parts}; `standin init` prints an example"));
    }
    let buses = tables.into_iter().filter_map(|table| bus::read(table, &clock, &mut seen, problems)).collect();
    root.finish(problems);
    let control = control.or_else(|| overrides.listen.map(|listen| Control { listen, token: None, hosts: Vec::new() }));
    Config { state: overrides.state.clone().or(state), start, rate, control, buses, warnings: Vec::new() }
}

fn read_clock(mut table: Table, problems: &mut Problems) -> (Start, f64) {
    let start = table.get("start").and_then(|entry| {
        let start = match entry.value {
            DeValue::String(text) => parse_start(text).ok(),
            DeValue::Datetime(time) => parse_start(&time.to_string()).ok(),
            _ => None,
        };
        start.or_else(|| entry.refuse(START_ALLOWED, problems))
    });
    let rate = table.get("rate").and_then(|entry| {
        let rate = number(entry.value).filter(|rate| (0.0..=SimClock::RATE_MAX).contains(rate));
        rate.or_else(|| entry.refuse("a number, 0 to 86400", problems))
    });
    table.finish(problems);
    (start.unwrap_or(Start::Host), rate.unwrap_or(1.0))
}

const START_ALLOWED: &str = "\"host\" or a local date-time of 2000 to 2099 such as \"2014-10-27T14:22:08\"";

/// A start of the clock from text: `host`, or a local date and time.
///
/// # Errors
/// What is allowed, where it is neither.
pub fn parse_start(text: &str) -> Result<Start, String> {
    if text == "host" {
        return Ok(Start::Host);
    }
    let forms = ["%Y-%m-%dT%H:%M:%S%.f", "%Y-%m-%d %H:%M:%S%.f", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M"];
    let time = forms.into_iter().find_map(|form| NaiveDateTime::parse_from_str(text, form).ok());
    let time = time.filter(|time| (2000..=2099).contains(&time.year()));
    time.map(Start::At).ok_or_else(|| format!("the clock starts at {START_ALLOWED}, not {text:?}"))
}

/// A rate of the clock from text.
///
/// # Errors
/// What is allowed, where it is not.
pub fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| (0.0..=SimClock::RATE_MAX).contains(rate));
    rate.ok_or_else(|| format!("the rate is a number, 0 to 86400, not {text:?}"))
}

/// An address and port from text; `localhost` stands for 127.0.0.1.
///
/// # Errors
/// What is allowed, where it is neither.
pub fn parse_address(text: &str) -> Result<SocketAddr, String> {
    let numeric = text.strip_prefix("localhost:").map(|port| format!("127.0.0.1:{port}"));
    let address = numeric.as_deref().unwrap_or(text).parse();
    address.map_err(|_| format!("an address is written like 127.0.0.1:8502, not {text:?}"))
}

fn read_control(mut table: Table, overrides: &Overrides, seen: &mut Seen, problems: &mut Problems) -> Option<Control> {
    let allowed = "an address such as \"127.0.0.1:8502\"";
    let listen_entry = match overrides.listen {
        Some(_) => table.get("listen"),
        None => table.need("listen", "\"127.0.0.1:8502\"", problems),
    };
    let listen = listen_entry.and_then(|entry| {
        let text = entry.text(allowed, problems)?;
        let listen = parse_address(text).ok().or_else(|| entry.refuse(allowed, problems))?;
        unique("address", &listen.to_string(), entry.at, &mut seen.doors, problems).then_some(listen)
    });
    let token_before = problems.errors_so_far();
    let written = table.get("token");
    let from_file = table.get("token_file");
    if let (Some(_), Some(entry)) = (written, from_file) {
        problems.error(entry.key_at, "token and token_file exclude each other");
    }
    let written = written.and_then(|entry| {
        let text = entry.text(TOKEN_ALLOWED, problems)?;
        is_token(text).then(|| text.to_owned()).or_else(|| entry.refuse(TOKEN_ALLOWED, problems))
    });
    let token = written.or_else(|| from_file.and_then(|entry| read_token(entry, problems)));
    let hosts = table.get("hosts").map_or(Vec::new(), |entry| read_hosts(entry, problems));
    let token_is_judged = problems.errors_so_far() == token_before;
    if let (Some(entry), Some(listen), None) = (listen_entry, listen, &token)
        && overrides.listen.is_none()
        && token_is_judged
        && !listen.ip().is_loopback()
    {
        problems.error(entry.at, needs_token(listen));
    }
    table.finish(problems);
    Some(Control { listen: overrides.listen.or(listen)?, token, hosts })
}

fn needs_token(listen: SocketAddr) -> String {
    format!(
        "listen takes a loopback address such as 127.0.0.1:{} unless [control] has a token or token_file, not {listen}",
        listen.port()
    )
}

/// An address from the command line needs the token as much as one in the file (CTL-1).
fn judge_control(control: Option<&Control>, overrides: &Overrides) -> Result<(), String> {
    match (control, overrides.listen) {
        (Some(control), Some(listen)) if control.token.is_none() && !listen.ip().is_loopback() => {
            Err(format!("--{}", needs_token(listen)))
        }
        _ => Ok(()),
    }
}

const TOKEN_ALLOWED: &str = "visible ASCII characters without blanks, at least one";

fn is_token(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_graphic())
}

fn read_token(entry: Entry, problems: &mut Problems) -> Option<String> {
    let path = path(entry, problems)?;
    let mut text = String::new();
    let read = std::fs::File::open(&path).and_then(|file| file.take(4096).read_to_string(&mut text));
    if let Err(error) = read {
        problems.error(entry.at, format!("token_file {} cannot be read: {error}", path.display()));
        return None;
    }
    if !is_token(text.trim()) {
        problems.error(entry.at, format!("token_file {} must hold {TOKEN_ALLOWED}", path.display()));
        return None;
    }
    Some(text.trim().to_owned())
}

fn read_hosts(entry: Entry, problems: &mut Problems) -> Vec<String> {
    let allowed = "a list of host names such as [\"bench.example\"]";
    let DeValue::Array(items) = entry.value else {
        problems.error(entry.at, entry.refusal(allowed));
        return Vec::new();
    };
    let mut hosts = Vec::new();
    for item in items.iter() {
        let name = item.get_ref().as_str();
        let is_host = |name: &&str| {
            let letters = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
            !name.is_empty() && name.len() <= 253 && name.chars().all(letters)
        };
        match name.filter(is_host) {
            Some(name) => hosts.push(name.to_ascii_lowercase()),
            None => problems.error(item.span().start, format!("hosts takes host names, not {}", shown(item.get_ref()))),
        }
    }
    hosts
}

/// The path that an entry holds.
fn path(entry: Entry, problems: &mut Problems) -> Option<PathBuf> {
    let text = entry.text("a path", problems)?;
    if !is_path(text) {
        return entry.refuse("a path", problems);
    }
    Some(PathBuf::from(text))
}

fn is_path(text: &str) -> bool {
    !text.is_empty() && !text.contains('\0')
}

/// Longest name of a bus or device: file names and addresses of the control interface are made of it.
const NAME_CHARS_MAX: usize = 64;

const NAME_ALLOWED: &str = "a name of letters, digits, - _ and . (1 to 64, not . first)";

/// The name that an entry holds; where it is not the first of its kind, that is an error, but it still is the name.
fn name(
    entry: Entry,
    what: &str,
    names: fn(&mut Seen) -> &mut HashMap<String, usize>,
    seen: &mut Seen,
    problems: &mut Problems,
) -> Option<String> {
    let text = entry.text(NAME_ALLOWED, problems)?;
    let letters = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    if text.is_empty() || text.starts_with('.') || text.chars().count() > NAME_CHARS_MAX || !text.chars().all(letters) {
        return entry.refuse(NAME_ALLOWED, problems);
    }
    unique(what, text, entry.at, names(seen), problems);
    Some(text.to_owned())
}

/// Notes the place of something that must be unique, and says whether it is.
fn unique(what: &str, key: &str, at: usize, seen: &mut HashMap<String, usize>, problems: &mut Problems) -> bool {
    let Some(first) = seen.get(key).copied() else {
        seen.insert(key.to_owned(), at);
        return true;
    };
    let line = problems.line(first);
    problems.error(at, format!("{what} {key} stands in line {line} too: give each its own"));
    false
}
