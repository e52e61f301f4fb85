//! Dialogues with the devices: every file of `tests/transcripts/<kind>/{manual,behaviour}` is played and held against
//! what it says. The language is explained in ARCHITECTURE.md.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use bench::{Bench, Plan, framed};
use standin::line::{Line, Parity};
use standin::options::OptionValue;

#[test]
fn transcripts_are_played_as_written() {
    let mut files = Vec::new();
    collect(Path::new("tests/transcripts"), &mut files);
    files.sort();
    let mut failures = String::new();
    // What fails is told once, at the end, without a backtrace each.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    for file in &files {
        let text = std::fs::read_to_string(file).unwrap();
        let mut line = 1;
        for part in text.split("\n---\n") {
            let path = file.display().to_string();
            let played = std::panic::catch_unwind(|| check(part, &path, line));
            if let Err(panic) = played {
                let text = panic.downcast_ref::<String>().cloned();
                let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
                writeln!(failures, "{}", text.unwrap_or_default()).unwrap();
            }
            line += part.lines().count() + 1;
        }
    }
    std::panic::set_hook(hook);
    assert!(failures.is_empty(), "\n{failures}");
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "txt") {
            files.push(path);
        }
    }
}

/// Plays one bench of a file. A line that starts behind a comment counts from `first_line`.
fn check(text: &str, file: &str, first_line: usize) {
    let mut stage = Stage::Planning(Plan::default());
    for (index, line) in text.lines().enumerate() {
        let place = format!("{file}:{}", first_line + index);
        let line = line.split('#').next().unwrap_or("").trim();
        if line.is_empty() {
            continue;
        }
        let (verb, rest) = line.split_once(' ').unwrap_or((line, ""));
        let played = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| play(&mut stage, verb, rest.trim())));
        if let Err(panic) = played {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            panic!("{place}: {line}\n    {}", text.unwrap_or("it panicked"));
        }
    }
}

enum Stage {
    Planning(Plan),
    Running(Box<Bench>),
}

impl Stage {
    fn bench(&mut self) -> &mut Bench {
        if let Stage::Planning(plan) = self {
            *self = Stage::Running(Box::new(std::mem::take(plan).start()));
        }
        match self {
            Stage::Running(bench) => bench,
            Stage::Planning(_) => unreachable!("it was started above"),
        }
    }

    fn plan(&mut self, change: impl FnOnce(Plan) -> Plan) {
        match self {
            Stage::Planning(plan) => *plan = change(std::mem::take(plan)),
            Stage::Running(_) => panic!("the bench runs already"),
        }
    }
}

