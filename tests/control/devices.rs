//! Devices, registers, inputs, power (`/api/status`, `/api/devices`).

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use crate::program::{BENCH, Program};

#[test]
fn ctl_status_shows_buses_and_counts() {
    let program = Program::bench();
    let mut line = program.line("line1");
    line.ask(&[5, 3, 0, 10, 0, 1]);
    line.ask(&[5, 3, 0, 12, 0, 1]);
    assert!(line.is_deaf(&[9, 3, 0, 10, 0, 1]));
    line.send(&[5, 3, 0, 10, 0]);
    line.hear(Duration::from_millis(300));
    let status = program.get("/api/status").ok();
    assert_eq!(status["version"], env!("CARGO_PKG_VERSION"));
    let bus = &status["buses"][0];
    assert_eq!((&bus["name"], &bus["path"]), (&json!("line1"), &program.report["buses"][0]["path"]));
    assert_eq!(bus["line"], json!({"baud": 9600, "parity": "none", "stop_bits": 2}));
    assert_eq!((&bus["timing"], &bus["line_check"]), (&json!("fast"), &json!("warn")));
    assert_eq!(bus["devices"], json!(["yard", "charger", "heater"]));
    // Good frames: register 10, register 12 (exception 02), unit 9. The last is seven bytes that are no frame.
    let counters = json!({"frames": 3, "replies": 1, "exceptions": 1, "bad_crc": 1, "dropped_bytes": 7});
    assert_eq!(bus["counters"], counters);
}

