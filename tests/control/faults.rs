//! Faults over HTTP (`/api/faults`); what each does to the bytes is in `tests/faults.rs`.

use std::time::Duration;

use serde_json::{Value, json};
use standin::wire::append_crc;

use crate::program::{Line, Program};

fn add(program: &Program, plan: Value) -> Value {
    let mut all = json!({"bus": "line1"});
    all.as_object_mut().unwrap().extend(plan.as_object().unwrap().clone());
    let answer = program.post("/api/faults", all);
    assert_eq!(answer.status, 201, "{}", answer.text);
    answer.ok()
}

/// Reads the charger's register 10 (40), and gives all bytes that come back.
fn bytes(line: &mut Line) -> Vec<u8> {
    line.send(&[5, 3, 0, 10, 0, 1]);
    line.hear(Duration::from_millis(400))
}

fn good() -> Vec<u8> {
    let mut frame = vec![5, 3, 2, 0, 40];
    append_crc(&mut frame);
    frame
}

#[test]
fn ctl_faults_every_kind_does_its_work() {
    let program = Program::bench();
    let mut line = program.line("line1");
    assert_eq!(bytes(&mut line), good());
    let mut only = |plan: Value| {
        let fault = add(&program, plan);
        let got = bytes(&mut line);
        let gone = program.delete(&format!("/api/faults/{}", fault["id"])).ok();
        assert_eq!(gone["hits"], 1, "{gone}");
        got
    };
    assert!(only(json!({"kind": "drop"})).is_empty());
    assert_eq!(only(json!({"kind": "delay", "ms": 100, "jitter_ms": 50})), good());
    assert_eq!(only(json!({"kind": "exception", "code": 11}))[..3], [5, 0x83, 11]);
    let bad = only(json!({"kind": "bad_crc"}));
    assert!(bad.len() == 7 && bad[..5] == good()[..5] && bad != good());
    assert_eq!(only(json!({"kind": "truncate", "bytes": 2})), good()[..5]);
    assert_eq!(only(json!({"kind": "garbage", "bytes": 3}))[3..], good());
    assert_eq!(only(json!({"kind": "garbage", "bytes": 3, "place": "after"}))[..7], good());
    assert_eq!(only(json!({"kind": "wrong_unit"}))[0], 6);
    assert_eq!(only(json!({"kind": "wrong_function"}))[1], 4);
    assert_eq!(only(json!({"kind": "split", "at": 2, "gap_ms": 10})), good());
    assert_eq!(only(json!({"kind": "stale"}))[..2], [5, 3]);
    assert_eq!(only(json!({"kind": "echo"}))[..6], [5, 3, 0, 10, 0, 1]);
    assert!(only(json!({"kind": "offline"})).is_empty());
    let stuck = json!({"kind": "stuck_register", "device": "charger", "name": "fan_on_temperature", "value": 55});
    assert_eq!(only(stuck)[3..5], [0, 55]);
    assert_eq!(bytes(&mut line), good(), "nothing is left of them");
    add(&program, json!({"kind": "noise", "per_minute": 6000}));
    assert!(!line.hear(Duration::from_secs(5)).is_empty());
}

#[test]
fn ctl_faults_are_listed_counted_and_taken_away() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let plan = json!({
        "kind": "delay", "ms": 1, "jitter_ms": 2, "device": "charger", "functions": [3], "addresses": [[0, 10]],
        "probability": 0.5, "count": 5, "for_s": 60, "seed": 7
    });
    let added = add(&program, plan.clone());
    for (field, value) in plan.as_object().unwrap() {
        assert!(added[field] == *value || added[field].as_f64() == value.as_f64(), "{field}: {added}");
    }
    assert_eq!((&added["id"], &added["active"], &added["hits"]), (&json!(1), &json!(true), &json!(0)));
    let once = add(&program, json!({"kind": "drop", "count": 1}));
    assert_eq!(once["seed"], once["id"], "a seed of its own");
    assert!(bytes(&mut line).is_empty());
    let spent = program.get("/api/faults/2").ok();
    assert_eq!((&spent["active"], &spent["hits"]), (&json!(false), &json!(1)));
    let all = program.get("/api/faults").ok();
    assert_eq!(all.as_array().unwrap().len(), 2);
    assert_eq!(all[1], spent);
    assert_eq!(program.delete("/api/faults/1").ok()["id"], 1);
    program.delete("/api/faults/1").refused(404, "not_found", None);
    assert_eq!(program.delete("/api/faults").status, 204);
    assert_eq!(program.get("/api/faults").ok(), json!([]));
}

#[test]
fn ctl_faults_judge_their_fields() {
    let program = Program::bench();
    let refused = |plan: Value, field: &str| {
        let mut all = json!({"bus": "line1"});
        all.as_object_mut().unwrap().extend(plan.as_object().unwrap().clone());
        program.post("/api/faults", all).refused(422, "bad_value", Some(field))
    };
    assert!(refused(json!({"kind": "dorp"}), "kind").contains("drop"));
    refused(json!({"kind": "delay"}), "ms");
    refused(json!({"kind": "delay", "ms": 600_001}), "ms");
    refused(json!({"kind": "delay", "ms": -1}), "ms");
    refused(json!({"kind": "drop", "ms": 1}), "ms");
    refused(json!({"kind": "exception", "code": 0}), "code");
    refused(json!({"kind": "truncate", "bytes": 0}), "bytes");
    refused(json!({"kind": "garbage", "bytes": 1, "place": "inside"}), "place");
    refused(json!({"kind": "split", "at": 1}), "gap_ms");
    refused(json!({"kind": "noise", "per_minute": 0}), "per_minute");
    refused(json!({"kind": "noise", "per_minute": 1, "device": "charger"}), "device");
    refused(json!({"kind": "offline", "functions": [3]}), "device");
    refused(json!({"kind": "drop", "functions": [0]}), "functions");
    refused(json!({"kind": "drop", "addresses": [[5, 4]]}), "addresses");
    refused(json!({"kind": "drop", "probability": 1.5}), "probability");
    refused(json!({"kind": "drop", "count": 0}), "count");
    refused(json!({"kind": "stuck_register", "name": "unit", "value": 1}), "device");
    let stuck = json!({"kind": "stuck_register", "device": "charger", "name": "units", "value": 1});
    assert!(refused(stuck, "name").contains("unit"));
    refused(json!({"kind": "stuck_register", "device": "charger", "name": "unit", "value": 65536}), "value");
    let other = json!({"kind": "drop", "bus": "line1", "device": "boiler"});
    assert!(program.post("/api/faults", other).refused(404, "not_found", Some("device")).contains("charger"));
    program.post("/api/faults", json!({"kind": "drop"})).refused(422, "bad_value", Some("bus"));
    assert_eq!(program.get("/api/faults").ok(), json!([]));
}

#[test]
fn ctl_faults_repeat_exactly_with_their_seed() {
    let program = Program::bench();
    let run = || {
        program.post("/api/reset", json!(null)).ok();
        add(&program, json!({"kind": "garbage", "bytes": 5, "probability": 0.5, "seed": 99}));
        add(&program, json!({"kind": "bad_crc", "probability": 0.3}));
        let mut line = program.line("line1");
        (0..12).map(|_| bytes(&mut line)).collect::<Vec<_>>()
    };
    let first = run();
    assert!(first.iter().any(|bytes| *bytes != good()) && first.contains(&good()), "{first:02X?}");
    assert_eq!(run(), first);
}
