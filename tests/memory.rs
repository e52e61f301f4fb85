//! EEPROM that survives everything: kill -9, full disks, folders that take nothing, images that are damaged (BUS-19,
//! BUS-20, BUS-22).
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use program::{Client, PATIENCE, Program, charger_on_pty, framed, open, refused};
use tempfile::TempDir;

const STATE: [&str; 2] = ["--state", "{dir}/state"];

fn folder() -> Arc<TempDir> {
    Arc::new(tempfile::tempdir().unwrap())
}

fn start(folder: &Arc<TempDir>) -> Program {
    Program::start_in(folder.clone(), &charger_on_pty(""), &STATE)
}

fn image(folder: &TempDir) -> PathBuf {
    folder.path().join("state/charger.json")
}

/// The mains limits of the TRC, registers 6 and 7: 230 to 270 and 150 to 210 V (TRC-1). Pair `number` of them; 2501 pairs
/// follow each other before one comes back.
fn limits(number: u32) -> [u8; 4] {
    let (high, low) = (230 + number % 41, 150 + number % 61);
    [(high >> 8) as u8, high as u8, (low >> 8) as u8, low as u8]
}

fn write_limits(number: u32) -> Vec<u8> {
    framed(&[&[4, 16, 0, 6, 0, 2, 4], &limits(number)[..]].concat())
}

fn read_limits<T: std::io::Read + std::io::Write + std::os::fd::AsFd>(client: &mut Client<T>) -> [u8; 4] {
    client.send(&framed(&[4, 3, 0, 6, 0, 2]));
    let reply = client.receive(9, PATIENCE);
    assert_eq!(reply[..3], [4, 3, 4]);
    reply[3..7].try_into().unwrap()
}

/// What functions 06 and 16 answer when a write cannot be kept.
const NOT_KEPT: [u8; 3] = [4, 0x90, 4];

#[test]
fn bus_19_kill_9_at_any_moment_loses_no_acknowledged_write() {
    let folder = folder();
    let end = Instant::now() + Duration::from_secs(60);
    let mut seed = 1_u32;
    let mut dice = |sides: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) % sides
    };
    let (mut acknowledged, mut in_flight) = (None, None);
    let mut rounds = 0;
    while rounds < 300 && Instant::now() < end {
        let mut program = start(&folder);
        let mut client = open(&program.line());
        let found = read_limits(&mut client);
        if let Some(acknowledged) = acknowledged {
            let in_flight = in_flight.map(limits);
            assert!(
                found == limits(acknowledged) || Some(found) == in_flight,
                "round {rounds}: {found:?} is neither the last that was acknowledged ({:?}) nor the one after ({in_flight:?})",
                limits(acknowledged)
            );
        }
        // What is there now is what counts from here on.
        let mut number = (0..2501).find(|number| limits(*number) == found).unwrap_or(0);
        acknowledged = Some(number).filter(|number| limits(*number) == found);
        let delay = Duration::from_micros(u64::from(dice(30_000)));
        let pid = program.pid();
        let killer = thread::spawn(move || {
            thread::sleep(delay);
            nix::sys::signal::kill(pid, Signal::SIGKILL).unwrap();
        });
        loop {
            number = (number + 1) % 2501;
            in_flight = Some(number);
            // The pty of a killed program is hung up: it takes nothing more, and gives nothing.
            if std::io::Write::write(&mut client.port, &write_limits(number)).is_err() {
                break;
            }
            let Some(reply) = client.reply_or_end(8) else { break };
            assert_eq!(reply, framed(&[4, 16, 0, 6, 0, 2]));
            acknowledged = Some(number);
        }
        killer.join().unwrap();
        program.ended();
        rounds += 1;
    }
    assert!(rounds >= 50, "{rounds} rounds in a minute tell too little");
}

#[test]
fn bus_19_a_write_that_cannot_be_kept_is_answered_04_and_not_done() {
    let folder = folder();
    let mut program = start(&folder);
    let mut client = open(&program.line());
    let write = |client: &mut Client<fs::File>, number: u32, reply: &[u8]| {
        client.send(&write_limits(number));
        client.expect_frame(reply);
    };
    write(&mut client, 1, &[4, 16, 0, 6, 0, 2]);
    let before = fs::read(image(&folder)).unwrap();
    let limit = |size: &str| {
        let status =
            Command::new("prlimit").arg(format!("--pid={}", program.pid())).arg(format!("--fsize={size}")).status();
        assert!(status.expect("util-linux is installed").success());
    };
    limit("64:unlimited");
    write(&mut client, 2, &NOT_KEPT);
    assert_eq!(read_limits(&mut client), limits(1), "nothing is lost and nothing is done");
    client.expect(&[4, 6, 0, 10, 0, 45], &[4, 0x86, 4]);
    program.logs("the memory of charger cannot be kept");
    assert_eq!(fs::read(image(&folder)).unwrap(), before);
    limit("unlimited:unlimited");
    write(&mut client, 3, &[4, 16, 0, 6, 0, 2]);
    program.signal(Signal::SIGKILL);
    program.ended();
    assert_eq!(read_limits(&mut open(&start(&folder).line())), limits(3));
}

