//! What is fuzzed, and what must hold whatever comes: shared by the targets of cargo-fuzz and by `tests/fuzz.rs`, which
//! runs the same bodies over seeds and random bytes in every test run.

use std::collections::BTreeSet;
use std::path::Path;

use chrono::NaiveDateTime;
use standin::config::{Config, Overrides};
use standin::devices::KINDS;
use standin::station::{Saved, Station};
use standin::wire::{FRAME_MAX, Frame, Framer, Request, crc16};

use crate::bench::{Bench, Plan, framed};

/// The unit that the framer's body takes for its own.
const OURS: u8 = 1;

/// Any bytes on the line: frames have a good CRC, end in the order of the bytes, and do not depend on how the bytes were
/// cut (BUS-1, BUS-5).
pub fn framer(data: &[u8]) {
    let (cut, stream) = data.split_first().map_or((1, data), |(cut, rest)| (usize::from(*cut).max(1), rest));
    let whole = frames(stream, stream.len().max(1));
    assert_eq!(whole, frames(stream, 1), "byte by byte");
    assert_eq!(whole, frames(stream, cut), "{cut} bytes at a time");
    let starts = starts(stream);
    let mut last_end = 0;
    for frame in &whole {
        let frame = framed(frame);
        assert!((4..=FRAME_MAX).contains(&frame.len()), "a frame of {} bytes", frame.len());
        let at = starts.iter().find(|at| **at + frame.len() > last_end && stream[**at..].starts_with(&frame));
        let Some(at) = at else { panic!("a frame starts where one may have ended") };
        last_end = at + frame.len();
    }
}

/// Where frames may start in a stream without silences: at its start, and where bytes with a good CRC end. A CRC that
/// ends in zeros is good without them too: they may lie between two frames.
fn starts(stream: &[u8]) -> BTreeSet<usize> {
    let mut starts = BTreeSet::from([0]);
    for at in 0..stream.len() {
        if !starts.contains(&at) {
            continue;
        }
        let ends = (at + 4..=stream.len().min(at + FRAME_MAX)).filter(|end| crc16(&stream[at..*end]) == 0);
        for end in ends.collect::<Vec<usize>>() {
            let zeros = stream[end..].iter().take(2).take_while(|byte| **byte == 0).count();
            starts.extend(end..=end + zeros);
        }
    }
    starts
}

/// The frames of a stream that comes in pieces, and then a request behind a silence.
fn frames(stream: &[u8], piece: usize) -> Vec<Vec<u8>> {
    let mut framer = Framer::default();
    let mut found = Vec::new();
    for bytes in stream.chunks(piece) {
        framer.push(bytes);
        collect(&mut framer, &mut found);
    }
    match framer.silence() {
        Some(Frame::Damaged(bytes) | Frame::Overlong(bytes)) => assert!(bytes.len() <= FRAME_MAX),
        Some(Frame::Whole(_)) => panic!("silence ends no whole frame"),
        None => {}
    }
    assert!(!framer.is_waiting(), "silence leaves nothing");
    let request = [OURS, 3, 0, 0x10, 0, 7];
    framer.push(&framed(&request));
    let mut after = Vec::new();
    collect(&mut framer, &mut after);
    assert_eq!(after, [request.to_vec()], "a request behind a silence");
    found
}

fn collect(framer: &mut Framer, found: &mut Vec<Vec<u8>>) {
    while let Some(Frame::Whole(frame)) = framer.next_frame(|unit| unit == OURS) {
        found.push(frame.to_vec());
    }
}

/// All devices on one bus at units 1, 2, 3 …, as the bodies and their seeds have them.
fn all_devices() -> Plan {
    let mut plan = Plan::default();
    for (index, kind) in KINDS.iter().enumerate() {
        plan = plan.device(kind.name, index as u8 + 1);
    }
    plan
}

