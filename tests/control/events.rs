//! What happens while it happens (`/api/events`), and counts (`/metrics`).

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::program::Program;

/// A reader of the events.
struct Follower {
    lines: BufReader<TcpStream>,
}

impl Follower {
    /// Comes back when the program has begun to watch.
    fn new(program: &Program) -> Self {
        let mut stream = TcpStream::connect(program.address()).unwrap();
        stream.write_all(b"GET /api/events HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let mut lines = BufReader::new(stream);
        let mut line = String::new();
        while !line.starts_with(": standin") {
            line.clear();
            lines.read_line(&mut line).unwrap();
        }
        Self { lines }
    }

    /// The next event.
    fn next(&mut self) -> (String, Value) {
        let mut name = None;
        loop {
            let mut line = String::new();
            assert!(self.lines.read_line(&mut line).expect("an event") > 0, "the stream has ended");
            if let Some(rest) = line.strip_prefix("event: ") {
                name = Some(rest.trim().to_owned());
            } else if let (Some(data), Some(name)) = (line.strip_prefix("data: "), &name) {
                return (name.clone(), serde_json::from_str(data).unwrap());
            }
        }
    }

    /// The next event of this name.
    fn wait_for(&mut self, wanted: &str) -> Value {
        loop {
            let (name, data) = self.next();
            if name == wanted {
                return data;
            }
        }
    }
}

#[test]
fn ctl_events_tell_what_happens() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let mut follower = Follower::new(&program);
    line.ask(&[5, 6, 0, 10, 0, 50]);
    let exchange = follower.wait_for("exchange");
    assert_eq!((&exchange["device"], &exchange["outcome"]), (&json!("charger"), &json!("reply")));
    assert_eq!(exchange["values"], json!([50]));
    let change = follower.wait_for("change");
    let wanted = [
        ("bus", json!("line1")),
        ("device", json!("charger")),
        ("register", json!("fan_on_temperature")),
        ("raw", json!(50)),
        ("was_raw", json!(40)),
        ("value", json!(50)),
        ("unit", json!("°C")),
    ];
    for (field, value) in wanted {
        assert_eq!(change[field], value, "{field} of {change}");
    }
    program.post("/api/devices/heater/power", json!({"on": false})).ok();
    assert_eq!(follower.wait_for("power")["powered"], false);
    program.post("/api/devices/heater/power", json!({"on": true})).ok();
    let boot = follower.wait_for("boot");
    assert_eq!((&boot["device"], &boot["boots"]), (&json!("heater"), &json!(2)));
    program.post("/api/faults", json!({"kind": "drop", "bus": "line1"})).ok();
    line.send(&[5, 3, 0, 10, 0, 1]);
    let fault = follower.wait_for("fault");
    assert_eq!((&fault["id"], &fault["kind"], &fault["device"]), (&json!(1), &json!("drop"), &json!("charger")));
    // Time brings changes too.
    program.patch("/api/clock", json!({"advance_s": 3600})).ok();
    while follower.wait_for("change")["register"] != "rtc_hour" {}
}

#[test]
fn ctl_events_a_slow_reader_loses_some_and_slows_nobody() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let time = |line: &mut crate::program::Line, count: usize| {
        let started = Instant::now();
        (0..count).for_each(|_| assert_eq!(line.read(7, 0, 41).len(), 41));
        started.elapsed()
    };
    time(&mut line, 500);
    let alone = time(&mut line, 2000);
    let mut follower = Follower::new(&program);
    // Nobody reads: an event has some 700 bytes, and sockets hold a few megabytes at most.
    let mut followed = Duration::ZERO;
    for _ in 0..10 {
        followed = time(&mut line, 2000);
    }
    assert!(followed < alone * 4 + Duration::from_secs(1), "{followed:?} with a reader that sleeps, {alone:?} without");
    let (mut seen, mut lost) = (0, 0);
    while seen + lost < 20_000 {
        match follower.next() {
            (name, _) if name == "exchange" => seen += 1,
            (name, data) if name == "lost" => lost += data["count"].as_u64().unwrap(),
            _ => {}
        }
    }
    assert_eq!(seen + lost, 20_000, "{lost} are lost, and all are told of");
    assert!(lost > 0);
}