fn play(stage: &mut Stage, verb: &str, rest: &str) {
    let words: Vec<&str> = rest.split_whitespace().collect();
    match verb {
        "device" => {
            let unit = words[2].parse().expect("a unit");
            assert_eq!(words[1], "at");
            stage.plan(|plan| plan.device(words[0], unit));
            if words.get(3) == Some(&"name") {
                stage.plan(|plan| plan.named(words[4]));
            }
        }
        "options" => {
            for (name, value) in flat("", &table(rest)) {
                let value = match value {
                    toml::Value::Integer(number) => OptionValue::Integer(number),
                    toml::Value::Boolean(flag) => OptionValue::Flag(flag),
                    other => OptionValue::Choice(other.as_str().expect("a word").into()),
                };
                stage.plan(|plan| plan.option(&name, value));
            }
        }
        "inputs" => {
            for (name, value) in table(rest) {
                stage.plan(|plan| plan.input(&name, number(&value)));
            }
        }
        "registers" => {
            for (name, value) in table(rest) {
                stage.plan(|plan| plan.register(&name, value.as_integer().expect("a whole number")));
            }
        }
        "line" => {
            let table = table(rest);
            let baud = table["baud"].as_integer().expect("a baud rate") as u32;
            let parity = match table["parity"].as_str() {
                Some("none") => Parity::None,
                Some("even") => Parity::Even,
                Some("odd") => Parity::Odd,
                _ => panic!("a parity"),
            };
            let stop_bits = table["stop_bits"].as_integer().expect("stop bits") as u8;
            stage.plan(|plan| plan.line(Line { baud, parity, stop_bits }));
        }
        "clock" => {
            let rate = if words.get(1) == Some(&"rate") { words[2].parse().expect("a rate") } else { 1.0 };
            stage.plan(|plan| plan.clock(words[0], rate));
        }
        ">" => {
            let bytes = bytes(&words);
            stage.bench().send(&bytes);
        }
        "<" => hear(stage.bench(), &words),
        "wait" => stage.bench().wait_us((seconds(&words) * 1e6) as u64),
        "advance" => stage.bench().advance_s(seconds(&words)),
        "jump" => stage.bench().jump(rest),
        "rate" => {
            let bench = stage.bench();
            bench.bus.set_rate(bench.now, rest.parse().expect("a rate"));
        }
        "input" => {
            let (name, value) = rest.split_once('=').expect("name = value");
            let value = match value.trim() {
                "true" => 1.0,
                "false" => 0.0,
                text => text.parse().expect("a number"),
            };
            stage.bench().input(name.trim(), value);
        }
        "force" => {
            let (name, value) = rest.split_once('=').expect("name = value");
            stage.bench().force(name.trim(), value.trim().parse().expect("a whole number"));
        }
        "get" => {
            let wanted: i64 = words[2].parse().expect("a whole number");
            let got = stage.bench().get(words[0]);
            let holds = match words[1] {
                "=" => got == wanted,
                "!=" => got != wanted,
                ">=" => got >= wanted,
                "<=" => got <= wanted,
                other => panic!("{other} compares nothing"),
            };
            assert!(holds, "{} is {got}", words[0]);
        }
        "power" => {
            let device = if words.len() == 2 { words[0] } else { "" };
            stage.bench().power(device, words[words.len() - 1] == "on");
        }
        "restart" => stage.bench().restart(rest),
        "factory-reset" => stage.bench().factory_reset(rest),
        other => panic!("{other} is no word of transcripts"),
    }
}

fn hear(bench: &mut Bench, words: &[&str]) {
    if let ["silence", time @ ..] = words {
        let ms = if time.is_empty() { 100.0 } else { seconds(time) * 1e3 };
        if let Some(frame) = bench.hear_within(ms as u64) {
            panic!("wanted silence\n    got    {}", hex(&frame));
        }
        return;
    }
    let got = bench.hear();
    match (words, got) {
        (["any"], Some(_)) => {}
        (_, None) => panic!("wanted a reply\n    got    silence"),
        (_, Some(got)) => {
            let wanted = bytes(words);
            assert!(got == wanted, "wanted {}\n    got    {}", hex(&wanted), hex(&got));
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X} ")).collect()
}

fn bytes(words: &[&str]) -> Vec<u8> {
    let (words, has_crc) = match words.split_last() {
        Some((&"crc", rest)) => (rest, true),
        _ => (words, false),
    };
    let bytes = words.iter().map(|word| u8::from_str_radix(word, 16).expect("a byte in hex"));
    let bytes: Vec<u8> = bytes.collect();
    if has_crc { framed(&bytes) } else { bytes }
}

fn seconds(words: &[&str]) -> f64 {
    let number: f64 = words[0].parse().expect("a number");
    number
        * match words[1] {
            "us" => 1e-6,
            "ms" => 1e-3,
            "s" => 1.0,
            "min" => 60.0,
            "h" => 3600.0,
            "d" => 86_400.0,
            other => panic!("{other} is no unit of time"),
        }
}

fn table(text: &str) -> toml::Table {
    let document: toml::Table = format!("t = {{ {text} }}").parse().expect("keys and values");
    document["t"].as_table().expect("a table").clone()
}

fn flat(prefix: &str, table: &toml::Table) -> Vec<(String, toml::Value)> {
    let mut values = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => values.extend(flat(&format!("{prefix}{key}."), inner)),
            other => values.push((format!("{prefix}{key}"), other.clone())),
        }
    }
    values
}

fn number(value: &toml::Value) -> f64 {
    match value {
        toml::Value::Boolean(flag) => f64::from(u8::from(*flag)),
        toml::Value::Integer(number) => *number as f64,
        other => other.as_float().expect("a number"),
    }
}