#[test]
fn bus_19_a_folder_that_takes_nothing_is_a_failed_write() {
    let folder = folder();
    let program = start(&folder);
    let mut client = open(&program.line());
    client.expect(&[4, 16, 0, 6, 0, 2, 4, 0, 235, 0, 155], &[4, 16, 0, 6, 0, 2]);
    // What the image would be written to first is taken. Taking away the right to write would not stop root.
    let taken = folder.path().join("state/charger.json.new");
    fs::create_dir(&taken).unwrap();
    client.expect(&[4, 16, 0, 6, 0, 2, 4, 0, 240, 0, 160], &NOT_KEPT);
    assert_eq!(read_limits(&mut client), [0, 235, 0, 155]);
    fs::remove_dir(&taken).unwrap();
    client.expect(&[4, 16, 0, 6, 0, 2, 4, 0, 240, 0, 160], &[4, 16, 0, 6, 0, 2]);
    // A folder that is gone, the same.
    fs::rename(folder.path().join("state"), folder.path().join("gone")).unwrap();
    client.expect(&[4, 16, 0, 6, 0, 2, 4, 0, 245, 0, 165], &NOT_KEPT);
    fs::rename(folder.path().join("gone"), folder.path().join("state")).unwrap();
    client.expect(&[4, 16, 0, 6, 0, 2, 4, 0, 245, 0, 165], &[4, 16, 0, 6, 0, 2]);
}

#[test]
fn bus_19_the_image_is_on_disk_before_the_reply() {
    let folder = folder();
    let program = start(&folder);
    let mut client = open(&program.line());
    for high in 231..=260 {
        client.expect(&[4, 6, 0, 6, (high >> 8) as u8, high as u8], &[4, 6, 0, 6, (high >> 8) as u8, high as u8]);
        let text = fs::read_to_string(image(&folder)).unwrap();
        assert!(text.contains(&format!("\"ac_high_limit\": {high}")), "readable, and there: {text}");
    }
    assert!(!folder.path().join("state/charger.json.new").exists());
}

#[test]
fn bus_19_a_state_folder_belongs_to_one_program() {
    let first = start(&folder());
    let (status, says) = refused(first.folder.path(), &charger_on_pty("").replace("line1", "line2"), &STATE);
    assert_eq!(status, 1, "{says}");
    assert!(says.contains("in use by another standin"), "{says}");
    let reset = memory(first.folder.path(), &["reset", "charger"]);
    assert!(reset.contains("in use by another standin"), "{reset}");
    open(&first.line()).expect_answer();
    // Looking does no harm.
    assert!(memory(first.folder.path(), &["list"]).contains("charger: logiccon-trc, unit 4"));
    assert!(memory(first.folder.path(), &["show", "charger"]).contains("\"ac_high_limit\": 250"));
}

#[test]
fn bus_19_a_folder_that_cannot_be_written_stops_the_start() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    for state in ["{dir}/file", "{dir}/file/state", "/proc/standin"] {
        let (status, says) = refused(folder.path(), &charger_on_pty(""), &["--state", state]);
        assert_eq!(status, 1, "{state}: {says}");
        assert!(says.contains("state folder"), "{state}: {says}");
    }
}