/// What a byte of the input stands for.
enum Deed<'a> {
    /// A frame: unit, function, data; the CRC is added.
    Ask(&'a [u8]),
    /// Bytes as they are, and silence.
    Send(&'a [u8]),
    /// Elapsed and simulated milliseconds pass.
    Wait(u64),
    /// Simulated seconds pass at once.
    Advance(u32),
    /// The civil clock moves to this minute of the century.
    Jump(u32),
    /// An input of a device takes a value of its range, in 255 parts.
    Input { device: u8, input: u8, part: u8 },
    /// A device's plug is pulled or put back, or it restarts.
    Power { device: u8, how: u8 },
}

/// Takes a deed off the front of the data.
fn deed<'a>(data: &mut &'a [u8]) -> Option<Deed<'a>> {
    let (&what, rest) = data.split_first()?;
    *data = rest;
    let deed = match what % 8 {
        0..=2 => Deed::Ask(run(data)?),
        3 => Deed::Send(run(data)?),
        4 => Deed::Wait(u64::from(number(data)?) % 10_000),
        5 if what & 0x80 == 0 => Deed::Advance(u32::from(number(data)?) % 7200),
        5 => Deed::Jump(u32::from(number(data)?) * 803),
        6 => Deed::Input { device: byte(data)?, input: byte(data)?, part: byte(data)? },
        _ => Deed::Power { device: byte(data)?, how: byte(data)? },
    };
    Some(deed)
}

fn byte(data: &mut &[u8]) -> Option<u8> {
    let (&first, rest) = data.split_first()?;
    *data = rest;
    Some(first)
}

fn number(data: &mut &[u8]) -> Option<u16> {
    Some(u16::from_be_bytes([byte(data)?, byte(data)?]))
}

/// A length and so many bytes, or as many as are left.
fn run<'a>(data: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = usize::from(byte(data)?).min(data.len());
    let (bytes, rest) = data.split_at(length);
    *data = rest;
    Some(bytes)
}

/// The input of [`bus`] that asks one thing after the other.
pub fn asks<'a>(frames: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut data = Vec::new();
    for frame in frames {
        data.push(0);
        data.push(frame.len() as u8);
        data.extend(frame);
    }
    data
}

/// The most deeds of one run, so that a run ends soon.
const DEEDS_MAX: usize = 64;

/// Any requests to all devices, any bytes, and time, world and power as they come. Every reply is a frame that fits its
/// request; afterwards every device that listens answers a good request, and what EEPROM keeps can be taken back.
pub fn bus(data: &[u8]) {
    let mut bench = all_devices().start();
    let mut left = data;
    for _ in 0..DEEDS_MAX {
        let Some(deed) = deed(&mut left) else { break };
        carry_out(&mut bench, deed);
    }
    for index in 0..bench.bus.stations().len() {
        let name = bench.bus.stations()[index].name().to_owned();
        bench.power(&name, true);
    }
    bench.wait_ms(2000);
    check_listeners(&mut bench);
    check_memory(&mut bench);
}

fn carry_out(bench: &mut Bench, deed: Deed) {
    let station = |bench: &Bench, device: u8| usize::from(device) % bench.bus.stations().len();
    match deed {
        Deed::Ask(pdu) => {
            bench.send(&framed(pdu));
            // Bytes behind a whole request are noise, and the request may be answered as it is. Frames of exceptions and of
            // unknown functions may end early, and what follows them is a request of its own.
            let request = pdu.get(1..).and_then(Request::parse);
            let is_request = request.is_some_and(|request| !matches!(request, Request::Other { .. }));
            check_replies(bench, is_request.then_some(pdu));
            bench.wait_ms(40);
            check_replies(bench, None);
        }
        Deed::Send(bytes) => {
            bench.send(bytes);
            bench.wait_ms(40);
            check_replies(bench, None);
        }
        Deed::Wait(ms) => bench.wait_ms(ms),
        Deed::Advance(seconds) => bench.advance_s(f64::from(seconds)),
        Deed::Jump(minutes) => {
            let time = standin::time::earliest() + chrono::TimeDelta::minutes(i64::from(minutes));
            bench.bus.jump_clock(bench.now, time);
        }
        Deed::Input { device, input, part } => {
            let index = station(bench, device);
            let inputs = bench.bus.stations()[index].kind().inputs;
            let Some(row) = inputs.get(usize::from(input) % inputs.len().max(1)) else { return };
            let value = match row.range {
                standin::world::InputRange::Flag { .. } => f64::from(part % 2),
                standin::world::InputRange::Number { min, max, .. } => min + (max - min) * f64::from(part) / 255.0,
            };
            let name = format!("{}.{}", bench.bus.stations()[index].name(), row.name());
            bench.input(&name, value);
        }
        Deed::Power { device, how } => {
            let name = bench.bus.stations()[station(bench, device)].name().to_owned();
            match how % 3 {
                0 => bench.power(&name, false),
                1 => bench.power(&name, true),
                _ => bench.restart(&name),
            }
        }
    }
}

