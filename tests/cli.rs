//! The program as its users start it: what it prints where, and its exit status.

#![allow(clippy::unwrap_used)]

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value as Json;
use tempfile::TempDir;

/// What a run of the program printed, and its exit status.
#[derive(Debug)]
struct Ran {
    status: i32,
    out: String,
    err: String,
}

fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_standin"));
    command.args(arguments).current_dir(folder).env_remove("RUST_LOG").stdin(Stdio::null());
    command
}

fn run_in(folder: &Path, arguments: &[&str]) -> Ran {
    let output = command(folder, arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ran { status: output.status.code().unwrap(), out: text(output.stdout), err: text(output.stderr) }
}

/// Runs the program in an empty folder.
fn run(arguments: &[&str]) -> Ran {
    run_in(folder().path(), arguments)
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

/// A folder with a devices.toml.
fn folder_with(devices: &str) -> TempDir {
    let folder = folder();
    std::fs::write(folder.path().join("devices.toml"), devices).unwrap();
    folder
}

const HEATER: &str = r#"state = "memory"
[clock]
start = 2014-10-27T14:22:08
rate = 60
[[bus]]
name = "line1"
ports = ["pty:port", "modbus-tcp:127.0.0.1:0"]
baud = 19200
[[bus.device]]
name = "heater"
model = "hmi-volcano-ec"
unit = 4
registers = { zone_mode = 1 }
[[bus.device]]
name = "gate"
model = "logiccon-trc"
unit = 250
"#;

/// The program refuses its command line or configuration, and says so with these words on stderr.
#[track_caller]
fn refuses(arguments: &[&str], words: &[&str]) {
    let ran = run(arguments);
    assert_eq!((ran.status, ran.out.as_str()), (2, ""), "{arguments:?}: {ran:?}");
    for word in words {
        assert!(ran.err.contains(word), "{arguments:?} does not say {word:?}: {}", ran.err);
    }
}

#[test]
fn models_are_listed_one_a_line() {
    let ran = run(&["models"]);
    let models = "kael-astro-01\nkael-astro-03\nlogiccon-trc\nlogiccon-pfc24s-tcr\nhmi-volcano-ec\n";
    assert_eq!((ran.status, ran.out.as_str(), ran.err.as_str()), (0, models, ""));
}

#[test]
fn init_prints_the_example_that_check_accepts() {
    let ran = run(&["init"]);
    let example = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/devices.toml")).unwrap();
    assert_eq!((ran.status, &ran.out), (0, &example));
    let folder = folder_with(&ran.out);
    assert_eq!(run_in(folder.path(), &["check"]).status, 0);
}

#[test]
fn check_prints_the_plan_and_starts_nothing() {
    let folder = folder_with(HEATER);
    let ran = run_in(folder.path(), &["check"]);
    let plan = "devices.toml is fine

clock    from 2014-10-27 14:22:08 on, 60 times as fast as real time
memory   in the folder memory
control  none

bus line1: 19200 8N2, timing fast, line check warn
  pty:port
  modbus-tcp:127.0.0.1:0
  unit   4  heater  hmi-volcano-ec  1 start value
  unit 250  gate    logiccon-trc
";
    assert_eq!((ran.status, ran.out.as_str()), (0, plan));
    let warning =
        "warning: devices.toml:17:8: unit 250 is reserved by Modbus, whose units end at 247: many masters refuse it\n";
    assert_eq!(ran.err, warning);
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["devices.toml"]);
}

#[test]
fn a_wrong_configuration_is_refused_and_nothing_is_started() {
    let folder = folder_with(&HEATER.replace("unit = 4", "unit = 0").replace("zone_mode = 1", "zone_mode = 2"));
    let expected = "devices.toml:12:8: unit takes a whole number, 1 to 247 for hmi-volcano-ec, not 0\n\
                    devices.toml:13:27: zone_mode takes 0 to 1, not 2 (VOL-42)\n";
    for arguments in [&["check"][..], &["run"], &[], &["run", "devices.toml"], &["devices.toml", "--json"]] {
        let ran = run_in(folder.path(), arguments);
        assert_eq!((ran.status, ran.out.as_str(), ran.err.as_str()), (2, "", expected), "{arguments:?}");
    }
    assert!(std::fs::symlink_metadata(folder.path().join("port")).is_err());
    assert!(!folder.path().join("memory").exists());
}

#[test]
fn a_file_that_is_not_there_is_refused() {
    let remedy = "`standin init` prints an example";
    refuses(&["check"], &["devices.toml: cannot be read: No such file or directory", remedy]);
    refuses(&["run", "bench.toml"], &["bench.toml: cannot be read: No such file or directory"]);
    refuses(&["chekc"], &["chekc: cannot be read", "Did you mean `standin check`?"]);
    refuses(&["check", "."], &[".: cannot be read: Is a directory"]);
}

#[test]
fn a_wrong_command_line_is_refused() {
    refuses(&["--bogus"], &["--bogus"]);
    refuses(&["run", "--rate", "86401"], &["the rate is a number, 0 to 86400, not \"86401\""]);
    refuses(&["--rate", "fast"], &["the rate is a number, 0 to 86400, not \"fast\""]);
    refuses(&["--start", "yesterday"], &["the clock starts at \"host\" or a local date-time", "not \"yesterday\""]);
    refuses(&["--listen", "8502"], &["an address is written like 127.0.0.1:8502, not \"8502\""]);
    refuses(&["-v", "-q"], &["cannot be used with"]);
    refuses(
        &["registers", "kael-astro"],
        &["the models are kael-astro-01, kael-astro-03, logiccon-trc, logiccon-pfc24s-tcr, hmi-volcano-ec"],
    );
    refuses(&["registers", "logiccon-trc", "--format", "xml"], &["table", "markdown", "csv", "json"]);
}

#[test]
fn ctl_1_listening_beyond_this_host_without_a_token_is_refused() {
    let folder = folder_with(HEATER);
    let ran = run_in(folder.path(), &["--listen", "0.0.0.0:8502"]);
    let expected = "devices.toml: --listen takes a loopback address such as 127.0.0.1:8502 unless [control] has a token or token_file, not 0.0.0.0:8502\n";
    assert_eq!((ran.status, ran.out.as_str(), ran.err.as_str()), (2, "", expected));
}

#[test]
fn registers_as_a_table_are_found_by_name() {
    let ran = run(&["registers", "logiccon-trc"]);
    assert_eq!(ran.status, 0);
    let line = ran.out.lines().find(|line| line.contains("charge_voltage_limit")).unwrap();
    let cells: Vec<&str> = line.split_whitespace().collect();
    assert_eq!(
        cells,
        ["holding", "3", "0003", "charge_voltage_limit", "u16", "0.1", "V", "215", "to", "290", "275", "eeprom"]
    );
    // 11 coils, 5 pairs, 12 registers, and the headings.
    assert_eq!(ran.out.lines().count(), 11 + 5 + 12 + 1);
}

#[test]
fn registers_as_csv_have_one_line_each() {
    let ran = run(&["registers", "hmi-volcano-ec", "--format", "csv"]);
    let mut lines = ran.out.lines();
    assert_eq!(
        lines.next().unwrap(),
        "bank,address,name,words,format,unit,scale,min,max,one_of,step,default,access,keep,clause,about"
    );
    // 7 coils, 2 discrete inputs, 2 input registers, 41 holding registers.
    assert_eq!(lines.count(), 7 + 2 + 2 + 41);
    let baudrate = ran.out.lines().find(|line| line.contains(",baudrate,")).unwrap();
    assert!(baudrate.starts_with(
        "holding,0,baudrate,1,u16,10 bit/s,0,480,3840,480 960 1920 3840,1,960,read-write,eeprom,VOL-3,\""
    ));
}

#[test]
fn registers_as_json_let_a_script_read_every_register_by_name() {
    let ran = run(&["registers", "logiccon-trc", "--format", "json"]);
    let model: Json = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(model["model"], "logiccon-trc");
    assert_eq!(model["functions"], serde_json::json!([1, 3, 4, 6, 16]));
    assert_eq!(model["limits"]["read_registers"], 30);
    let line = serde_json::json!({"units": [1, 255], "bauds": [4800, 7200, 9600, 14400, 19200, 38400], "formats": ["8N1", "8N2"]});
    assert_eq!(model["line"], line);
    let register = |name: &str| {
        let all = model["registers"].as_array().unwrap();
        all.iter().find(|register| register["name"] == name).unwrap().clone()
    };
    let current = register("battery_current");
    for (key, value) in [
        ("bank", Json::from("input")),
        ("address", 6.into()),
        ("words", 2.into()),
        ("format", "s32".into()),
        ("unit", "A".into()),
        ("scale", 1.into()),
        ("min", Json::Null),
        ("max", Json::Null),
        ("access", "read".into()),
    ] {
        assert_eq!(current[key], value, "{key}");
    }
    let limit = register("charge_voltage_limit");
    for (key, value) in [
        ("bank", Json::from("holding")),
        ("address", 3.into()),
        ("words", 1.into()),
        ("min", 215.into()),
        ("max", 290.into()),
        ("one_of", Json::Array(vec![])),
        ("step", 1.into()),
        ("default", 275.into()),
        ("access", "read-write".into()),
        ("keep", "eeprom".into()),
        ("unit", "V".into()),
        ("scale", 1.into()),
    ] {
        assert_eq!(limit[key], value, "{key}");
    }
    assert!(!limit["about"].as_str().unwrap().is_empty() && limit["clause"].as_str().unwrap().starts_with("TRC-"));
    let named = |list: &str, name: &str| {
        let all = model[list].as_array().unwrap();
        all.iter().find(|item| item["name"] == name).unwrap().clone()
    };
    let mains = named("inputs", "ac_voltage");
    assert_eq!((&mains["unit"], &mains["default"]), (&Json::from("V"), &Json::from(230.0)));
    assert_eq!(named("inputs", "battery_connected")["default"], true);
    assert_eq!(named("options", "baud_out_of_range")["default"], "wrap");
    assert_eq!(named("options", "response_delay_ms")["default"], 0);
}

#[test]
fn a_reader_that_has_seen_enough_is_no_failure() {
    let mut child = command(folder().path(), &["registers", "logiccon-pfc24s-tcr", "--format", "json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The pipe holds far less than the map: the program is stopped in the middle of it.
    child.stdout.take().unwrap().read_exact(&mut [0; 10]).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), &b""[..]));
}

