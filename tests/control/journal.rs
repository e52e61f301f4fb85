//! The journal and its hints (`/api/journal`).

use serde_json::{Value, json};

use crate::program::{BENCH, Line, Program};

fn last(program: &Program) -> Value {
    program.get("/api/journal?limit=1").ok()[0].clone()
}

#[test]
fn ctl_journal_tells_what_was_asked_and_what_came_of_it() {
    let program = Program::bench();
    let mut line = program.line("line1");
    line.read(5, 10, 2);
    let read = last(&program);
    let wanted = [
        ("id", json!(1)),
        ("bus", json!("line1")),
        ("now", json!("2014-10-31T15:00:00")),
        ("unit", json!(5)),
        ("device", json!("charger")),
        ("function", json!(3)),
        ("function_name", json!("read holding registers")),
        ("address", json!(10)),
        ("quantity", json!(2)),
        ("values", json!([40, 30])),
        ("outcome", json!("reply")),
        ("code", Value::Null),
        ("reason", Value::Null),
        ("request", json!("05 03 00 0A 00 02")),
        ("reply", json!("05 03 04 00 28 00 1E")),
        ("sent", Value::Null),
        ("faults", json!([])),
        ("hint", Value::Null),
    ];
    for (field, value) in wanted {
        assert_eq!(read[field], value, "{field} of {read}");
    }
    assert!(read["reply_ms"].as_f64().is_some_and(|ms| (0.0..1000.0).contains(&ms)), "{read}");
    assert!(read["elapsed_s"].as_f64().is_some_and(|s| s > 0.0), "{read}");

    line.ask(&[5, 6, 0, 10, 0, 61]);
    let refused = last(&program);
    assert_eq!((&refused["outcome"], &refused["code"]), (&json!("exception"), &json!(3)));
    assert_eq!(refused["values"], json!([61]));
    assert!(refused["reason"].as_str().unwrap().contains("20 to 60"), "{refused}");
    assert!(refused["clause"].as_str().unwrap().contains("TRC-"), "{refused}");

    for (sent, told) in [(0xFF00_u16, 1), (0, 0), (0x1234, 0x1234)] {
        let [high, low] = sent.to_be_bytes();
        line.ask(&[7, 5, 0, 4, high, low]);
        assert_eq!(last(&program)["values"], json!([told]), "a coil is told as on or off, nonsense as it was sent");
    }

    assert!(line.is_deaf(&[0, 6, 0, 10, 0, 50]));
    let broadcast = last(&program);
    assert_eq!((&broadcast["outcome"], &broadcast["device"]), (&json!("silence"), &Value::Null));
    assert!(broadcast["reason"].as_str().unwrap().contains("BUS-3"));
    assert_eq!((&broadcast["reply"], &broadcast["reply_ms"]), (&json!(""), &Value::Null));

    program.post("/api/devices/charger/power", json!({"on": false})).ok();
    assert!(line.is_deaf(&[5, 3, 0, 10, 0, 1]));
    let dark = last(&program);
    assert_eq!(dark["device"], "charger");
    assert!(dark["reason"].as_str().unwrap().contains("off"), "{dark}");
}

#[test]
fn ctl_journal_tells_of_faults() {
    let program = Program::bench();
    program.post("/api/faults", json!({"kind": "truncate", "bytes": 1, "bus": "line1"})).ok();
    let mut line = program.line("line1");
    line.send(&[5, 3, 0, 10, 0, 1]);
    let heard = line.hear(std::time::Duration::from_secs(2));
    let entry = last(&program);
    assert_eq!(entry["faults"], json!([{"id": 1, "kind": "truncate"}]));
    assert_eq!(entry["reply"], "05 03 02 00 28", "what the device has said");
    let hex = heard.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
    assert_eq!(entry["sent"], hex, "what has left");
}

#[test]
fn ctl_journal_is_filtered_counted_and_emptied() {
    let program = Program::bench();
    let mut line = program.line("line1");
    line.read(5, 0, 12);
    line.read(5, 11, 1);
    let since = program.get("/api/clock").ok()["elapsed_s"].as_f64().unwrap();
    line.ask(&[5, 6, 0, 10, 0, 61]);
    line.read(7, 10, 1);
    assert!(line.is_deaf(&[9, 3, 0, 10, 0, 1]));
    let count = |query: &str| {
        let count = program.get(&format!("/api/journal/count?{query}")).ok()["count"].as_u64().unwrap();
        let listed = program.get(&format!("/api/journal?{query}")).ok().as_array().unwrap().len() as u64;
        assert_eq!(count, listed, "{query}");
        count
    };
    assert_eq!(count(""), 5);
    assert_eq!(count("bus=line1"), 5);
    assert_eq!(count("device=charger"), 3);
    assert_eq!(count("function=3"), 4);
    assert_eq!(count("outcome=reply"), 3);
    assert_eq!(count("outcome=exception"), 1);
    assert_eq!(count("outcome=silence"), 1);
    assert_eq!(count("address=11"), 2, "0 to 11 touches it, and so does 11");
    assert_eq!(count(&format!("since={since}")), 3);
    assert_eq!(count("device=charger&function=3&address=10"), 1);
    program.get("/api/journal?device=boiler").refused(404, "not_found", Some("device"));
    program.get("/api/journal?bus=line2").refused(404, "not_found", Some("bus"));
    program.get("/api/journal?outcome=fine").refused(422, "bad_value", Some("outcome"));
    for since in ["-1", "1e10", "NaN"] {
        program.get(&format!("/api/journal?since={since}")).refused(422, "bad_value", Some("since"));
        program.get(&format!("/api/journal/count?since={since}")).refused(422, "bad_value", Some("since"));
    }
    let ids: Vec<u64> = program
        .get("/api/journal?limit=2")
        .ok()
        .as_array()
        .unwrap()
        .iter()
        .map(|e| e["id"].as_u64().unwrap())
        .collect();
    assert_eq!(ids, [4, 5], "the last two, the older first");
    assert_eq!(program.delete("/api/journal").status, 204);
    assert_eq!(count(""), 0);
    line.read(7, 10, 1);
    assert_eq!(last(&program)["id"], 6, "numbers go on");
}

