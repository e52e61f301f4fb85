//! Starts the program with a control interface, and talks to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use standin::wire::append_crc;
use tempfile::TempDir;

/// A bus `line1` with an Astro `yard`, a TRC `charger` and a Volcano `heater`, at 15:00 on 31 October 2014.
pub const BENCH: &str = r#"
[clock]
start = "2014-10-31T15:00:00"
rate = 0.0
[control]
listen = "127.0.0.1:0"
[[bus]]
name = "line1"
port = "tcp:127.0.0.1:0"
[[bus.device]]
name = "yard"
model = "kael-astro-01"
unit = 1
[[bus.device]]
name = "charger"
model = "logiccon-trc"
unit = 5
[[bus.device]]
name = "heater"
model = "hmi-volcano-ec"
unit = 7
"#;

/// How long a reply may take on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// How long the line stays silent before a test believes it.
const SILENCE: Duration = Duration::from_millis(150);

/// A running program.
pub struct Program {
    child: Child,
    pub report: Value,
    pub folder: TempDir,
    pub agent: ureq::Agent,
    pub token: Option<String>,
}

/// What a call answered.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub json: Value,
    pub text: String,
    pub headers: ureq::http::HeaderMap,
}

impl Answer {
    /// The JSON of a call that was done.
    #[track_caller]
    pub fn ok(self) -> Value {
        assert!((200..300).contains(&self.status), "{} {}", self.status, self.text);
        self.json
    }

    /// Checks a call that was not done, by its status, code and field (CTL-2), and gives its message.
    #[track_caller]
    pub fn refused(self, status: u16, code: &str, field: Option<&str>) -> String {
        assert_eq!(self.status, status, "{}", self.text);
        let error = &self.json["error"];
        assert_eq!(error["code"], code, "{}", self.text);
        assert_eq!(error["field"].as_str(), field, "{}", self.text);
        error["message"].as_str().unwrap().to_owned()
    }
}

pub fn command(folder: &TempDir, toml: &str) -> Command {
    let config = folder.path().join("devices.toml");
    let toml = toml.replace("{dir}", &folder.path().display().to_string());
    std::fs::write(&config, toml).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_standin"));
    command.args(["run", "--json", "--exit-with-parent"]).arg(config).current_dir(folder.path());
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    command
}

impl Program {
    /// Starts it on a configuration; `{dir}` stands for a fresh folder.
    #[track_caller]
    pub fn start(toml: &str) -> Self {
        Self::start_with(toml, |_| {})
    }

