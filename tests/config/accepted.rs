//! What is accepted, and what the command line says in place of the file.

use std::net::SocketAddr;
use std::path::PathBuf;

use standin::bus::{LineCheck, Settings, Timing};
use standin::config::{Control, EXAMPLE, Overrides, Port, Start};
use standin::line::{Line, Parity};
use standin::time::civil;

use crate::{accepted, heater, parse_with};

#[test]
fn the_least_file_has_every_default() {
    let config = accepted(&heater(""));
    assert_eq!((config.state, config.start, config.rate, config.control), (None, Start::Host, 1.0, None));
    assert_eq!(config.buses.len(), 1);
    let bus = &config.buses[0];
    let line = Line { baud: 9600, parity: Parity::None, stop_bits: 2 };
    let settings = Settings { line, timing: Timing::Fast, line_check: LineCheck::Warn, slack_ms: 20 };
    assert_eq!((bus.name.as_str(), bus.settings, bus.max_clients), ("line1", settings, 64));
    assert_eq!(bus.ports, [Port::Pty("/tmp/p".into())]);
    let device = &bus.devices[0];
    assert_eq!((device.name.as_str(), device.kind.name), ("heater", "hmi-volcano-ec"));
    assert_eq!((device.address.unit, device.address.line), (4, line));
    assert!(device.inputs.is_empty() && device.registers.is_empty() && config.warnings.is_empty());
}

#[test]
fn everything_that_can_be_set_arrives() {
    let config = accepted(
        r#"
        state = "memory"
        [clock]
        start = "2014-10-27T14:22:08"
        rate = 60
        [control]
        listen = "127.0.0.1:8502"
        hosts = ["Bench.example"]
        [[bus]]
        name = "line1"
        ports = ["pty:/tmp/p", "serial:/dev/ttyUSB0", "tcp:127.0.0.1:5020", "modbus-tcp:localhost:5502"]
        baud = 19_200
        parity = "even"
        stop_bits = 1
        timing = "wire"
        line_check = "enforce"
        slack_ms = 5
        max_clients = 2
        [[bus.device]]
        name = "heater"
        model = "hmi-volcano-ec"
        unit = 0x11
        inputs = { room_temperature = 18, ntc_1_fault = true }
        registers = { power_on_off = false, ntc_1_correct = -50 }
        options = { boot_ms = 10 }
        "#,
    );
    assert_eq!(config.state, Some(PathBuf::from("memory")));
    assert_eq!((config.start, config.rate), (Start::At(civil(2014, 10, 27, 14, 22, 8)), 60.0));
    let listen: SocketAddr = "127.0.0.1:8502".parse().unwrap();
    assert_eq!(config.control, Some(Control { listen, token: None, hosts: vec!["bench.example".into()] }));
    let bus = &config.buses[0];
    let ports: Vec<String> = bus.ports.iter().map(Port::to_string).collect();
    assert_eq!(ports, ["pty:/tmp/p", "serial:/dev/ttyUSB0", "tcp:127.0.0.1:5020", "modbus-tcp:127.0.0.1:5502"]);
    let line = Line { baud: 19_200, parity: Parity::Even, stop_bits: 1 };
    let settings = Settings { line, timing: Timing::Wire, line_check: LineCheck::Enforce, slack_ms: 5 };
    assert_eq!((bus.settings, bus.max_clients), (settings, 2));
    let device = &bus.devices[0];
    assert_eq!(device.address.unit, 17);
    let input = |name: &str| device.kind.input(name).unwrap();
    let mut inputs = device.inputs.clone();
    inputs.sort_by_key(|(index, _)| *index);
    assert_eq!(inputs, [(input("room_temperature"), 18.0), (input("ntc_1_fault"), 1.0)]);
    assert_eq!(device.registers, [("power_on_off".to_owned(), 0), ("ntc_1_correct".to_owned(), -50)]);
    assert_eq!((device.options.integer("boot_ms"), device.options.integer("response_delay_ms")), (10, 0));
}

