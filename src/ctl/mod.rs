//! `standin ctl`: the control interface from a shell. Knows the interface by its calls alone, and waits for each.

mod client;
mod show;

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use serde_json::{Map, Value, json};

use self::client::Client;

/// Where the interface is looked for when nothing else is said.
const DEFAULT_URL: &str = "http://127.0.0.1:8502";

/// What is asked of a running program.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  standin ctl clock advance 6h
  standin ctl get charger output_voltage
  standin ctl set charger ac_voltage=100
  standin ctl fault add line1 drop --device charger --count 2
  standin ctl journal --device charger

The exit status is 0 when it was done, 1 when it was refused or nobody answers, 2 for a bad command line.")]
pub struct CtlArgs {
    /// Where the control interface is.
    #[arg(long, value_name = "URL", env = "STANDIN_URL", default_value = DEFAULT_URL, global = true)]
    at: String,
    /// The file that holds the interface's token; the environment's STANDIN_TOKEN serves too.
    #[arg(long, value_name = "FILE", global = true)]
    token_file: Option<PathBuf>,
    /// Print the interface's own JSON, errors too.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show what runs, and what the buses have counted.
    Status,
    /// Show simulated time, or move it.
    Clock {
        /// What to do; without it, the clock is shown.
        #[command(subcommand)]
        command: Option<ClockCommand>,
    },
    /// List the devices.
    Devices,
    /// Show a device: all of it, or only some registers, coils or inputs.
    Get {
        /// The device.
        device: String,
        /// Registers and coils; inputs where no register has the name.
        names: Vec<String>,
        /// Show inputs only.
        #[arg(long)]
        inputs: bool,
    },
    /// Set inputs (in engineering units) and registers (raw numbers) of a device.
    ///
    /// Inputs come first where an input and a register have one name. The inputs go in one call and the registers in
    /// another, each all or nothing.
    Set {
        /// The device.
        device: String,
        /// What to set: a number, or true or false.
        #[arg(required = true, value_name = "NAME=VALUE", value_parser = parse_assignment)]
        values: Vec<(String, Value)>,
        /// Set registers whatever the device says, read-only ones too.
        #[arg(long)]
        force: bool,
    },
    /// Pull the plug of a device, or put it back.
    Power {
        /// The device.
        device: String,
        /// In or out.
        state: Switch,
    },
    /// Restart a device.
    Restart {
        /// The device.
        device: String,
    },
    /// Return a device to its factory settings.
    FactoryReset {
        /// The device.
        device: String,
    },
    /// Make things go wrong on purpose.
    Fault {
        /// What to do; without it, the faults are listed.
        #[command(subcommand)]
        command: Option<FaultCommand>,
    },
    /// Show what was asked and what came of it.
    Journal(JournalArgs),
    /// Keep everything, and bring it back.
    Snapshot {
        /// What to do; without it, the snapshots are listed.
        #[command(subcommand)]
        command: Option<SnapshotCommand>,
    },
    /// Go back to how the program started.
    Reset,
    /// Print what happens while it happens, a line each, until the program ends.
    Events,
    /// Print the counts for Prometheus.
    Metrics,
}

#[derive(Debug, Subcommand)]
enum ClockCommand {
    /// Let time pass; everything in between happens.
    Advance {
        /// How long: 90, 90s, 15m, 6h, 2d, 1h30m.
        #[arg(value_parser = parse_seconds)]
        time: f64,
    },
    /// Let time pass until a local date and time.
    Until {
        /// Such as 2014-10-31T18:00.
        time: String,
    },
    /// Jump to a local date and time; nothing happens in between.
    Set {
        /// Such as 2014-10-31T15:00.
        time: String,
    },
    /// Change the rate.
    Rate {
        /// Simulated seconds a real second; 0 stands still.
        #[arg(allow_negative_numbers = true)]
        rate: f64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Debug, Subcommand)]