fn memory(folder: &Path, args: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_standin"));
    let output = command.arg("memory").args(args).arg("--state").arg(folder.join("state")).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

#[test]
fn bus_20_an_image_that_cannot_be_used_stops_the_start_and_stays_as_it_is() {
    let folder = folder();
    let mut program = start(&folder);
    open(&program.line()).expect(&[4, 6, 0, 6, 0, 240], &[4, 6, 0, 6, 0, 240]);
    assert_eq!(program.end().code(), Some(0));
    let good = fs::read_to_string(image(&folder)).unwrap();
    let damaged = [
        ("cut", good[..good.len() / 2].to_owned()),
        ("empty", String::new()),
        ("foreign", "{\"colour\": \"blue\"}".into()),
        ("no text", "\u{0}\u{1}\u{2}".into()),
        ("another model's", good.replace("logiccon-trc", "hmi-volcano-ec")),
        ("of a newer version", good.replace("\"version\": 1", "\"version\": 2")),
        ("of another unit", good.replace("\"configured_unit\": 4", "\"configured_unit\": 5")),
        ("out of range", good.replace("\"baud\": 2", "\"baud\": 9")),
        ("no word", good.replace("\"ac_high_limit\": 240", "\"ac_high_limit\": 65536")),
        ("lacking a register", good.replace("    \"ac_low_limit\": 180,\n", "")),
        ("with a register too many", good.replace("\"ac_low_limit\"", "\"ac_lower_limit\"")),
    ];
    for (what, text) in damaged {
        assert_ne!(text, good, "{what}");
        fs::write(image(&folder), &text).unwrap();
        let (status, says) = refused(folder.path(), &charger_on_pty(""), &STATE);
        assert_eq!(status, 1, "{what}: {says}");
        assert!(says.contains("state/charger.json"), "{what}: it names the file: {says}");
        let remedy = format!("`standin memory reset charger --state {}`", folder.path().join("state").display());
        assert!(says.contains(&remedy), "{what}: it names the remedy: {says}");
        assert_eq!(fs::read_to_string(image(&folder)).unwrap(), text, "{what}: it is left alone");
    }
    assert!(memory(folder.path(), &["reset", "charger"]).contains("as from the factory"));
    assert!(memory(folder.path(), &["reset", "charger"]).contains("no image of charger"));
    // The TRC's factory value (TRC-1).
    open(&start(&folder).line()).expect(&[4, 3, 0, 6, 0, 1], &[4, 3, 2, 0, 250]);
}

#[test]
fn bus_20_a_changed_unit_in_devices_toml_is_refused() {
    let folder = folder();
    drop(start(&folder));
    let moved = charger_on_pty("").replace("unit = 4", "unit = 7");
    let (status, says) = refused(folder.path(), &moved, &STATE);
    assert_eq!(status, 1, "{says}");
    assert!(says.contains("unit 4") && says.contains("unit 7") && says.contains("memory reset charger"), "{says}");
}

#[test]
fn bus_22_start_values_are_laid_down_once_and_the_image_wins() {
    let folder = folder();
    let config = charger_on_pty("") + "registers = { ac_high_limit = 240, ac_low_limit = 190 }\n";
    let start = || Program::start_in(folder.clone(), &config, &STATE);
    let mut program = start();
    let mut client = open(&program.line());
    client.expect(&[4, 3, 0, 6, 0, 2], &[4, 3, 4, 0, 240, 0, 190]);
    client.expect(&[4, 6, 0, 6, 0, 245], &[4, 6, 0, 6, 0, 245]);
    assert_eq!(program.end().code(), Some(0));
    open(&start().line()).expect(&[4, 3, 0, 6, 0, 2], &[4, 3, 4, 0, 245, 0, 190]);
}

#[test]
fn bus_14_where_image_and_devices_toml_differ_the_image_wins_and_the_program_says_so() {
    let folder = folder();
    let mut program = start(&folder);
    // Unit 9: the reply still comes from unit 4 (BUS-13).
    open(&program.line()).expect(&[4, 6, 0, 0, 0, 9], &[4, 6, 0, 0, 0, 9]);
    assert_eq!(program.end().code(), Some(0));
    let program = start(&folder);
    program.logs("unit 9");
    assert_eq!(program.report["buses"][0]["devices"][0]["unit"], 9);
    open(&program.line()).expect(&[9, 3, 0, 5, 0, 2], &[9, 3, 4, 0, 0xBE, 0, 0xFA]);
}

#[test]
fn bus_22_a_clock_that_was_set_is_kept_as_a_difference() {
    let folder = folder();
    let config = "[clock]\nstart = \"2014-10-27T14:22:08\"\nrate = 0\n[[bus]]\nname = \"line1\"\nport = \"pty:{dir}/line1\"\n\
                  [[bus.device]]\nname = \"astro\"\nmodel = \"kael-astro-01\"\nunit = 1\n";
    let start = |at: &str| Program::start_in(folder.clone(), &config.replace("2014-10-27T14:22:08", at), &STATE);
    let mut program = start("2014-10-27T14:22:08");
    let mut client = open(&program.line());
    // A day, an hour, a minute and a second ahead of the simulation.
    client.expect(&[1, 16, 0, 16, 0, 6, 12, 0, 14, 0, 10, 0, 28, 0, 15, 0, 23, 0, 9], &[1, 16, 0, 16, 0, 6]);
    assert_eq!(program.end().code(), Some(0));
    let mut program = start("2014-10-27T14:22:08");
    open(&program.line()).expect(&[1, 3, 0, 16, 0, 6], &[1, 3, 12, 0, 14, 0, 10, 0, 28, 0, 15, 0, 23, 0, 9]);
    assert_eq!(program.end().code(), Some(0));
    open(&start("2020-02-28T00:00:00").line())
        .expect(&[1, 3, 0, 16, 0, 6], &[1, 3, 12, 0, 20, 0, 2, 0, 29, 0, 1, 0, 1, 0, 1]);
}
