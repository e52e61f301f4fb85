//! Simulated time (`/api/clock`), and the buses while it moves.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::program::{BENCH, Program};

/// The Astro's clock, holding registers 0x10 to 0x15: year, month, day, hour, minute, second.
fn yard_clock(program: &Program) -> Vec<u16> {
    program.line("line1").read(1, 0x10, 6)
}

#[test]
fn ctl_clock_shows_time_and_rate() {
    let program = Program::bench();
    let clock = program.get("/api/clock").ok();
    assert_eq!((&clock["now"], &clock["rate"]), (&json!("2014-10-31T15:00:00"), &json!(0.0)));
    let status = program.get("/api/status").ok();
    assert_eq!(status["clock"]["now"], clock["now"]);
    let (first, then) = (clock["elapsed_s"].as_f64().unwrap(), status["elapsed_s"].as_f64().unwrap());
    assert!(0.0 < first && first <= then, "{first} {then}");
}

#[test]
fn ctl_clock_advance_happens_whole_and_until_gets_there() {
    let program = Program::bench();
    // Nine hours later it is midnight: the Astro's date has moved on.
    let clock = program.patch("/api/clock", json!({"advance_s": 9 * 3600 + 30})).ok();
    assert_eq!(clock["now"], "2014-11-01T00:00:30");
    assert_eq!(yard_clock(&program), [14, 11, 1, 0, 0, 30]);
    let clock = program.patch("/api/clock", json!({"until": "2014-11-01T06:30"})).ok();
    assert_eq!(clock["now"], "2014-11-01T06:30:00");
    assert_eq!(yard_clock(&program), [14, 11, 1, 6, 30, 0]);
    // What lies in between happens: a battery without mains runs down (TRC-10).
    program.patch("/api/devices/charger/inputs", json!({"ac_voltage": 0, "load_current": 5})).ok();
    let volts = |program: &Program| program.line("line1").read_by(4, 5, 2, 2)[1];
    let before = volts(&program);
    program.patch("/api/clock", json!({"advance_s": 3600})).ok();
    assert!(volts(&program) < before, "{} {before}", volts(&program));
}

#[test]
fn bus_19_what_moved_in_an_advance_is_on_disk_when_it_is_done() {
    let program = Program::start(&format!("state = \"{{dir}}/state\"\n{BENCH}"));
    let charge = || {
        let image = std::fs::read_to_string(program.folder.path().join("state/charger.json")).unwrap();
        serde_json::from_str::<Value>(&image).unwrap()["device"]["battery_charge"].as_f64().unwrap()
    };
    program.patch("/api/devices/charger/inputs", json!({"ac_voltage": 0, "load_current": 0.7})).ok();
    program.patch("/api/clock", json!({"advance_s": 3600})).ok();
    // An hour of 0.7 A is a tenth of the 7 Ah of a battery that had nine (TRC-10, TRC-11).
    assert!((charge() - 0.8).abs() < 0.001, "{}", charge());
}

#[test]
fn ctl_clock_jump_leaves_out_what_lies_between() {
    let program = Program::bench();
    program.patch("/api/devices/charger/inputs", json!({"ac_voltage": 0, "load_current": 5})).ok();
    let mut line = program.line("line1");
    let before = line.read_by(4, 5, 2, 2);
    let clock = program.patch("/api/clock", json!({"now": "2020-02-29T12:00:00"})).ok();
    assert_eq!(clock["now"], "2020-02-29T12:00:00");
    assert_eq!(line.read_by(4, 5, 2, 2), before, "no second has passed for the battery");
    assert_eq!(program.patch("/api/clock", json!({"now": "2014-10-31T15:00:00"})).ok()["now"], "2014-10-31T15:00:00");
}

#[test]
fn ctl_clock_rate_runs_and_0_stops() {
    let program = Program::bench();
    program.patch("/api/clock", json!({"rate": 3600})).ok();
    thread::sleep(Duration::from_millis(500));
    let stopped = program.patch("/api/clock", json!({"rate": 0})).ok();
    let now: chrono::NaiveDateTime = stopped["now"].as_str().unwrap().parse().unwrap();
    let start: chrono::NaiveDateTime = "2014-10-31T15:00:00".parse().unwrap();
    let minutes = (now - start).num_minutes();
    assert!(minutes >= 30, "{minutes} minutes in half a second at an hour a second");
    thread::sleep(Duration::from_millis(50));
    assert_eq!(program.get("/api/clock").ok()["now"], stopped["now"]);
}