#[test]
fn the_clock_starts_at_text_or_at_a_toml_date_time() {
    let at = |value: &str| accepted(&format!("clock.start = {value}\n{}", heater(""))).start;
    assert_eq!(at("\"host\""), Start::Host);
    let start = Start::At(civil(2014, 10, 27, 14, 22, 8));
    for value in ["\"2014-10-27T14:22:08\"", "\"2014-10-27 14:22:08\"", "2014-10-27T14:22:08", "2014-10-27 14:22:08"] {
        assert_eq!(at(value), start, "{value}");
    }
    assert_eq!(at("\"2099-12-31T23:59\""), Start::At(civil(2099, 12, 31, 23, 59, 0)));
    assert_eq!(at("2000-01-01T00:00:00"), Start::At(civil(2000, 1, 1, 0, 0, 0)));
}

#[test]
fn the_example_is_accepted_and_holds_every_manual_once() {
    let config = accepted(EXAMPLE);
    assert_eq!(config.buses.len(), 1);
    let models: Vec<&str> = config.buses[0].devices.iter().map(|device| device.kind.name).collect();
    assert_eq!(models, ["kael-astro-01", "logiccon-trc", "logiccon-pfc24s-tcr", "hmi-volcano-ec"]);
    assert_eq!(config.buses[0].ports, [Port::Pty("/tmp/standin/line1".into())]);
    assert_eq!(config.buses[0].settings.line.to_string(), "9600 8N2");
    assert_eq!(config.warnings, [""; 0]);
}

#[test]
fn the_examples_comments_are_settings_that_work() {
    // A line such as `# state = "state"` shows a setting: without the mark the file is as good.
    let is_setting = |line: &str| {
        line.strip_prefix("# ").is_some_and(|rest| {
            rest.starts_with('[')
                || rest
                    .split_once(" = ")
                    .is_some_and(|(key, _)| key.chars().all(|c| c.is_ascii_lowercase() || c == '_'))
        })
    };
    let shown: Vec<String> =
        EXAMPLE.lines().map(|line| if is_setting(line) { line[2..].to_owned() } else { line.to_owned() }).collect();
    assert!(shown.iter().filter(|line| !EXAMPLE.lines().any(|was| was == line.as_str())).count() >= 5);
    let config = accepted(&shown.join("\n"));
    assert_eq!(config.state, Some("state".into()));
    assert_eq!(config.buses[0].max_clients, 64);
    assert_eq!(config.control.unwrap().listen, "127.0.0.1:8502".parse().unwrap());
}

#[test]
fn a_limit_of_clients_without_a_tcp_port_is_a_warning() {
    let config = accepted(&heater("").replace("[[bus]]\n", "[[bus]]\nmax_clients = 3\n"));
    let text = "max_clients counts those of tcp: and modbus-tcp: ports, and this bus has none";
    assert!(config.warnings.len() == 1 && config.warnings[0].ends_with(text), "{:?}", config.warnings);
}

#[test]
fn the_command_line_wins_over_the_file() {
    let listen = "127.0.0.1:9".parse().unwrap();
    let start = Start::At(civil(2020, 1, 1, 0, 0, 0));
    let overrides = Overrides { state: Some("s".into()), start: Some(start), rate: Some(0.0), listen: Some(listen) };
    let text = format!(
        "state = \"memory\"\n[clock]\nstart = 2014-10-27T14:22:08\nrate = 2\n[control]\nlisten = \"127.0.0.1:1\"\ntoken = \"k\"\n{}",
        heater("")
    );
    let config = parse_with(&text, &overrides).unwrap();
    assert_eq!((config.state, config.start, config.rate), (Some("s".into()), start, 0.0));
    assert_eq!(config.control, Some(Control { listen, token: Some("k".into()), hosts: vec![] }));
    let config = parse_with(&heater(""), &overrides).unwrap();
    assert_eq!(config.control, Some(Control { listen, token: None, hosts: vec![] }));
}

#[test]
fn ctl_1_an_address_of_the_command_line_needs_the_token_too() {
    let overrides = Overrides { listen: Some("0.0.0.0:8502".parse().unwrap()), ..Overrides::default() };
    let expected = "t: --listen takes a loopback address such as 127.0.0.1:8502 unless [control] has a token or token_file, not 0.0.0.0:8502";
    assert_eq!(parse_with(&heater(""), &overrides).unwrap_err(), expected);
    let with_token = format!("[control]\ntoken = \"secret\"\n{}", heater(""));
    let control = parse_with(&with_token, &overrides).unwrap().control.unwrap();
    assert_eq!(control.token.as_deref(), Some("secret"));
}
