//! What is refused: the file as a whole, clock, state, control, buses.

use standin::config::{Config, Overrides};
use standin::time::civil;

use crate::{accepted, bus, charger, heater, parse, refused};

#[test]
fn every_error_of_a_file_is_reported_at_once_in_its_order() {
    refused(
        r#"stat = "s"
[clock]
start = "yesterday"
rate = -1
[control]
listen = "0.0.0.0:80"
[[bus]]
name = "line1"
port = "pty:/tmp/p"
baud = 9600.0
paritty = "none"
[[bus.device]]
name = "heater"
model = "hmi-volcano"
unit = 0
[[bus.device]]
name = "heater"
model = "logiccon-trc"
unit = 256
registers = { charge_voltage_limit = 300, charge_currentlimit = 2 }
inputs = { ac_voltage = "230" }
options = { range_check = "maybe" }
"#,
        &[
            "t:1:1: unknown key \"stat\": the file takes state, clock, control, bus; did you mean state?",
            "t:3:9: start takes \"host\" or a local date-time of 2000 to 2099 such as \"2014-10-27T14:22:08\", not \"yesterday\"",
            "t:4:8: rate takes a number, 0 to 86400, not -1",
            "t:6:10: listen takes a loopback address such as 127.0.0.1:80 unless [control] has a token or token_file, not 0.0.0.0:80",
            "t:10:8: baud takes a whole number, 50 to 4000000, not 9600.0",
            "t:11:1: unknown key \"paritty\": [[bus]] takes name, port, ports, max_clients, baud, parity, stop_bits, timing, line_check, slack_ms, device; did you mean parity?",
            "t:14:9: model takes one of kael-astro-01, kael-astro-03, logiccon-trc, logiccon-pfc24s-tcr, hmi-volcano-ec, not \"hmi-volcano\"; did you mean hmi-volcano-ec?",
            "t:15:8: unit takes a whole number, 1 to 255, not 0",
            "t:17:8: device name heater stands in line 13 too: give each its own",
            "t:19:8: unit takes a whole number, 1 to 255 for logiccon-trc, not 256",
            "t:20:38: charge_voltage_limit takes 215 to 290, not 300 (TRC-1, TRC-10)",
            "t:20:43: logiccon-trc has no register \"charge_currentlimit\"; did you mean charge_current_limit? `standin registers logiccon-trc` lists them",
            "t:21:25: ac_voltage takes 0 to 500 V, not \"230\"",
            "t:22:27: range_check takes \"reject\" or \"accept\", not \"maybe\"",
        ],
    );
}

#[test]
fn an_empty_file_has_no_bus() {
    let parts = "a bus needs name, port and its [[bus.device]]s; `standin init` prints an example";
    refused("", &[&format!("t:1:1: there is no [[bus]]: {parts}")]);
    refused("[clock]\nrate = 1\n", &[&format!("t:1:1: there is no [[bus]]: {parts}")]);
}

#[test]
fn what_is_no_toml_names_line_and_column() {
    refused("[clock]\nrate = 1\n[[bus\n", &["t:3:6: not TOML: unclosed array table, expected `]]`"]);
    refused("\nstate = \"a", &["t:2:11: not TOML: invalid basic string, expected `\"`"]);
}

#[test]
fn a_slip_that_leaves_the_rest_clear_hides_nothing() {
    refused(
        &heater("unit = 5\ninputs = { ntc_1_fault = 1 }\nregisters = { zone_program = yes }\nextra = 1"),
        &[
            "t:8:1: key unit stands here a second time",
            "t:9:26: ntc_1_fault takes true or false, not 1",
            "t:10:30: not TOML: string values must be quoted, expected literal string",
            "t:10:30: zone_program takes 0 to 1, not \"yes\" (VOL-44)",
            "t:11:1: unknown key \"extra\": [[bus.device]] takes name, model, unit, inputs, options, registers",
        ],
    );
}

#[test]
fn a_word_without_quotes_is_named_and_hides_nothing() {
    // The parser takes these for beginnings of nan, false, inf and true.
    let quoted = |word: &str| format!("not TOML: string values must be quoted, such as \"{word}\"");
    refused(
        "[[bus]]\nname = infra\nport = tcp\nparity = none\ntiming = fast\nboud = 9600\n",
        &[
            &format!("t:2:8: {}", quoted("infra")),
            &format!("t:3:8: {}", quoted("tcp")),
            &format!("t:4:10: {}", quoted("none")),
            &format!("t:5:10: {}", quoted("fast")),
            "t:6:1: unknown key \"boud\": [[bus]] takes name, port, ports, max_clients, baud, parity, stop_bits, timing, \
             line_check, slack_ms, device; did you mean baud?",
        ],
    );
    refused(&heater("inputs = { ntc_1_fault = True }"), &["t:8:26: not TOML: invalid boolean, expected `true`"]);
    let lists = "`standin registers hmi-volcano-ec` lists them";
    refused(&heater("registers = { qqq = 1 }"), &[&format!("t:8:15: hmi-volcano-ec has no register \"qqq\"; {lists}")]);
}