/// What the bus said since the last look: frames, each the answer to `request` where there is one.
fn check_replies(bench: &mut Bench, request: Option<&[u8]>) {
    let heard = std::mem::take(&mut bench.heard);
    if let Some(request) = request {
        assert!(heard.len() <= 1, "one request, one reply");
        assert!(request[0] != 0 || heard.is_empty(), "a broadcast is not answered");
    }
    for frame in heard {
        assert!((5..=FRAME_MAX).contains(&frame.len()), "a reply of {} bytes", frame.len());
        assert_eq!(crc16(&frame), 0, "a reply's CRC");
        if frame[1] & 0x80 != 0 {
            assert!(frame.len() == 5 && (1..=4).contains(&frame[2]), "an exception 01 to 04: {frame:02x?}");
        }
        let Some(request) = request else { continue };
        assert_eq!((frame[0], frame[1] & 0x7F), (request[0], request[1] & 0x7F), "a reply's unit and function");
        if frame[1] & 0x80 == 0 {
            check_reply_to(request, &frame[..frame.len() - 2]);
        }
    }
}

/// A reply that is no exception has the length that its request asks for, and echoes what it has to (BUS-7).
fn check_reply_to(request: &[u8], reply: &[u8]) {
    let Some(parsed) = Request::parse(&request[1..]) else { panic!("an answer to no request: {request:02x?}") };
    if parsed.is_read() {
        let quantity = usize::from(request[4]) << 8 | usize::from(request[5]);
        let bytes = if request[1] <= 2 { quantity.div_ceil(8) } else { quantity * 2 };
        assert_eq!(usize::from(reply[2]), bytes, "the bytes of a read");
        assert_eq!(reply.len(), bytes + 3, "the length of a read's reply");
    } else {
        assert_eq!(reply, &request[..6], "the echo of a write");
    }
}

/// Every device that listens at a unit of its own answers, with its unit.
fn check_listeners(bench: &mut Bench) {
    let units: Vec<Option<u8>> = bench
        .bus
        .stations()
        .iter()
        .map(|station| station.is_listening().then_some(station.address().unit).filter(|unit| *unit != 0))
        .collect();
    for (index, unit) in units.iter().enumerate() {
        let Some(unit) = *unit else { continue };
        if units.iter().filter(|other| **other == Some(unit)).count() > 1 {
            continue;
        }
        let point = bench.bus.stations()[index].kind().profile.line.unit;
        let got = bench.read(unit, 3, point.addr(), 1);
        assert_eq!(got, Ok(vec![u16::from(unit)]), "{}", bench.bus.stations()[index].name());
    }
}

/// What EEPROM keeps of any state is an image that the device takes back (BUS-19).
fn check_memory(bench: &mut Bench) {
    let images: Vec<Option<Saved>> = (0..bench.bus.stations().len())
        .map(|index| {
            let name = bench.bus.stations()[index].name().to_owned();
            let text = serde_json::to_string(&bench.saved(&name)).expect("an image is JSON");
            Some(serde_json::from_str(&text).expect("the JSON is an image"))
        })
        .collect();
    all_devices().start_with(&images);
}

/// Any file as devices.toml: a configuration, or errors that each have a place in the file; a configuration can be built.
pub fn config(data: &[u8]) {
    let host = host();
    match Config::parse("devices.toml", data, &Overrides::default(), host) {
        Ok(config) => {
            let clock = config.clock(host);
            for setup in config.buses.into_iter().flat_map(|bus| bus.devices) {
                let layout = std::sync::Arc::new(standin::image::Layout::new(setup.kind.map));
                let name = setup.name.clone();
                if let Err(problems) = Station::new(setup, layout, None, &clock) {
                    panic!("{name} was found good and does not start: {problems:?}");
                }
            }
        }
        Err(error) => {
            assert!(!error.problems.is_empty(), "an error says what is wrong");
            let lines = data.split(|byte| *byte == b'\n').count();
            for problem in error.problems {
                assert!(!problem.message.is_empty());
                if let Some((line, column)) = problem.place {
                    assert!((1..=lines).contains(&line) && column >= 1, "{line}:{column} of {lines} lines");
                }
            }
        }
    }
}

fn host() -> NaiveDateTime {
    standin::time::civil(2014, 10, 27, 14, 22, 8)
}

