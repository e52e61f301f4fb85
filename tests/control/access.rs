//! Who may ask, what errors look like, and the description.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::program::{BENCH, Program, command};

/// The bench with more under `[control]`.
fn with_control(more: &str) -> String {
    BENCH.replace("listen = \"127.0.0.1:0\"\n", &format!("{more}\n"))
}

#[test]
fn ctl_1_listening_elsewhere_needs_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let output = command(&folder, &with_control("listen = \"0.0.0.0:0\"")).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("token"), "{said}");
}

#[test]
fn ctl_1_a_token_is_asked_of_every_request_and_is_never_told() {
    let token = "correct-horse-battery-staple-0042";
    let toml = with_control(&format!("listen = \"0.0.0.0:0\"\ntoken = \"{token}\""));
    let mut program = Program::start_with(&toml, |command| {
        command.env("RUST_LOG", "trace").arg("-vv");
    });
    let port = program.address().rsplit_once(':').unwrap().1.to_owned();
    program.report["control"] = json!(format!("http://127.0.0.1:{port}"));
    for path in ["/api/status", "/api/openapi.json", "/metrics", "/api/nothing"] {
        let answer = program.get(path);
        assert_eq!(answer.headers["www-authenticate"], "Bearer");
        answer.refused(401, "no_token", None);
    }
    for wrong in ["", "Bearer", "Bearer ", "Bearer correct-horse-battery-staple-0043", "Basic Y29ycmVjdA=="] {
        program.call_with("GET", "/api/status", "", &[("authorization", wrong)]).refused(401, "no_token", None);
    }
    program.token = Some(token.into());
    program.get("/api/status").ok();
    program.token = Some(token[..token.len() - 1].into());
    program.get("/api/status").refused(401, "no_token", None);
    program.stop();
    assert!(!program.log().contains(token), "the log tells the token");
}

#[test]
fn ctl_1_a_foreign_host_or_origin_is_refused() {
    let program = Program::start(&with_control("listen = \"127.0.0.1:0\"\nhosts = [\"bench.example\"]"));
    let status = |headers: &[(&str, &str)]| program.call_with("GET", "/api/status", "", headers).status;
    let address = program.address().to_owned();
    let port = address.rsplit_once(':').unwrap().1;
    for fine in
        [&*address, "localhost", "LOCALHOST:1234", "127.0.0.1", "[::1]:80", "bench.example:8080", "Bench.Example"]
    {
        assert_eq!(status(&[("host", fine)]), 200, "Host {fine}");
        assert_eq!(status(&[("origin", &format!("http://{fine}"))]), 200, "Origin {fine}");
    }
    let foreign = [
        "evil.example",
        "localhost.evil.example",
        "bench.example.evil",
        "127.0.0.1.evil.example",
        "192.168.1.1",
        "0.0.0.0",
        "",
    ];
    for foreign in foreign {
        assert_eq!(status(&[("host", foreign)]), 403, "Host {foreign:?}");
        assert_eq!(status(&[("origin", &format!("https://{foreign}"))]), 403, "Origin {foreign:?}");
    }
    assert_eq!(status(&[("origin", "null")]), 403, "a page from a file");
    assert_eq!(status(&[("origin", &format!("ftp://localhost:{port}"))]), 403);
    let answer = program.call_with("POST", "/api/reset", "", &[("origin", "http://evil.example")]);
    assert!(answer.refused(403, "foreign", None).contains("evil.example"));

    // A request without any Host, which no library sends.
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.write_all(b"GET /api/status HTTP/1.1\r\nconnection: close\r\n\r\n").unwrap();
    let mut said = String::new();
    stream.read_to_string(&mut said).unwrap();
    assert!(said.starts_with("HTTP/1.1 403"), "{said}");
}