#[test]
fn bytes_that_are_no_text_are_placed_in_characters() {
    let host = civil(2024, 1, 1, 0, 0, 0);
    let error = Config::parse("t", b"# caf\xc3\xa9\n# \xc3\xa9 \xff", &Overrides::default(), host).unwrap_err();
    assert_eq!(error.to_string(), "t:2:5: not UTF-8 text, which TOML files are");
}

#[test]
fn columns_count_characters_and_no_byte_order_mark() {
    refused(
        "\u{feff}x = 1\n[[bus]]\nname = \"a\"\nport = \"pty:/p\"",
        &["t:1:1: unknown key \"x\": the file takes state, clock, control, bus"],
    );
    let text = heater("inputs = { \"sıcaklık\" = 1, extra = 2 }");
    let error = parse(&text).unwrap_err();
    let columns: Vec<&str> = error.lines().map(|line| &line[..7]).collect();
    assert_eq!(columns, ["t:8:12:", "t:8:28:"]);
}

// What is refused: clock, state, control.

#[test]
fn the_clock_is_local_and_in_its_century() {
    let allowed = "start takes \"host\" or a local date-time of 2000 to 2099 such as \"2014-10-27T14:22:08\"";
    for (value, shown) in [
        ("\"1999-12-31T23:59:59\"", "\"1999-12-31T23:59:59\""),
        ("2100-01-01T00:00:00", "2100-01-01T00:00:00"),
        ("2014-10-27T14:22:08Z", "2014-10-27T14:22:08Z"),
        ("2014-10-27", "2014-10-27"),
        ("\"2014-02-30T00:00:00\"", "\"2014-02-30T00:00:00\""),
        ("[]", "a list"),
    ] {
        refused(&format!("clock.start = {value}\n{}", heater("")), &[&format!("t:1:15: {allowed}, not {shown}")]);
    }
    for value in ["86400.1", "nan", "inf", "true"] {
        let expected = format!("t:1:14: rate takes a number, 0 to 86400, not {value}");
        refused(&format!("clock.rate = {value}\n{}", heater("")), &[&expected]);
    }
    refused(&format!("clock = 3\n{}", heater("")), &["t:1:9: clock takes a table: [clock], not 3"]);
    refused(&format!("state = \"\"\n{}", heater("")), &["t:1:9: state takes a path, not \"\""]);
}

#[test]
fn ctl_1_control_listens_on_loopback_or_has_a_token() {
    let control = |lines: &str| format!("[control]\n{lines}\n{}", heater(""));
    for loopback in ["127.0.0.1:0", "127.9.9.9:1", "localhost:8502", "[::1]:8502"] {
        assert!(accepted(&control(&format!("listen = \"{loopback}\""))).control.is_some(), "{loopback}");
    }
    let open = "listen = \"[::]:8502\"";
    refused(
        &control(open),
        &[
            "t:2:10: listen takes a loopback address such as 127.0.0.1:8502 unless [control] has a token or token_file, not [::]:8502",
        ],
    );
    let token = accepted(&control(&format!("{open}\ntoken = \"s3cret\""))).control.unwrap().token;
    assert_eq!(token.as_deref(), Some("s3cret"));
    let allowed = "visible ASCII characters without blanks, at least one";
    refused(&control(&format!("{open}\ntoken = \"\"")), &[&format!("t:3:9: token takes {allowed}, not \"\"")]);
    refused(
        &control("token = \"a b\""),
        &[
            "t:1:2: [control] needs listen, for example listen = \"127.0.0.1:8502\"",
            &format!("t:2:9: token takes {allowed}, not \"a b\""),
        ],
    );
    refused(
        &control("listen = \"8502\""),
        &["t:2:10: listen takes an address such as \"127.0.0.1:8502\", not \"8502\""],
    );
    refused(
        &control("listen = \"127.0.0.1:1\"\nhosts = [\"a\", \"b c\", 3]"),
        &["t:3:15: hosts takes host names, not \"b c\"", "t:3:22: hosts takes host names, not 3"],
    );
}

#[test]
fn ctl_1_a_token_file_holds_the_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("token");
    let text = |path: &str| format!("[control]\nlisten = \"0.0.0.0:1\"\ntoken_file = \"{path}\"\n{}", heater(""));
    std::fs::write(&path, "from-file\n").unwrap();
    let shown = path.display().to_string();
    assert_eq!(accepted(&text(&shown)).control.unwrap().token.as_deref(), Some("from-file"));
    std::fs::write(&path, "\n").unwrap();
    let allowed = "visible ASCII characters without blanks, at least one";
    refused(&text(&shown), &[&format!("t:3:14: token_file {shown} must hold {allowed}")]);
    std::fs::remove_file(&path).unwrap();
    refused(
        &text(&shown),
        &[&format!("t:3:14: token_file {shown} cannot be read: No such file or directory (os error 2)")],
    );
    std::fs::write(&path, "x").unwrap();
    let both = text(&shown).replace("token_file", "token = \"y\"\ntoken_file");
    refused(&both, &["t:4:1: token and token_file exclude each other"]);
}