#[test]
fn help_teaches_with_examples_that_work() {
    let ran = run(&["--help"]);
    assert_eq!(ran.status, 0);
    let examples: Vec<&str> = ran.out.lines().filter_map(|line| line.strip_prefix("  standin ")).collect();
    assert!(examples.len() >= 6, "{}", ran.out);
    let folder = folder_with(HEATER);
    for example in examples {
        // The command ends where two blanks begin the explanation; what a shell would do with the rest is left out.
        let line = example.split("  ").next().unwrap().split(" > ").next().unwrap();
        let arguments: Vec<&str> = line.split_whitespace().collect();
        if matches!(arguments.first(), Some(&"check" | &"registers" | &"init" | &"models")) {
            let ran = run_in(folder.path(), &arguments);
            assert_eq!(ran.status, 0, "standin {line}: {}", ran.err);
        }
    }
}

#[test]
fn completions_know_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let ran = run(&["completions", shell]);
        assert_eq!(ran.status, 0);
        assert!(ran.out.contains("registers") && ran.out.contains("exit-with-parent"), "{shell}");
    }
}

#[test]
fn bus_20_memory_is_that_of_the_folder_that_the_configuration_names() {
    let folder = folder_with(HEATER);
    let ran = run_in(folder.path(), &["memory", "list"]);
    assert_eq!(ran.status, 1);
    assert!(ran.err.starts_with("error: the state folder memory cannot be used: "), "{}", ran.err);
    std::fs::create_dir(folder.path().join("memory")).unwrap();
    std::fs::write(folder.path().join("memory/heater.json"), "cut").unwrap();
    let ran = run_in(folder.path(), &["memory", "show", "gate"]);
    let expected = "error: the state folder memory has no image of gate; it has those of heater\n";
    assert_eq!((ran.status, ran.out.as_str(), ran.err.as_str()), (1, "", expected));
    let ran = run_in(folder.path(), &["memory", "list"]);
    assert_eq!(ran.status, 0);
    assert!(ran.out.starts_with("heater: the memory image memory/heater.json is cut or no image"), "{}", ran.out);
    assert_eq!(run_in(folder.path(), &["memory", "reset", "heater"]).status, 0);
    let ran = run_in(folder.path(), &["memory", "list", "--state", "memory"]);
    assert_eq!((ran.status, ran.out.as_str()), (0, ""));
    let none = folder_with(&HEATER.replace("state = \"memory\"", ""));
    let ran = run_in(none.path(), &["memory", "list"]);
    assert_eq!(
        (ran.status, ran.err.as_str()),
        (2, "devices.toml names no `state` folder: give one with --state DIR\n")
    );
}