enum FaultCommand {
    /// Add a fault.
    Add(Box<FaultArgs>),
    /// List the faults.
    List,
    /// Take one away.
    Remove {
        /// Its number.
        id: u64,
    },
    /// Take all away.
    Clear,
}

#[derive(Debug, Args)]
struct FaultArgs {
    /// The bus.
    bus: String,
    /// drop, delay, exception, bad_crc, truncate, garbage, wrong_unit, wrong_function, split, stale, echo, offline, noise
    /// or stuck_register.
    kind: String,
    /// The device.
    #[arg(long)]
    device: Option<String>,
    /// A function code; more than once for several.
    #[arg(long = "function", value_name = "CODE")]
    functions: Vec<u8>,
    /// An address, or first and last of a range; more than once for several.
    #[arg(long, value_name = "A[-B]", value_parser = parse_range)]
    addresses: Vec<(u16, u16)>,
    /// How likely it hits, 0 to 1.
    #[arg(long)]
    probability: Option<f64>,
    /// How often it hits before it is spent.
    #[arg(long)]
    count: Option<u64>,
    /// How long it lasts: 60, 60s, 5m.
    #[arg(long = "for", value_name = "TIME", value_parser = parse_seconds)]
    for_s: Option<f64>,
    /// What its chance is drawn from.
    #[arg(long)]
    seed: Option<u64>,
    /// Of delay: milliseconds.
    #[arg(long)]
    ms: Option<u64>,
    /// Of delay: the most milliseconds that chance adds.
    #[arg(long)]
    jitter_ms: Option<u64>,
    /// Of exception: the code.
    #[arg(long)]
    code: Option<u8>,
    /// Of truncate: bytes that are missing; of garbage: bytes that come with the reply.
    #[arg(long)]
    bytes: Option<u64>,
    /// Of garbage: before or after the reply.
    #[arg(long)]
    place: Option<String>,
    /// Of split: bytes of the first piece.
    #[arg(long, value_name = "BYTES")]
    split_at: Option<u64>,
    /// Of split: milliseconds between the pieces.
    #[arg(long)]
    gap_ms: Option<u64>,
    /// Of noise: bursts a minute.
    #[arg(long)]
    per_minute: Option<u64>,
    /// Of stuck_register: the register.
    #[arg(long)]
    name: Option<String>,
    /// Of stuck_register: the raw number that it shows.
    #[arg(long, allow_negative_numbers = true)]
    value: Option<i64>,
}

#[derive(Debug, Args)]
struct JournalArgs {
    /// Of this bus.
    #[arg(long)]
    bus: Option<String>,
    /// To this device.
    #[arg(long)]
    device: Option<String>,
    /// Of this function code.
    #[arg(long)]
    function: Option<u8>,
    /// That came to this: reply, exception or silence.
    #[arg(long)]
    outcome: Option<String>,
    /// That touch this address.
    #[arg(long)]
    address: Option<u16>,
    /// From this real second since the start on.
    #[arg(long)]
    since: Option<f64>,
    /// The last so many of each bus.
    #[arg(long, default_value_t = 100, conflicts_with_all = ["count", "clear"])]
    last: usize,
    /// Only how many.
    #[arg(long)]
    count: bool,
    /// Empty it.
    #[arg(long, conflicts_with_all = ["count", "bus", "device", "function", "outcome", "address", "since"])]
    clear: bool,
}

#[derive(Debug, Subcommand)]
enum SnapshotCommand {
    /// Keep everything under a name.
    Keep {
        /// The name.
        name: String,
    },
    /// Bring it back.
    Restore {
        /// The name.
        name: String,
    },
    /// List what is kept.
    List,
    /// Forget what was kept.
    Forget {
        /// The name.
        name: String,
    },
}