    /// Starts it with more arguments or environment; its log goes to `log` in its folder.
    #[track_caller]
    pub fn start_with(toml: &str, more: impl FnOnce(&mut Command)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = command(&folder, toml);
        command.stderr(std::fs::File::create(folder.path().join("log")).unwrap());
        more(&mut command);
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let report = serde_json::from_str(&line).unwrap_or_else(|_| {
            let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
            panic!("not ready: {line:?}; {log}")
        });
        let agent =
            ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE * 3)).build();
        Self { child, report, folder, agent: agent.into(), token: None }
    }

    /// The three devices of [`BENCH`].
    #[track_caller]
    pub fn bench() -> Self {
        Self::start(BENCH)
    }

    pub fn url(&self) -> &str {
        self.report["control"].as_str().unwrap()
    }

    /// Host and port of the control interface.
    pub fn address(&self) -> &str {
        self.url().strip_prefix("http://").unwrap()
    }

    #[track_caller]
    pub fn get(&self, path: &str) -> Answer {
        self.call("GET", path, "")
    }

    #[track_caller]
    pub fn patch(&self, path: &str, body: Value) -> Answer {
        self.call("PATCH", path, &body.to_string())
    }

    #[track_caller]
    pub fn post(&self, path: &str, body: Value) -> Answer {
        self.call("POST", path, &body.to_string())
    }

    #[track_caller]
    pub fn delete(&self, path: &str) -> Answer {
        self.call("DELETE", path, "")
    }

    #[track_caller]
    pub fn call(&self, method: &str, path: &str, body: &str) -> Answer {
        self.call_with(method, path, body, &[])
    }

    #[track_caller]
    pub fn call_with(&self, method: &str, path: &str, body: &str, headers: &[(&str, &str)]) -> Answer {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url()));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let request = request.body(body.to_owned()).unwrap();
        let mut response = self.agent.run(request).unwrap();
        let text = response.body_mut().read_to_string().unwrap();
        let json = serde_json::from_str(&text).unwrap_or(Value::Null);
        Answer { status: response.status().as_u16(), json, text, headers: response.headers().clone() }
    }

    /// A connection to a bus.
    #[track_caller]
    pub fn line(&self, bus: &str) -> Line {
        let buses = self.report["buses"].as_array().unwrap();
        let path = buses.iter().find(|each| each["name"] == bus).unwrap()["path"].as_str().unwrap();
        let stream = TcpStream::connect(path).unwrap();
        stream.set_nodelay(true).unwrap();
        Line { stream }
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    /// Ends it as a service manager does.
    pub fn stop(&mut self) -> ExitStatus {
        Command::new("kill").arg(self.child.id().to_string()).status().unwrap();
        self.child.wait().unwrap()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// A Modbus client that talks RTU over TCP.
pub struct Line {
    stream: TcpStream,
}

impl Line {
    /// Sends unit, function and data with their CRC.
    pub fn send(&mut self, request: &[u8]) {
        let mut frame = request.to_vec();
        append_crc(&mut frame);
        self.stream.write_all(&frame).unwrap();
    }

    /// Everything that comes until the line is silent, waiting for the first byte as long as `patience`.
    pub fn hear(&mut self, patience: Duration) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut buffer = [0; 512];
        self.stream.set_read_timeout(Some(patience)).unwrap();
        while let Ok(count @ 1..) = self.stream.read(&mut buffer) {
            bytes.extend(&buffer[..count]);
            self.stream.set_read_timeout(Some(Duration::from_millis(30))).unwrap();
        }
        bytes
    }

    /// Asks; gives unit, function and data of the reply.
    #[track_caller]
    pub fn ask(&mut self, request: &[u8]) -> Vec<u8> {
        self.send(request);
        self.reply()
    }

    /// A whole reply, without its CRC: ends at the byte at which it is whole.
    #[track_caller]
    pub fn reply(&mut self) -> Vec<u8> {
        let end = Instant::now() + PATIENCE;
        let mut bytes = Vec::new();
        let mut byte = [0; 1];
        self.stream.set_read_timeout(Some(PATIENCE)).unwrap();
        while Instant::now() < end {
            self.stream.read_exact(&mut byte).expect("a reply");
            bytes.push(byte[0]);
            if bytes.len() >= 5 && standin::wire::crc16(&bytes) == 0 {
                bytes.truncate(bytes.len() - 2);
                return bytes;
            }
        }
        panic!("no reply, only {bytes:02X?}")
    }

    /// Whether nothing answers.
    pub fn is_deaf(&mut self, request: &[u8]) -> bool {
        self.send(request);
        self.hear(SILENCE).is_empty()
    }

    /// Reads holding registers.
    #[track_caller]
    pub fn read(&mut self, unit: u8, start: u16, quantity: u16) -> Vec<u16> {
        self.read_by(3, unit, start, quantity)
    }

    /// Reads registers by function 03 or 04.
    #[track_caller]
    pub fn read_by(&mut self, function: u8, unit: u8, start: u16, quantity: u16) -> Vec<u16> {
        let ([a, b], [c, d]) = (start.to_be_bytes(), quantity.to_be_bytes());
        let reply = self.ask(&[unit, function, a, b, c, d]);
        assert_eq!(reply[1], function, "{reply:02X?}");
        reply[3..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
    }
}