/// Any bytes as an EEPROM image: refused, or taken, and then the device lives with it and keeps an image of its own.
pub fn image(data: &[u8]) {
    let Ok(saved) = serde_json::from_slice::<Saved>(data) else { return };
    for (index, kind) in KINDS.iter().enumerate() {
        let name = format!("device{}", index + 1);
        let plan = || Plan::default().device(kind.name, 1).named(&name);
        let Some(mut bench) = try_start(plan(), &saved) else { continue };
        bench.wait_ms(1000);
        bench.advance_s(3600.0);
        let unit = bench.bus.stations()[0].address().unit;
        if unit != 0 && bench.bus.stations()[0].is_listening() {
            let point = kind.profile.line.unit;
            assert_eq!(bench.read(unit, 3, point.addr(), 1), Ok(vec![u16::from(unit)]), "{}", kind.name);
        }
        let kept = bench.saved(&name);
        assert!(try_start(plan(), &kept).is_some(), "{} refuses its own image: {kept:?}", kind.name);
    }
}

/// A bench with one device that starts from an image, unless the device refuses it.
fn try_start(plan: Plan, saved: &Saved) -> Option<Bench> {
    let setup = plan.setups.first()?.clone();
    let layout = std::sync::Arc::new(standin::image::Layout::new(setup.kind.map));
    let clock = standin::time::SimClock::new(plan.start, plan.rate);
    Station::new(setup, layout, Some(saved), &clock).ok()?;
    Some(plan.start_with(&[Some(saved.clone())]))
}

/// The seeds of all targets, each with a name: the requests of the transcripts, the example configuration, and the
/// images of devices as they leave the factory.
pub fn seeds(root: &Path) -> Vec<(&'static str, String, Vec<u8>)> {
    let mut seeds = Vec::new();
    let mut texts = Vec::new();
    transcripts(&root.join("tests/transcripts"), &mut texts);
    texts.sort();
    for (name, text) in &texts {
        for (number, part) in text.split("\n---\n").enumerate() {
            let mut requests: Vec<Vec<u8>> = part.lines().filter_map(request).collect();
            if requests.is_empty() {
                continue;
            }
            for request in &mut requests {
                request[0] = unit_here(part, request[0]);
            }
            let name = format!("{name}-{number}");
            let stream: Vec<u8> = requests.iter().flat_map(|request| framed(request)).collect();
            seeds.push(("framer", name.clone(), [vec![7], stream].concat()));
            seeds.push(("bus", name, asks(requests.iter().map(Vec::as_slice))));
        }
    }
    seeds.push(("config", "example".into(), standin::config::EXAMPLE.into()));
    for kind in KINDS {
        let mut bench = Plan::of(kind.name, 1).start();
        let saved = serde_json::to_vec_pretty(&bench.saved("")).expect("an image is JSON");
        seeds.push(("image", kind.name.into(), saved));
        let device = format!("[[bus.device]]\nname = \"one\"\nmodel = \"{}\"\nunit = 1\n", kind.name);
        let bus = "[clock]\nstart = \"2014-10-27T14:22:08\"\n[[bus]]\nname = \"line\"\nport = \"pty:line\"\n";
        seeds.push(("config", kind.name.into(), format!("{bus}{device}").into()));
    }
    seeds
}

fn transcripts(folder: &Path, texts: &mut Vec<(String, String)>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        if path.is_dir() {
            transcripts(&path, texts);
        } else if let (Ok(text), Some(stem)) = (std::fs::read_to_string(&path), path.file_stem()) {
            texts.push((stem.to_string_lossy().into_owned(), text));
        }
    }
}

/// The unit that a device of a transcript has on the bus of all devices; another unit stays what it is.
fn unit_here(transcript: &str, unit: u8) -> u8 {
    let words = transcript.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let mut model = words.filter_map(|words| match words[..] {
        ["device", model, "at", at, ..] if at.parse() == Ok(unit) => Some(model.to_owned()),
        _ => None,
    });
    let model = model.next_back();
    KINDS.iter().position(|kind| Some(kind.name) == model.as_deref()).map_or(unit, |index| index as u8 + 1)
}

/// Unit, function and data of a transcript's request line, its CRC cut off.
fn request(line: &str) -> Option<Vec<u8>> {
    let line = line.split('#').next()?.trim().strip_prefix('>')?;
    let words: Vec<&str> = line.split_whitespace().filter(|word| *word != "crc").collect();
    let bytes: Vec<u8> = words.iter().filter_map(|word| u8::from_str_radix(word, 16).ok()).collect();
    let is_printed_with_crc = bytes.len() > 4 && crc16(&bytes) == 0;
    let length = if is_printed_with_crc { bytes.len() - 2 } else { bytes.len() };
    (bytes.len() == words.len() && length >= 2).then(|| bytes[..length].to_vec())
}