/// `NAME=VALUE`.
fn parse_assignment(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').ok_or("takes NAME=VALUE")?;
    let hex = value.strip_prefix("0x").and_then(|digits| i64::from_str_radix(digits, 16).ok());
    let value = match value {
        "true" | "on" => json!(true),
        "false" | "off" => json!(false),
        _ => match (hex, value.parse::<i64>(), value.parse::<f64>()) {
            (Some(number), ..) | (None, Ok(number), _) => json!(number),
            (None, Err(_), Ok(number)) if number.is_finite() => json!(number),
            _ => return Err(format!("{name} takes a number, or true or false, not {value:?}")),
        },
    };
    Ok((name.into(), value))
}

/// A time in seconds: `90`, `90s`, `1h30m`, `500ms`.
fn parse_seconds(text: &str) -> Result<f64, String> {
    let wrong = || format!("{text:?} is no time; 90, 90s, 15m, 6h, 2d and 1h30m are");
    if let Ok(seconds) = text.parse::<f64>() {
        return if seconds.is_finite() { Ok(seconds) } else { Err(wrong()) };
    }
    let (mut rest, mut seconds) = (text, 0.0);
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.').ok_or_else(wrong)?;
        let number: f64 = rest[..digits].parse().map_err(|_| wrong())?;
        let unit = rest[digits..].find(|c: char| c.is_ascii_digit()).map_or(rest.len(), |length| digits + length);
        seconds += number
            * match &rest[digits..unit] {
                "ms" => 0.001,
                "s" => 1.0,
                "m" | "min" => 60.0,
                "h" => 3600.0,
                "d" => 86_400.0,
                _ => return Err(wrong()),
            };
        rest = &rest[unit..];
    }
    if text.is_empty() { Err(wrong()) } else { Ok(seconds) }
}

/// `10`, or `10-20`.
fn parse_range(text: &str) -> Result<(u16, u16), String> {
    let number = |text: &str| text.parse::<u16>().map_err(|_| format!("{text:?} is no address"));
    match text.split_once('-') {
        None => number(text).map(|address| (address, address)),
        Some((first, last)) => Ok((number(first)?, number(last)?)),
    }
}

/// Why it was not done, for stderr.
#[derive(Debug)]
pub struct Failed {
    /// In words.
    words: String,
    /// The interface's own error; `null` where it was not asked or did not answer.
    error: Value,
    /// Whether JSON is wanted.
    is_json: bool,
}

impl Failed {
    /// What the interface did not say.
    fn new(words: impl Into<String>) -> Self {
        Self { words: words.into(), error: Value::Null, is_json: false }
    }

    /// The line to print.
    pub fn text(&self) -> String {
        if !self.is_json {
            return format!("error: {}", self.words);
        }
        let own = || json!({ "code": "not_done", "message": self.words, "field": null });
        json!({ "error": if self.error.is_null() { own() } else { self.error.clone() } }).to_string()
    }
}

/// Does what is asked, and gives what is to be printed.
///
/// # Errors
/// Nobody answers, or what is asked is refused.
pub fn run(args: CtlArgs) -> Result<String, Failed> {
    let is_json = args.json;
    act(args).map_err(|failed| Failed { is_json, ..failed })
}