/// The value of a sample of the metrics.
fn sample(text: &str, name: &str) -> f64 {
    let line = text.lines().find(|line| line.strip_prefix(name).is_some_and(|rest| rest.starts_with(' ')));
    line.unwrap_or_else(|| panic!("no {name} in\n{text}")).rsplit_once(' ').unwrap().1.parse().unwrap()
}

#[test]
fn ctl_metrics_agree_with_the_journal() {
    let program = Program::bench();
    let mut line = program.line("line1");
    (0..7).for_each(|_| assert_eq!(line.read(5, 10, 1).len(), 1));
    (0..3).for_each(|_| assert_eq!(line.ask(&[5, 6, 0, 10, 0, 61]), [5, 0x86, 3]));
    assert!(line.is_deaf(&[9, 3, 0, 10, 0, 1]));
    program.post("/api/faults", json!({"kind": "delay", "ms": 30, "bus": "line1", "count": 2})).ok();
    (0..2).for_each(|_| assert_eq!(line.read(7, 23, 1), [2200]));
    let answer = program.get("/metrics");
    assert!(answer.headers["content-type"].to_str().unwrap().starts_with("text/plain; version=0.0.4"));
    let text = answer.text;
    let requests = |device: &str, function: u8, outcome: &str, code: u8| {
        let labels =
            format!("bus=\"line1\",device=\"{device}\",function=\"{function}\",outcome=\"{outcome}\",code=\"{code}\"");
        sample(&text, &format!("standin_requests_total{{{labels}}}")) as u64
    };
    let journal = |query: &str| program.get(&format!("/api/journal/count?{query}")).ok()["count"].as_u64().unwrap();
    assert_eq!(requests("charger", 3, "reply", 0), 7);
    assert_eq!(requests("charger", 3, "reply", 0), journal("device=charger&function=3&outcome=reply"));
    assert_eq!(requests("charger", 6, "exception", 3), 3);
    assert_eq!(requests("charger", 6, "exception", 3), journal("device=charger&outcome=exception"));
    assert_eq!(requests("", 3, "silence", 0), journal("outcome=silence"));
    assert_eq!(sample(&text, "standin_frames_total{bus=\"line1\"}"), 13.0);
    assert_eq!(sample(&text, "standin_fault_hits_total{bus=\"line1\",kind=\"delay\"}"), 2.0);
    assert_eq!(sample(&text, "standin_boots_total{bus=\"line1\",device=\"heater\"}"), 1.0);
    assert_eq!(sample(&text, "standin_powered{bus=\"line1\",device=\"heater\"}"), 1.0);
    // Two replies of the heater took 30 ms or a little more: none is within 25 ms.
    let heater = |suffix: &str, le: &str| {
        sample(&text, &format!("standin_reply_seconds_{suffix}{{bus=\"line1\",device=\"heater\"{le}}}"))
    };
    assert_eq!(heater("bucket", ",le=\"0.025\""), 0.0);
    assert_eq!((heater("bucket", ",le=\"+Inf\""), heater("count", "")), (2.0, 2.0));
    assert!(heater("sum", "") >= 0.06, "{}", heater("sum", ""));
    // Every metric says what it is.
    for name in text.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(['{', ' ']).next().unwrap()) {
        let base = ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name);
        assert!(text.contains(&format!("# HELP {base} ")) && text.contains(&format!("# TYPE {base} ")), "{name}");
    }
    program.post("/api/reset", json!(null)).ok();
    assert!(!program.get("/metrics").text.contains("standin_requests_total{"), "a reset counts anew");
}
