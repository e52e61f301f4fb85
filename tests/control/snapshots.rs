//! Keeping and bringing back (`/api/snapshots`, `/api/reset`).

use std::time::{Duration, Instant};

use serde_json::json;

use crate::program::{BENCH, Line, Program};

/// What the wire shows of all devices: every holding register that the tests below move, and more.
fn everything(line: &mut Line) -> Vec<Vec<u8>> {
    let asks: [[u8; 6]; 9] = [
        [1, 3, 0, 0x10, 0, 7],
        [1, 3, 0, 0x20, 0, 8],
        [1, 3, 0, 0x30, 0, 12],
        [5, 1, 0, 0, 0, 11],
        [5, 3, 0, 0, 0, 12],
        [5, 4, 0, 0, 0, 10],
        [7, 1, 0, 0, 0, 7],
        [7, 3, 0, 0, 0, 41],
        [7, 4, 0, 0, 0, 2],
    ];
    asks.iter().map(|ask| line.ask(ask)).collect()
}

fn disturb(program: &Program) {
    program.patch("/api/devices/yard/registers", json!({"rtc_hour": 4, "summer_hour": 1})).ok();
    program.patch("/api/devices/charger/inputs", json!({"ac_voltage": 0, "load_current": 7})).ok();
    program.patch("/api/devices/heater/registers", json!({"temp_unit": 1, "zone_mode": 1})).ok();
    program.patch("/api/clock", json!({"advance_s": 40_000})).ok();
    program.post("/api/devices/yard/power", json!({"on": false})).ok();
    program.post("/api/faults", json!({"kind": "drop", "bus": "line1", "device": "heater"})).ok();
}

#[test]
fn ctl_snapshots_bring_everything_back() {
    let program = Program::bench();
    let mut line = program.line("line1");
    program.patch("/api/devices/charger/inputs", json!({"ac_voltage": 0, "load_current": 5})).ok();
    program.patch("/api/clock", json!({"advance_s": 7777.5})).ok();
    program.post("/api/faults", json!({"kind": "delay", "ms": 1, "bus": "line1", "count": 100})).ok();
    let kept = program.post("/api/snapshots/before", json!(null));
    assert_eq!(kept.status, 201);
    assert_eq!(kept.ok()["now"], "2014-10-31T17:09:37.500");
    let before = everything(&mut line);
    let devices = program.get("/api/devices").ok();
    disturb(&program);
    let clock = program.post("/api/snapshots/before/restore", json!(null)).ok();
    assert_eq!(clock["now"], "2014-10-31T17:09:37.500");
    assert_eq!(program.get("/api/devices").ok(), devices, "inputs, registers, power");
    let faults = program.get("/api/faults").ok();
    assert_eq!((faults.as_array().unwrap().len(), &faults[0]["hits"]), (1, &json!(0)));
    assert_eq!(everything(&mut line), before);
    // What follows is the same too, also through time.
    let next = |line: &mut Line| {
        program.patch("/api/clock", json!({"advance_s": 3600})).ok();
        everything(line)
    };
    let first = next(&mut line);
    program.post("/api/snapshots/before/restore", json!(null)).ok();
    assert_eq!(next(&mut line), first);
}

#[test]
fn ctl_snapshots_are_listed_replaced_and_forgotten() {
    let program = Program::bench();
    assert_eq!(program.get("/api/snapshots").ok(), json!([]));
    program.post("/api/snapshots/b.1", json!(null)).ok();
    program.patch("/api/clock", json!({"advance_s": 60})).ok();
    program.post("/api/snapshots/a-2", json!(null)).ok();
    let all = program.get("/api/snapshots").ok();
    let names: Vec<&str> = all.as_array().unwrap().iter().map(|each| each["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["a-2", "b.1"]);
    assert_eq!(all[1]["now"], "2014-10-31T15:00:00");
    program.post("/api/snapshots/b.1", json!(null)).ok();
    assert_eq!(program.get("/api/snapshots/b.1").ok()["now"], "2014-10-31T15:01:00");
    assert_eq!(program.delete("/api/snapshots/b.1").status, 204);
    let message = program.post("/api/snapshots/b.1/restore", json!(null)).refused(404, "not_found", None);
    assert!(message.contains("a-2"), "{message}");
    program.delete("/api/snapshots/b.1").refused(404, "not_found", None);
    program.post("/api/snapshots/a%20b", json!(null)).refused(422, "bad_value", Some("name"));
    for number in 1..64 {
        program.post(&format!("/api/snapshots/s{number}"), json!(null)).ok();
    }
    program.post("/api/snapshots/one-more", json!(null)).refused(409, "wrong_state", None);
}

#[test]
fn ctl_reset_goes_back_to_the_start() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let start = program.get("/api/devices").ok();
    let first = everything(&mut line);
    disturb(&program);
    program.patch("/api/clock", json!({"rate": 5000})).ok();
    let clock = program.post("/api/reset", json!(null)).ok();
    assert_eq!((&clock["now"], &clock["rate"]), (&json!("2014-10-31T15:00:00"), &json!(0.0)));
    assert_eq!(program.get("/api/devices").ok(), start);
    assert_eq!(program.get("/api/faults").ok(), json!([]));
    assert_eq!(program.get("/api/journal").ok(), json!([]));
    assert_eq!(program.get("/api/status").ok()["buses"][0]["counters"]["frames"], 0);
    assert_eq!(everything(&mut line), first);
    let fault = program.post("/api/faults", json!({"kind": "drop", "bus": "line1"})).ok();
    assert_eq!(fault["id"], 1, "numbers start anew, so seeds do");
}

#[test]
fn ctl_reset_is_fit_for_use_between_tests() {
    let program = Program::bench();
    disturb(&program);
    let mut times: Vec<Duration> = (0..40)
        .map(|_| {
            let asked = Instant::now();
            program.post("/api/reset", json!(null)).ok();
            asked.elapsed()
        })
        .collect();
    times.sort_unstable();
    // Under 5 ms on a machine that does nothing else; the fastest quarter is nearly such a machine.
    assert!(times[10] < Duration::from_millis(5), "{times:?}");
}

#[test]
fn ctl_reset_takes_memory_on_disk_back_too() {
    let toml = format!("state = \"{{dir}}/state\"\n{BENCH}");
    let mut program = Program::start(&toml);
    program.patch("/api/devices/charger/registers", json!({"fan_on_temperature": 55})).ok();
    program.post("/api/reset", json!(null)).ok();
    assert_eq!(program.line("line1").read(5, 10, 1), [40]);
    assert!(program.stop().success());
    let images: Vec<String> = std::fs::read_dir(program.folder.path().join("state"))
        .unwrap()
        .filter_map(|entry| std::fs::read_to_string(entry.unwrap().path()).ok())
        .filter(|text| text.contains("fan_on_temperature"))
        .collect();
    assert_eq!(images.len(), 1);
    assert!(images[0].replace(' ', "").contains("\"fan_on_temperature\":40"), "{}", images[0]);
}