#[test]
fn ctl_2_errors_name_what_is_wrong() {
    let program = Program::bench();
    // 400: not JSON, and fields that a call does not have.
    for body in ["", "{", "[1,", "nothing", "{\"on\": true} x", "\u{1}"] {
        program.call("POST", "/api/devices/heater/power", body).refused(400, "not_readable", None);
    }
    program.post("/api/devices/heater/power", json!([true])).refused(422, "bad_value", None);
    program.post("/api/devices/heater/power", json!({"on": true, "off": 1})).refused(400, "unknown_field", Some("off"));
    program.patch("/api/clock", json!({"speed": 2})).refused(400, "unknown_field", Some("speed"));
    program.get("/api/journal?colour=red").refused(400, "unknown_field", Some("colour"));
    let near = program.patch("/api/devices/yard/registers", json!({"rtc_mont": 2}));
    assert!(near.refused(400, "unknown_field", Some("rtc_mont")).contains("rtc_month"));
    let near = program.patch("/api/devices/charger/inputs", json!({"ac_voltag": 2}));
    assert!(near.refused(400, "unknown_field", Some("ac_voltag")).contains("ac_voltage"));

    // 404: the message names the known ones.
    let known = "yard, charger, heater";
    assert!(program.get("/api/devices/boiler").refused(404, "not_found", None).contains(known));
    assert!(program.post("/api/devices/boiler/restart", json!(null)).refused(404, "not_found", None).contains(known));
    let bus = program.post("/api/faults", json!({"kind": "drop", "bus": "line9"}));
    assert!(bus.refused(404, "not_found", Some("bus")).contains("line1"));
    let added = program.post("/api/faults", json!({"kind": "drop", "bus": "line1"})).ok();
    assert!(program.get("/api/faults/77").refused(404, "not_found", None).contains(&added["id"].to_string()));
    assert!(program.get("/api/faults/first").refused(404, "not_found", None).contains(&added["id"].to_string()));
    program.post("/api/snapshots/none/restore", json!(null)).refused(404, "not_found", None);
    program.get("/api").refused(404, "not_found", None);
    program.get("/").refused(404, "not_found", None);
    program.call("PUT", "/api/clock", "").refused(405, "wrong_method", None);

    // 409: not in this state.
    program.post("/api/devices/heater/power", json!({"on": false})).ok();
    program.post("/api/devices/heater/restart", json!(null)).refused(409, "wrong_state", None);
    program.post("/api/devices/heater/factory-reset", json!(null)).refused(409, "wrong_state", None);
    program.patch("/api/devices/heater/registers", json!({"zone_fan_speed": 50})).refused(409, "wrong_state", None);

    // 422: the rule's own words, and its clause.
    program.post("/api/devices/heater/power", json!({"on": "yes"})).refused(422, "bad_value", Some("on"));
    program.post("/api/devices/heater/power", json!({})).refused(422, "bad_value", Some("on"));
    let twice = "{\"charge_voltage_limit\": 270, \"charge_voltage_limit\": 271}";
    let path = "/api/devices/charger/registers";
    program.call("PATCH", path, twice).refused(422, "bad_value", Some("charge_voltage_limit"));
    for name in [".", "..", ".hidden"] {
        program.post(&format!("/api/snapshots/{}", name.replace('.', "%2E")), json!(null)).refused(
            422,
            "bad_value",
            Some("name"),
        );
    }
    let rule = program.patch("/api/devices/yard/registers", json!({"rtc_month": 2}));
    assert!(rule.refused(422, "refused", Some("rtc_month")).contains("ASTRO-1"));
    let range = program.patch("/api/devices/charger/registers", json!({"fan_on_temperature": 61}));
    let message = range.refused(422, "refused", Some("fan_on_temperature"));
    assert!(message.contains("20 to 60") && message.contains("TRC-"), "{message}");
    program.get("/api/journal?function=many").refused(422, "bad_value", Some("function"));

    // 413: more than 1 MiB, however it comes.
    let large = format!("{{\"rtc_month\": {}1}}", " ".repeat(1 << 20));
    program.call("PATCH", "/api/devices/yard/registers", &large).refused(413, "too_large", None);
    program.call("POST", "/api/reset", &large).refused(413, "too_large", None);
    let fits = format!("{{\"rtc_hour\": {}14}}", " ".repeat((1 << 20) - 32));
    program.call("PATCH", "/api/devices/yard/registers", &fits).ok();
}

#[test]
fn ctl_3_the_description_is_of_what_there_is() {
    let program = Program::bench();
    let answer = program.get("/api/openapi.json");
    assert_eq!(answer.headers["content-type"], "application/json");
    let description = answer.ok();
    assert!(description["openapi"].as_str().unwrap().starts_with("3."));
    let wanted = [
        ("/api/status", "get"),
        ("/api/clock", "get patch"),
        ("/api/devices", "get"),
        ("/api/devices/{name}", "get"),
        ("/api/devices/{name}/registers", "get patch"),
        ("/api/devices/{name}/inputs", "patch"),
        ("/api/devices/{name}/power", "post"),
        ("/api/devices/{name}/restart", "post"),
        ("/api/devices/{name}/factory-reset", "post"),
        ("/api/faults", "get post delete"),
        ("/api/faults/{id}", "get delete"),
        ("/api/journal", "get delete"),
        ("/api/journal/count", "get"),
        ("/api/snapshots", "get"),
        ("/api/snapshots/{name}", "get post delete"),
        ("/api/snapshots/{name}/restore", "post"),
        ("/api/reset", "post"),
        ("/api/events", "get"),
        ("/metrics", "get"),
    ];
    let paths = description["paths"].as_object().unwrap();
    for (path, methods) in wanted {
        let mut described: Vec<&str> = paths[path].as_object().unwrap().keys().map(String::as_str).collect();
        let mut methods: Vec<&str> = methods.split(' ').collect();
        described.sort_unstable();
        methods.sort_unstable();
        assert_eq!(described, methods, "{path}");
    }
    assert_eq!(paths.len(), wanted.len(), "{:?}", paths.keys());
}

#[test]
fn ctl_1_a_connection_that_does_not_talk_is_closed_and_too_many_are_turned_away() {
    let program = Program::bench();
    // Half a request keeps its place for a while only, and the others go on.
    let mut half = TcpStream::connect(program.address()).unwrap();
    half.write_all(b"GET /api/status HTTP/1.1\r\nhost: local").unwrap();
    let silent: Vec<TcpStream> = (0..63).map(|_| TcpStream::connect(program.address()).unwrap()).collect();
    let mut said = String::new();
    let end = Instant::now() + Duration::from_secs(10);
    while said.is_empty() && Instant::now() < end {
        let mut late = TcpStream::connect(program.address()).unwrap();
        late.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        let _ = late.read_to_string(&mut said);
    }
    assert!(said.starts_with("HTTP/1.1 503"), "{said:?}");
    assert!(said.contains("\"unavailable\""), "{said}");
    drop(silent);
    half.set_read_timeout(Some(Duration::from_secs(40))).unwrap();
    let mut rest = Vec::new();
    half.read_to_end(&mut rest).expect("the program closes it");
    program.get("/api/status").ok();
}

#[test]
fn ctl_2_a_body_that_does_not_come_is_not_waited_for() {
    let program = Program::bench();
    let mut stream = TcpStream::connect(program.address()).unwrap();
    let head =
        "PATCH /api/clock HTTP/1.1\r\nhost: localhost\r\ncontent-length: 20\r\nconnection: close\r\n\r\n{\"rate\"";
    stream.write_all(head.as_bytes()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let mut said = String::new();
    stream.read_to_string(&mut said).unwrap();
    assert!(said.starts_with("HTTP/1.1 408"), "{said}");
}