// What is refused: buses.

#[test]
fn a_bus_has_a_name_and_doors() {
    refused(
        "[[bus]]\n",
        &[
            "t:1:1: [[bus]] needs name, for example name = \"line1\"",
            "t:1:1: [[bus]] needs port, for example port = \"pty:/tmp/standin/line1\"",
        ],
    );
    refused("[bus]\nname = \"x\"", &["t:1:2: bus is a list of tables: write [[bus]] with two brackets"]);
    refused("bus = [1]", &["t:1:8: bus takes tables, not 1"]);
    let name_allowed = "name takes a name of letters, digits, - _ and . (1 to 64, not . first)";
    for name in ["", ".x", "a/b", "a b"] {
        let text = format!("[[bus]]\nname = \"{name}\"\nport = \"pty:/p\"");
        refused(&text, &[&format!("t:2:8: {name_allowed}, not \"{name}\"")]);
    }
    let allowed = "takes \"pty:PATH\", \"serial:PATH\", \"tcp:ADDRESS:PORT\" or \"modbus-tcp:ADDRESS:PORT\"";
    for port in [
        "\"\"",
        "\"pty:\"",
        "\"/dev/ttyS0\"",
        "\"udp:1.2.3.4:5\"",
        "\"tcp:5020\"",
        "\"tcp:1.2.3.4:99999\"",
        "\"pty:/tmp/..\"",
        "7",
    ] {
        refused(&bus(&format!("port = {port}")), &[&format!("t:3:8: port {allowed}, not {port}")]);
    }
    refused(&bus("ports = [\"pty:/p\", 4]"), &[&format!("t:3:20: ports {allowed}, not 4")]);
    refused(&bus("ports = []"), &["t:3:9: ports takes at least one port, such as [\"pty:/tmp/standin/line1\"]"]);
    refused(
        &bus("ports = \"pty:/p\""),
        &["t:3:9: ports takes a list of ports, such as [\"pty:/tmp/standin/line1\"], not \"pty:/p\""],
    );
    refused(
        &bus("port = \"pty:/p\"\nports = [\"pty:/p\"]"),
        &["t:4:1: port and ports exclude each other: put all doors into ports"],
    );
}

#[test]
fn a_bus_settings_are_judged() {
    refused(
        &bus(
            "port = \"pty:/p\"\nbaud = 49\nparity = \"mark\"\nstop_bits = 3\ntiming = \"slow\"\nline_check = true\nslack_ms = -1\nmax_clients = 0",
        ),
        &[
            "t:4:8: baud takes a whole number, 50 to 4000000, not 49",
            "t:5:10: parity takes \"none\" or \"even\" or \"odd\", not \"mark\"",
            "t:6:13: stop_bits takes a whole number, 1 to 2, not 3",
            "t:7:10: timing takes \"fast\" or \"wire\", not \"slow\"",
            "t:8:14: line_check takes \"warn\" or \"enforce\" or \"off\", not true",
            "t:9:12: slack_ms takes a whole number, 0 to 10000, not -1",
            "t:10:15: max_clients takes a whole number, 1 to 1000, not 0",
        ],
    );
}

#[test]
fn names_paths_addresses_and_units_are_unique() {
    refused(
        r#"[control]
listen = "127.0.0.1:5020"
[[bus]]
name = "a"
ports = ["pty:/tmp/x/../p", "tcp:127.0.0.1:0", "modbus-tcp:127.0.0.1:0"]
device = [
  { name = "one", model = "logiccon-trc", unit = 1 },
  { name = "two", model = "logiccon-trc", unit = 1 },
]
[[bus]]
name = "a"
ports = ["serial:/tmp/./p", "tcp:127.0.0.1:5020"]
device = [
  { name = "one", model = "logiccon-trc", unit = 1 },
]
"#,
        &[
            "t:8:50: on this bus unit 1 stands in line 7 too: give each its own",
            "t:11:8: bus name a stands in line 4 too: give each its own",
            "t:12:10: path /tmp/p stands in line 5 too: give each its own",
            "t:12:29: address 127.0.0.1:5020 stands in line 2 too: give each its own",
            "t:14:12: device name one stands in line 7 too: give each its own",
        ],
    );
}

#[test]
fn bus_15_the_same_unit_on_two_buses_is_fine() {
    let other = charger("").replace("line1", "line2").replace("/tmp/p", "/tmp/q");
    let config = accepted(&format!("{}\n{other}", heater("")));
    assert_eq!(config.buses.iter().map(|bus| bus.devices[0].address.unit).collect::<Vec<_>>(), [4, 4]);
}