fn act(args: CtlArgs) -> Result<String, Failed> {
    let client = Client::new(&args.at, args.token_file.as_deref())?;
    let (answer, text): (Value, fn(&Value) -> String) = match args.command {
        Command::Status => (client.get("/api/status")?, show::status),
        Command::Clock { command } => (clock(&client, command)?, show::clock),
        Command::Devices => (client.get("/api/devices")?, show::devices),
        Command::Get { device, names, inputs } => (get(&client, &device, &names, inputs)?, show::device),
        Command::Set { device, values, force } => (set(&client, &device, values, force)?, show::readings),
        Command::Power { device, state } => {
            let path = format!("/api/devices/{}/power", client::encoded(&device));
            (client.post(&path, &json!({ "on": state == Switch::On }))?, show::state)
        }
        Command::Restart { device } => {
            (client.post(&format!("/api/devices/{}/restart", client::encoded(&device)), &Value::Null)?, show::state)
        }
        Command::FactoryReset { device } => {
            let path = format!("/api/devices/{}/factory-reset", client::encoded(&device));
            (client.post(&path, &Value::Null)?, show::state)
        }
        Command::Fault { command } => (fault(&client, command)?, show::faults),
        Command::Journal(args) => (journal(&client, args)?, show::journal),
        Command::Snapshot { command } => snapshot(&client, command)?,
        Command::Reset => (client.post("/api/reset", &Value::Null)?, show::clock),
        Command::Events => return client.follow("/api/events", |name, data| print_event(name, data, args.json)),
        Command::Metrics => return client.text("/metrics"),
    };
    Ok(match (args.json, answer) {
        (true, Value::Null) => String::new(),
        (true, answer) => format!("{answer}\n"),
        (false, answer) => text(&answer),
    })
}

/// Prints an event; `false` when nobody reads any more.
fn print_event(name: &str, data: &Value, as_json: bool) -> bool {
    let line = if as_json { format!("{}\n", json!({ "event": name, "data": data })) } else { show::event(name, data) };
    let mut out = io::stdout().lock();
    out.write_all(line.as_bytes()).and_then(|()| out.flush()).is_ok()
}

fn clock(client: &Client, command: Option<ClockCommand>) -> Result<Value, Failed> {
    let change = match command {
        None => return client.get("/api/clock"),
        Some(ClockCommand::Advance { time }) => json!({ "advance_s": time }),
        Some(ClockCommand::Until { time }) => json!({ "until": time }),
        Some(ClockCommand::Set { time }) => json!({ "now": time }),
        Some(ClockCommand::Rate { rate }) => json!({ "rate": rate }),
    };
    client.patch("/api/clock", &change)
}

/// A device, with only what is wanted of it.
fn get(client: &Client, device: &str, names: &[String], only_inputs: bool) -> Result<Value, Failed> {
    let mut view = client.get(&format!("/api/devices/{}", client::encoded(device)))?;
    let groups: &[&str] = if only_inputs { &["inputs"] } else { &["registers", "coils", "inputs"] };
    if names.is_empty() {
        if only_inputs {
            return Ok(view["inputs"].take());
        }
        return Ok(view);
    }
    let mut found = Map::new();
    for name in names {
        let reading = groups.iter().find_map(|group| view[*group].get(name));
        let missing = || Failed::new(format!("{device} has no register, coil or input {name}"));
        found.insert(name.clone(), reading.ok_or_else(missing)?.clone());
    }
    Ok(Value::Object(found))
}