#[test]
fn ctl_journal_keeps_the_last_10_000() {
    let program = Program::bench();
    let mut line = program.line("line1");
    for _ in 0..10_003 {
        line.read(5, 10, 1);
    }
    assert_eq!(program.get("/api/journal/count").ok()["count"], 10_000);
    assert_eq!(program.get("/api/journal").ok()[0]["id"], 4);
}

/// Asks, and gives the hint that the journal has for it.
fn hint_of(program: &Program, line: &mut Line, request: &[u8]) -> String {
    line.send(request);
    line.hear(std::time::Duration::from_millis(300));
    let entry = last(program);
    entry["hint"].as_str().unwrap_or_else(|| panic!("no hint: {entry}")).to_owned()
}

#[test]
fn ctl_journal_hints_at_common_mistakes() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let mut hint = |request: &[u8]| hint_of(&program, &mut line, request);
    // Holding registers of the TRC end with 11: 12 is its number counted from 1.
    let off_by_one = hint(&[5, 3, 0, 12, 0, 1]);
    assert!(off_by_one.contains("holding 11 (fan_off_temperature)"), "{off_by_one}");
    // 40011 is 0x9C4B; 30003 is 0x7533.
    let numbering = hint(&[5, 3, 0x9C, 0x4B, 0, 1]);
    assert!(numbering.contains("holding register 10 (fan_on_temperature)"), "{numbering}");
    let numbering = hint(&[5, 4, 0x75, 0x33, 0, 2]);
    assert!(numbering.contains("input register 2 (output_voltage)"), "{numbering}");
    // The Volcano has input registers 0 and 1, and holding registers 0 to 40.
    let other = hint(&[7, 4, 0, 23, 0, 1]);
    assert!(other.contains("zone_temperature_target") && other.contains("function 03"), "{other}");
    // The Volcano has discrete inputs 0 and 1, the TRC none.
    let other = hint(&[5, 2, 0, 1, 0, 1]);
    assert!(other.contains("relay2_fan") && other.contains("function 01"), "{other}");
    let unit = hint(&[9, 3, 0, 10, 0, 1]);
    assert!(unit.contains("yard is 1, charger is 5, heater is 7"), "{unit}");
    let many = hint(&[7, 3, 0, 0, 0, 126]);
    assert!(many.contains("126") && many.contains("at most"), "{many}");
    // 25.0 is 0x41C80000 as a float.
    let float = hint(&[7, 16, 0, 23, 0, 2, 4, 0x41, 0xC8, 0, 0]);
    assert!(float.contains("float 25") && float.contains("high word first"), "{float}");
    let float = hint(&[7, 16, 0, 23, 0, 2, 4, 0, 0, 0x41, 0xC8]);
    assert!(float.contains("float 25") && float.contains("low word first"), "{float}");
    let half = hint(&[5, 4, 0, 2, 0, 1]);
    assert!(half.contains("output_voltage takes two registers, 2 and 3"), "{half}");
}

#[test]
fn ctl_journal_knows_tables_that_begin_at_1() {
    let panel = "[[bus.device]]\nname = \"panel\"\nmodel = \"logiccon-pfc24s-tcr\"\nunit = 2\n";
    let program = Program::start(&format!("{BENCH}{panel}"));
    let mut line = program.line("line1");
    // 40001 is 0x9C41; the PFC has no holding register 0, and its last is 249.
    let first = hint_of(&program, &mut line, &[2, 3, 0x9C, 0x41, 0, 8]);
    assert!(first.contains("the first is holding register 1 (step_1_type)"), "{first}");
    let second = hint_of(&program, &mut line, &[2, 3, 0x9C, 0x42, 0, 8]);
    assert!(second.contains("on the wire it is holding register 1 (step_1_type)"), "{second}");
}

#[test]
fn ctl_journal_hints_at_nothing_where_nothing_is_wrong() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let mut has_hint = |request: &[u8]| {
        line.send(request);
        line.hear(std::time::Duration::from_millis(300));
        !last(&program)["hint"].is_null()
    };
    assert!(!has_hint(&[5, 3, 0, 10, 0, 1]));
    assert!(!has_hint(&[5, 4, 0, 2, 0, 2]));
    assert!(!has_hint(&[5, 6, 0, 10, 0, 61]), "a value out of range has its reason");
    assert!(!has_hint(&[0, 6, 0, 10, 0, 50]), "a broadcast");
    assert!(!has_hint(&[5, 3, 0, 200, 0, 1]), "nothing is near");
    program.post("/api/faults", json!({"kind": "exception", "code": 2, "bus": "line1"})).ok();
    assert!(!has_hint(&[5, 3, 0, 12, 0, 1]), "a fault has answered");
}