#[test]
fn ctl_devices_show_what_the_wire_shows() {
    let program = Program::bench();
    let all = program.get("/api/devices").ok();
    let names: Vec<&str> = all.as_array().unwrap().iter().map(|each| each["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["yard", "charger", "heater"]);
    let charger = program.get("/api/devices/charger").ok();
    assert_eq!(all[1], charger);
    let shown = |field: &str| charger[field].clone();
    assert_eq!((shown("model"), shown("bus"), shown("unit")), (json!("logiccon-trc"), json!("line1"), json!(5)));
    assert_eq!((shown("powered"), shown("boots")), (json!(true), json!(1)));
    assert_eq!(shown("line"), json!({"baud": 9600, "parity": "none", "stop_bits": 2}));
    assert_eq!(charger["inputs"]["ac_voltage"]["value"], 230, "engineering units (BUS-21)");
    assert_eq!(charger["inputs"]["ac_voltage"]["unit"], "V");
    // TRC-1: the charge voltage limit counts tenths of a volt, 275 from the factory; relay 2 is the fan's coil.
    assert_eq!(charger["registers"]["charge_voltage_limit"], json!({"raw": 275, "value": 27.5, "unit": "V"}));
    assert_eq!(charger["coils"]["relay2_fan"], json!({"raw": 0, "value": false, "unit": ""}));
    assert_eq!(charger["registers"].as_object().unwrap().len(), 5 + 12);
    assert_eq!(charger["coils"].as_object().unwrap().len(), 11);
}

#[test]
fn ctl_registers_list_every_row() {
    let program = Program::bench();
    let rows = program.get("/api/devices/charger/registers").ok();
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 11 + 5 + 12, "TRC-1");
    let named = |name: &str| rows.iter().find(|row| row["name"] == name).unwrap();
    let limit = named("charge_voltage_limit");
    let wanted = [
        ("bank", json!("holding")),
        ("address", json!(3)),
        ("unit", json!("V")),
        ("raw", json!(275)),
        ("value", json!(27.5)),
        ("words", json!([275])),
        ("access", json!("read-write")),
        ("range", json!("215 to 290")),
    ];
    for (field, value) in wanted {
        assert_eq!(limit[field], value, "{field}");
    }
    assert!(limit["clause"].as_str().unwrap().contains("TRC-10"));
    assert!(limit["about"].as_str().unwrap().contains("charging"));
    // Mains voltage is two words, high word first.
    assert_eq!(named("ac_voltage")["words"], json!([0, 230]));
    assert_eq!((&named("ac_voltage")["access"], &named("ac_voltage")["range"]), (&json!("read"), &json!("")));
}

#[test]
fn ctl_write_registers_goes_by_the_devices_rules() {
    let program = Program::bench();
    let mut line = program.line("line1");
    let registers = "/api/devices/yard/registers";
    // On 31 October month 2 alone is refused, with its day it is not (ASTRO-11, ASTRO-12).
    program.patch(registers, json!({"rtc_month": 2})).refused(422, "refused", Some("rtc_month"));
    assert_eq!(line.read(1, 0x10, 3), [14, 10, 31]);
    let written = program.patch(registers, json!({"rtc_month": 2, "rtc_day": 28})).ok();
    assert_eq!(written["rtc_day"], json!({"raw": 28, "value": 28, "unit": ""}));
    assert_eq!(line.read(1, 0x10, 3), [14, 2, 28]);
    // All or nothing.
    program.patch(registers, json!({"rtc_hour": 3, "rtc_minute": 60})).refused(422, "refused", None);
    assert_eq!(line.read(1, 0x13, 1), [15]);
    // A coil takes true and 1; the answer shows what a write has become: VOL-30 turns 22.00 °C into 71.50 °F.
    let heater = "/api/devices/heater/registers";
    program.patch(heater, json!({"temp_unit": true})).ok();
    assert_eq!(line.ask(&[7, 1, 0, 5, 0, 1]), [7, 1, 1, 1]);
    assert_eq!(line.read(7, 23, 1), [7150]);
    assert_eq!(program.patch(heater, json!({"temp_unit": 0})).ok()["temp_unit"]["value"], false);
    // What is only read is refused, but can be forced within its type.
    let charger = "/api/devices/charger/registers";
    let refused =
        program.patch(charger, json!({"output_voltage": 123})).refused(422, "refused", Some("output_voltage"));
    assert!(refused.contains("only read"), "{refused}");
    let forced = program.patch(&format!("{charger}?force=true"), json!({"dc_low_limit": 65535})).ok();
    assert_eq!(forced["dc_low_limit"], json!({"raw": 65535, "value": 6553.5, "unit": "V"}));
    program.patch("/api/devices/yard/registers", json!({"product_code": 1})).refused(
        422,
        "refused",
        Some("product_code"),
    );
    program.patch("/api/devices/yard/registers?force=true", json!({"product_code": 0x12345})).ok();
    assert_eq!(line.read(1, 2, 2), [1, 0x2345], "a read-only row of two words");
    assert_eq!(line.read(5, 9, 1), [65535]);
    for (name, raw) in [("dc_low_limit", 65536), ("dc_low_limit", -1), ("relay2_fan", 2), ("ac_voltage", -1)] {
        let answer = program.patch(&format!("{charger}?force=true"), json!({ name: raw }));
        answer.refused(422, "bad_value", Some(name));
    }
    program.patch(charger, json!({"dc_low_limit": 21.5})).refused(422, "bad_value", Some("dc_low_limit"));
    program.patch(charger, json!({"dc_low_limit": null})).refused(422, "bad_value", Some("dc_low_limit"));
}

#[test]
fn ctl_write_registers_moves_the_unit_number_too() {
    let program = Program::bench();
    program.patch("/api/devices/charger/registers", json!({"unit": 9})).ok();
    let mut line = program.line("line1");
    assert_eq!(line.read(9, 10, 1), [40], "the new unit answers from the next request on (BUS-13)");
    assert!(line.is_deaf(&[5, 3, 0, 10, 0, 1]));
    assert_eq!(program.get("/api/devices/charger").ok()["unit"], 9);
}

#[test]
fn ctl_inputs_change_the_world_all_or_nothing() {
    let program = Program::bench();
    let inputs = "/api/devices/charger/inputs";
    let mut line = program.line("line1");
    let set = program.patch(inputs, json!({"ac_voltage": 100, "alarm_silenced": true})).ok();
    assert_eq!((&set["ac_voltage"]["value"], &set["alarm_silenced"]["value"]), (&json!(100), &json!(true)));
    program.patch("/api/clock", json!({"advance_s": 60})).ok();
    assert_eq!(line.read_by(4, 5, 0, 2), [0, 100], "the device measures it");
    let refused = program.patch(inputs, json!({"ac_voltage": 200, "ambient_temperature": 1000}));
    let message = refused.refused(422, "bad_value", Some("ambient_temperature"));
    assert!(message.contains("-40 to 100 °C") && message.contains("TRC-"), "{message}");
    for (name, value) in [("ac_voltage", json!(true)), ("alarm_silenced", json!(1)), ("ac_voltage", json!("100"))] {
        program.patch(inputs, json!({ name: value })).refused(422, "bad_value", Some(name));
    }
    assert_eq!(program.get("/api/devices/charger").ok()["inputs"]["ac_voltage"]["value"], 100);
}

#[test]
fn ctl_power_pulls_the_plug() {
    let program = Program::start(&BENCH.replace("rate = 0.0", "rate = 1.0"));
    let mut line = program.line("line1");
    // Fan power 1 of the Volcano is no EEPROM value: 400 from the factory. The target is one: 22.00 from the factory.
    program
        .patch("/api/devices/heater/registers", json!({"fan_power_1_volt": 500, "zone_temperature_target": 2500}))
        .ok();
    let off = program.post("/api/devices/heater/power", json!({"on": false})).ok();
    assert_eq!((&off["powered"], &off["plugged"], &off["boots"]), (&json!(false), &json!(false), &json!(1)));
    assert!(line.is_deaf(&[7, 3, 0, 13, 0, 1]));
    assert_eq!(line.read(5, 10, 1), [40], "the others answer");
    let on = program.post("/api/devices/heater/power", json!({"on": true})).ok();
    assert_eq!((&on["powered"], &on["boots"]), (&json!(true), &json!(2)));
    assert_eq!((line.read(7, 13, 1), line.read(7, 23, 1)), (vec![400], vec![2500]));
    // The Astro's clock has a battery (ASTRO-82).
    program.post("/api/devices/yard/power", json!({"on": false})).ok();
    program.patch("/api/clock", json!({"advance_s": 7200})).ok();
    program.post("/api/devices/yard/power", json!({"on": true})).ok();
    assert_eq!(line.read(1, 0x10, 4), [14, 10, 31, 17]);
}

#[test]
fn ctl_restart_and_factory_reset_are_the_devices_own() {
    let program = Program::bench();
    let mut line = program.line("line1");
    program.patch("/api/devices/yard/registers", json!({"summer_hour": 5, "user_device_number_l": 77})).ok();
    let restarted = program.post("/api/devices/yard/restart", json!(null)).ok();
    assert_eq!((&restarted["powered"], &restarted["listening"]), (&json!(true), &json!(false)));
    assert!(line.is_deaf(&[1, 3, 0, 7, 0, 1]), "silent for boot_ms, 500 ms (ASTRO-80)");
    program.post("/api/devices/yard/restart", json!(null)).refused(409, "wrong_state", None);
    wait_for_boots(&program, "yard", 2);
    assert_eq!(line.read(1, 0x34, 1), [5], "EEPROM keeps it");
    // A factory reset leaves the user device number alone and takes back the rest (ASTRO-81).
    program.post("/api/devices/yard/factory-reset", json!(null)).ok();
    wait_for_listening(&program, "yard");
    assert_eq!((line.read(1, 0x34, 1), line.read(1, 7, 1)), (vec![3], vec![77]));
}

fn wait_for_listening(program: &Program, name: &str) {
    wait(program, name, |device| device["listening"] == true);
}

fn wait_for_boots(program: &Program, name: &str, boots: u32) {
    wait(program, name, |device| device["boots"] == boots && device["listening"] == true);
}

#[track_caller]
fn wait(program: &Program, name: &str, holds: impl Fn(&Value) -> bool) {
    for _ in 0..200 {
        if holds(&program.get(&format!("/api/devices/{name}")).ok()) {
            return;
        }
        thread::sleep(Duration::from_millis(25));
    }
    panic!("{name} does not come back");
}