#[test]
fn ctl_clock_takes_one_change_within_its_bounds() {
    let program = Program::bench();
    let refused = |body, field| program.patch("/api/clock", body).refused(422, "bad_value", field);
    refused(json!({}), None);
    refused(json!({"rate": 1, "advance_s": 1}), None);
    refused(json!({"rate": -1}), Some("rate"));
    refused(json!({"rate": 86401}), Some("rate"));
    refused(json!({"rate": "fast"}), Some("rate"));
    refused(json!({"advance_s": -1}), Some("advance_s"));
    refused(json!({"advance_s": 1e300}), Some("advance_s"));
    refused(json!({"until": "2014-10-31T14:59:59"}), Some("until"));
    refused(json!({"until": "2100-01-01T00:00:00"}), Some("until"));
    refused(json!({"now": "2014-02-30T00:00:00"}), Some("now"));
    refused(json!({"now": "1999-12-31T23:59:59"}), Some("now"));
    refused(json!({"now": "noon"}), Some("now"));
    refused(json!({"advance_s": 3_155_760_001.0}), Some("advance_s"));
    assert_eq!(program.get("/api/clock").ok()["now"], "2014-10-31T15:00:00", "nothing has moved");
}

#[test]
fn ctl_clock_astro_14_advances_out_of_the_century() {
    let program = Program::bench();
    program.patch("/api/clock", json!({"now": "2099-12-31T23:59:58"})).ok();
    program.patch("/api/clock", json!({"advance_s": 3})).ok();
    // The simulation goes on to 2100, the device's clock to Saturday 2000-01-01.
    assert_eq!(program.get("/api/clock").ok()["now"], "2100-01-01T00:00:01");
    assert_eq!(program.line("line1").read(1, 0x10, 7), [0, 1, 1, 0, 0, 1, 6]);
    program.patch("/api/clock", json!({"advance_s": 60 * 86_400})).ok();
    assert_eq!(program.line("line1").read(1, 0x10, 3), [0, 3, 1]);
    program.patch("/api/clock", json!({"now": "2014-10-31T15:00:00"})).ok();
    assert_eq!(program.line("line1").read(1, 0x10, 7), [14, 10, 31, 15, 0, 0, 5]);
}

#[test]
fn ctl_clock_is_the_same_on_all_buses() {
    let second = "[[bus]]\nname = \"line2\"\nport = \"tcp:127.0.0.1:0\"\n\
                  [[bus.device]]\nname = \"roof\"\nmodel = \"kael-astro-01\"\nunit = 1\n";
    let program = Program::start(&format!("{BENCH}{second}"));
    let both = || {
        let clocks = ["line1", "line2"].map(|bus| program.line(bus).read(1, 0x10, 6));
        assert_eq!(clocks[0], clocks[1]);
        clocks[0].clone()
    };
    // At a day a second a hundredth of a second of difference would be a quarter of an hour.
    for _ in 0..5 {
        program.patch("/api/clock", json!({"rate": 86_400})).ok();
        thread::sleep(Duration::from_millis(40));
        program.patch("/api/clock", json!({"rate": 0})).ok();
        both();
    }
    program.patch("/api/clock", json!({"advance_s": 12345})).ok();
    both();
    program.patch("/api/clock", json!({"now": "2031-07-01T01:02:03"})).ok();
    assert_eq!(both(), [31, 7, 1, 1, 2, 3]);
    program.post("/api/reset", json!(null)).ok();
    assert_eq!(both(), [14, 10, 31, 15, 0, 0]);
}

#[test]
fn ctl_clock_advance_lets_the_bus_answer_all_the_while() {
    let program = Program::bench();
    let attempt = || longest_wait_while_time_advances(&program);
    // A busy machine may keep a program waiting, too, but not time and again; without its turn behind each step a request
    // waits for dozens of them.
    let waits: Vec<Duration> = std::iter::repeat_with(attempt).take(8).collect();
    assert!(waits.iter().any(|wait| *wait < Duration::from_millis(25)), "{waits:?}");
}

/// How long the slowest reply took while a quarter of a second was full of advances.
fn longest_wait_while_time_advances(program: &Program) -> Duration {
    let (started, is_done) = (Instant::now(), AtomicBool::new(false));
    let (count, longest) = thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut line = program.line("line1");
            let (mut count, mut longest) = (0, Duration::ZERO);
            while !is_done.load(Ordering::Relaxed) {
                let asked = Instant::now();
                line.read(5, 0, 1);
                longest = longest.max(asked.elapsed());
                count += 1;
            }
            (count, longest)
        });
        while started.elapsed() < Duration::from_millis(250) {
            program.patch("/api/clock", json!({"advance_s": 90 * 86_400})).ok();
        }
        is_done.store(true, Ordering::Relaxed);
        reader.join().unwrap()
    });
    // Who was hardly answered at all has waited all the time.
    if count < 5 { started.elapsed() } else { longest }
}
