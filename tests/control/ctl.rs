//! The interface from a shell: `standin ctl`.

use std::io::{BufRead, BufReader};
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

use crate::program::{BENCH, Program};

fn ctl(program: &Program, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_standin"));
    command.arg("ctl").args(line.split(' ')).env("STANDIN_URL", program.url()).env_remove("STANDIN_TOKEN");
    command
}

fn run(program: &Program, line: &str) -> Output {
    ctl(program, line).output().unwrap()
}

/// What a command prints that is done.
#[track_caller]
fn said(program: &Program, line: &str) -> String {
    let output = run(program, line);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!((output.status.code(), &*errors), (Some(0), ""), "{line}");
    String::from_utf8(output.stdout).unwrap()
}

/// What a command that is refused says on stderr.
#[track_caller]
fn complaint(program: &Program, line: &str, status: i32) -> String {
    let output = run(program, line);
    assert_eq!(output.status.code(), Some(status), "{line}");
    assert!(output.stdout.is_empty(), "{line}");
    String::from_utf8(output.stderr).unwrap()
}

#[track_caller]
fn json_of(program: &Program, line: &str) -> Value {
    let text = said(program, &format!("{line} --json"));
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn ctl_command_moves_time() {
    let program = Program::bench();
    assert_eq!(said(&program, "clock"), "2014-10-31T15:00:00 at rate 0.0\n");
    assert_eq!(said(&program, "clock advance 6h"), "2014-10-31T21:00:00 at rate 0.0\n");
    assert_eq!(said(&program, "clock until 2014-10-31T22:30"), "2014-10-31T22:30:00 at rate 0.0\n");
    assert_eq!(said(&program, "clock set 2014-10-31T15:00"), "2014-10-31T15:00:00 at rate 0.0\n");
    assert!(said(&program, "clock rate 600").ends_with("at rate 600.0\n"));
    said(&program, "clock rate 0");
    assert!(complaint(&program, "clock rate -1", 1).contains("0 to 86400"));
    assert!(complaint(&program, "clock advance soon", 2).contains("1h30m"));
}

#[test]
fn ctl_command_tells_errors_as_json_where_json_is_wanted() {
    let mut program = Program::bench();
    let error = |program: &Program, line: &str| {
        let text = complaint(program, &format!("{line} --json"), 1);
        serde_json::from_str::<Value>(&text).unwrap_or_else(|_| panic!("{text}"))["error"].clone()
    };
    let refused = error(&program, "clock rate -1");
    assert_eq!((&refused["code"], &refused["field"]), (&json!("bad_value"), &json!("rate")));
    assert!(refused["message"].as_str().unwrap().contains("0 to 86400"), "{refused}");
    let unknown = error(&program, "get charger no_such_register");
    assert_eq!(unknown["code"], "not_done");
    assert!(unknown["message"].as_str().unwrap().contains("no_such_register"), "{unknown}");
    program.stop();
    assert!(error(&program, "status")["message"].as_str().unwrap().contains("nobody answers"));
}

#[test]
fn ctl_command_gets_and_sets() {
    let program = Program::bench();
    assert_eq!(said(&program, "get charger charge_voltage_limit"), "charge_voltage_limit  27.5  V  (raw 275)\n");
    // ac_voltage is an input and an input register: set moves the world, get shows what the device measures.
    assert_eq!(said(&program, "set charger ac_voltage=100"), "ac_voltage  100  V\n");
    said(&program, "clock advance 1m");
    assert_eq!(said(&program, "get charger ac_voltage"), "ac_voltage  100  V\n");
    assert_eq!(json_of(&program, "get charger ac_voltage --inputs")["ac_voltage"]["value"], 100);
    let both = json_of(&program, "set charger fan_on_temperature=50 alarm_silenced=true");
    assert_eq!((&both["fan_on_temperature"]["raw"], &both["alarm_silenced"]["value"]), (&json!(50), &json!(true)));
    assert_eq!(program.line("line1").read(5, 10, 1), [50]);
    let refused = complaint(&program, "set charger fan_on_temperature=61", 1);
    assert!(refused.contains("20 to 60") && refused.contains("TRC-"), "{refused}");
    assert!(complaint(&program, "set charger fan_on=61", 1).contains("fan_on_temperature"));
    assert!(complaint(&program, "get charger nothing", 1).contains("nothing"));
    assert!(complaint(&program, "get boiler", 1).contains("yard, charger, heater"));
    assert!(complaint(&program, "set charger fan_on_temperature", 2).contains("NAME=VALUE"));
    said(&program, "set yard product_code=7 --force");
    assert_eq!(program.line("line1").read(1, 2, 2), [0, 7]);
    let all = said(&program, "get heater");
    for part in ["heater", "hmi-volcano-ec", "INPUTS", "COILS", "REGISTERS", "room_temperature", "zone_mode"] {
        assert!(all.contains(part), "{part} in {all}");
    }
}

#[test]
fn ctl_command_turns_power_and_restarts() {
    let program = Program::bench();
    assert_eq!(said(&program, "power heater off"), "heater is off\n");
    assert!(said(&program, "devices").lines().any(|line| line.starts_with("heater") && line.ends_with("off")));
    assert!(complaint(&program, "restart heater", 1).contains("no power"));
    assert_eq!(said(&program, "power heater on"), "heater is on\n");
    assert_eq!(said(&program, "restart yard"), "yard is restarting\n");
    said(&program, "factory-reset charger");
    assert!(complaint(&program, "power heater maybe", 2).contains("on, off"));
}

#[test]
fn ctl_command_adds_faults_and_reads_the_journal() {
    let program = Program::bench();
    let mut line = program.line("line1");
    assert_eq!(said(&program, "fault list"), "");
    let added = said(&program, "fault add line1 drop --device charger --count 2");
    assert!(added.contains("drop") && added.contains("charger") && added.contains("count=2"), "{added}");
    let plan =
        "fault add line1 delay --function 3 --addresses 0-10 --probability 0.5 --for 1m --seed 7 --ms 1 --jitter-ms 2";
    let plan = json_of(&program, plan);
    let wanted = [
        ("functions", json!([3])),
        ("addresses", json!([[0, 10]])),
        ("probability", json!(0.5)),
        ("for_s", json!(60.0)),
        ("seed", json!(7)),
        ("jitter_ms", json!(2)),
    ];
    wanted.iter().for_each(|(field, value)| assert_eq!(plan[*field], *value, "{field}"));
    assert!(line.is_deaf(&[5, 3, 0, 10, 0, 1]));
    said(&program, "fault remove 1");
    assert!(complaint(&program, "fault remove 1", 1).contains("no fault 1"));
    assert_eq!(said(&program, "fault clear"), "");
    line.ask(&[5, 6, 0, 10, 0, 61]);
    line.ask(&[5, 3, 0, 12, 0, 1]);
    let journal = said(&program, "journal --device charger");
    for part in ["silence", "fault 1: drop", "exception 03", "[61]", "20 to 60", "hint: one less would exist"] {
        assert!(journal.contains(part), "{part} in {journal}");
    }
    assert_eq!(said(&program, "journal --device charger --outcome exception --count"), "2\n");
    assert_eq!(json_of(&program, "journal --last 1")[0]["address"], 12);
    said(&program, "journal --clear");
    assert_eq!(said(&program, "journal"), "");
}

#[test]
fn ctl_command_keeps_and_resets() {
    let program = Program::bench();
    said(&program, "set charger fan_on_temperature=50");
    assert!(said(&program, "snapshot keep warm").starts_with("warm"));
    said(&program, "set charger fan_on_temperature=45");
    said(&program, "snapshot restore warm");
    assert_eq!(program.line("line1").read(5, 10, 1), [50]);
    assert!(said(&program, "snapshot").contains("warm"));
    said(&program, "snapshot forget warm");
    assert_eq!(said(&program, "reset"), "2014-10-31T15:00:00 at rate 0.0\n");
    assert_eq!(program.line("line1").read(5, 10, 1), [40]);
    let status = said(&program, "status");
    assert!(status.contains("line1") && status.contains("9600 none 2"), "{status}");
    assert!(said(&program, "metrics").contains("standin_frames_total"));
}

#[test]
fn ctl_command_follows_events() {
    let program = Program::bench();
    let mut child = ctl(&program, "events").stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut line = program.line("line1");
    // The follower may come late, and what happened before it is not told to it.
    let told = std::thread::scope(|scope| {
        let told = scope.spawn(move || lines.next().unwrap().unwrap());
        for raw in (20..60).cycle() {
            if told.is_finished() {
                break;
            }
            line.ask(&[5, 6, 0, 10, 0, raw]);
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        told.join().unwrap()
    });
    assert!(told.contains("charger: write single register 10"), "{told}");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn ctl_command_shows_its_token_and_says_where_nobody_answers() {
    let program = Program::start(&BENCH.replace("listen =", "token = \"s3cret-s3cret-s3cret\"\nlisten ="));
    assert!(complaint(&program, "status", 1).contains("STANDIN_TOKEN"));
    let output = ctl(&program, "clock").env("STANDIN_TOKEN", "s3cret-s3cret-s3cret").output().unwrap();
    assert!(output.status.success());
    let file = program.folder.path().join("token");
    std::fs::write(&file, "s3cret-s3cret-s3cret\n").unwrap();
    said(&program, &format!("clock --token-file {}", file.display()));
    let nobody = complaint(&program, "status --at http://127.0.0.1:9", 1);
    assert!(nobody.contains("127.0.0.1:9") && nobody.contains("--listen"), "{nobody}");
    assert!(complaint(&program, "status --at localhost:1", 1).contains("http://"));
}

#[test]
fn ctl_command_has_completions() {
    for shell in ["bash", "zsh", "fish"] {
        let output = Command::new(env!("CARGO_BIN_EXE_standin")).args(["completions", shell]).output().unwrap();
        assert!(output.status.success());
        let script = String::from_utf8(output.stdout).unwrap();
        for word in ["ctl", "snapshot", "factory-reset", "token-file"] {
            assert!(script.contains(word), "{word} for {shell}");
        }
    }
}