fn set(client: &Client, device: &str, values: Vec<(String, Value)>, force: bool) -> Result<Value, Failed> {
    let path = format!("/api/devices/{}", client::encoded(device));
    let view = client.get(&path)?;
    let is_input = |name: &String| view["inputs"].get(name).is_some();
    let (inputs, registers): (Map<String, Value>, Map<String, Value>) =
        values.into_iter().partition(|(name, _)| is_input(name));
    let mut done = Map::new();
    // The registers first: a device refuses more often than the world does.
    if !registers.is_empty() {
        let query = if force { "?force=true" } else { "" };
        done.extend(object(client.patch(&format!("{path}/registers{query}"), &Value::Object(registers))?));
    }
    if !inputs.is_empty() {
        done.extend(object(client.patch(&format!("{path}/inputs"), &Value::Object(inputs))?));
    }
    Ok(Value::Object(done))
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

fn fault(client: &Client, command: Option<FaultCommand>) -> Result<Value, Failed> {
    match command {
        None | Some(FaultCommand::List) => client.get("/api/faults"),
        Some(FaultCommand::Clear) => client.delete("/api/faults"),
        Some(FaultCommand::Remove { id }) => client.delete(&format!("/api/faults/{id}")),
        Some(FaultCommand::Add(args)) => client.post("/api/faults", &plan(*args)),
    }
}

fn plan(args: FaultArgs) -> Value {
    let plan = json!({
        "bus": args.bus, "kind": args.kind, "device": args.device, "probability": args.probability,
        "functions": (!args.functions.is_empty()).then_some(args.functions),
        "addresses": (!args.addresses.is_empty()).then_some(args.addresses),
        "count": args.count, "for_s": args.for_s, "seed": args.seed, "ms": args.ms, "jitter_ms": args.jitter_ms,
        "code": args.code, "bytes": args.bytes, "place": args.place, "at": args.split_at, "gap_ms": args.gap_ms,
        "per_minute": args.per_minute, "name": args.name, "value": args.value,
    });
    Value::Object(object(plan).into_iter().filter(|(_, value)| !value.is_null()).collect())
}

fn journal(client: &Client, args: JournalArgs) -> Result<Value, Failed> {
    if args.clear {
        return client.delete("/api/journal");
    }
    let fields = [
        ("bus", args.bus),
        ("device", args.device),
        ("function", args.function.map(|code| code.to_string())),
        ("outcome", args.outcome),
        ("address", args.address.map(|address| address.to_string())),
        ("since", args.since.map(|seconds| seconds.to_string())),
        ("limit", (!args.count).then(|| args.last.to_string())),
    ];
    let query = fields.iter().filter_map(|(name, value)| Some(format!("{name}={}", client::encoded(value.as_ref()?))));
    let query = query.collect::<Vec<_>>().join("&");
    client.get(&format!("/api/journal{}?{query}", if args.count { "/count" } else { "" }))
}

type Shown = (Value, fn(&Value) -> String);

fn snapshot(client: &Client, command: Option<SnapshotCommand>) -> Result<Shown, Failed> {
    let path = |name: &str| format!("/api/snapshots/{}", client::encoded(name));
    Ok(match command {
        None | Some(SnapshotCommand::List) => (client.get("/api/snapshots")?, show::snapshots),
        Some(SnapshotCommand::Keep { name }) => (client.post(&path(&name), &Value::Null)?, show::snapshots),
        Some(SnapshotCommand::Restore { name }) => {
            (client.post(&format!("{}/restore", path(&name)), &Value::Null)?, show::clock)
        }
        Some(SnapshotCommand::Forget { name }) => (client.delete(&path(&name))?, show::snapshots),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_as_people_write_them() {
        let read = [("90", 90.0), ("0.5", 0.5), ("90s", 90.0), ("6h", 21_600.0), ("1h30m", 5400.0), ("2d", 172_800.0)];
        for (text, seconds) in read {
            assert_eq!(parse_seconds(text), Ok(seconds), "{text}");
        }
        assert_eq!(parse_seconds("500ms"), Ok(0.5));
        for text in ["", "h", "6 h", "6x", "1h30", "inf", "NaN", "1.2.3s"] {
            assert!(parse_seconds(text).is_err(), "{text}");
        }
    }

    #[test]
    fn assignments_know_numbers_and_words() {
        let read = [("a=1", json!(1)), ("a=-2.5", json!(-2.5)), ("a=0x1F", json!(31)), ("a=on", json!(true))];
        for (text, value) in read {
            assert_eq!(parse_assignment(text), Ok(("a".into(), value)), "{text}");
        }
        for text in ["a", "a=", "a=x", "a=inf", "a=0xG"] {
            assert!(parse_assignment(text).is_err(), "{text}");
        }
    }

    #[test]
    fn ranges_have_one_end_or_two() {
        assert_eq!(parse_range("7"), Ok((7, 7)));
        assert_eq!(parse_range("0-10"), Ok((0, 10)));
        assert!(parse_range("-1").is_err() && parse_range("1-").is_err() && parse_range("65536").is_err());
    }
}
