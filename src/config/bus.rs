//! A `[[bus]]` of devices.toml: its doors, its line, its timing.

use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

use toml::de::DeValue;

use crate::bus::{LineCheck, Settings, Timing};
use crate::line::{Line, Parity};
use crate::time::SimClock;

use super::reader::{Entry, Problems, Table, shown};
use super::{BusConfig, Port, Seen, device, is_path, name, parse_address, unique};

/// The most clients of a TCP port where the file says nothing.
const MAX_CLIENTS: usize = 64;

/// The bus' line and the places where the file sets it.
#[derive(Clone, Copy, Debug)]
pub(super) struct LineEntry {
    pub(super) line: Line,
    pub(super) check: LineCheck,
    pub(super) baud_at: usize,
    pub(super) format_at: usize,
}

/// Reads a bus; `None` where it has no name, which is an error that has been noted.
pub(super) fn read(mut table: Table, clock: &SimClock, seen: &mut Seen, problems: &mut Problems) -> Option<BusConfig> {
    let name_entry = table.need("name", "\"line1\"", problems);
    let bus_name = name_entry.and_then(|entry| name(entry, "bus name", |seen| &mut seen.buses, seen, problems));
    let ports = read_ports(&mut table, seen, problems);
    let max_clients = read_max_clients(&mut table, &ports, problems);
    let (entry, settings) = read_settings(&mut table, problems);
    let devices = table.tables("device", "[[bus.device]]", problems);
    if devices.is_empty() {
        problems.warn(table.at, "this bus has no [[bus.device]]: nobody answers on it");
    }
    let mut units = HashMap::new();
    let devices =
        devices.into_iter().filter_map(|device| device::read(device, entry, clock, &mut units, seen, problems));
    let devices = devices.collect();
    table.finish(problems);
    Some(BusConfig { name: bus_name?, ports, max_clients, settings, devices })
}

fn read_settings(table: &mut Table, problems: &mut Problems) -> (LineEntry, Settings) {
    let entry = table.get("baud");
    let baud_at = entry.map_or(table.at, |entry| entry.at);
    let baud = entry.and_then(|entry| entry.integer(50, 4_000_000, problems)).unwrap_or(9600) as u32;
    let parity_entry = table.get("parity");
    let parities = [("none", Parity::None), ("even", Parity::Even), ("odd", Parity::Odd)];
    let parity = parity_entry.and_then(|entry| entry.choice(&parities, problems)).unwrap_or(Parity::None);
    let stop_entry = table.get("stop_bits");
    let stop_bits = stop_entry.and_then(|entry| entry.integer(1, 2, problems)).unwrap_or(2) as u8;
    let timings = [("fast", Timing::Fast), ("wire", Timing::Wire)];
    let timing = table.get("timing").and_then(|entry| entry.choice(&timings, problems)).unwrap_or_default();
    let checks = [("warn", LineCheck::Warn), ("enforce", LineCheck::Enforce), ("off", LineCheck::Off)];
    let check = table.get("line_check").and_then(|entry| entry.choice(&checks, problems)).unwrap_or_default();
    let slack_ms = table.get("slack_ms").and_then(|entry| entry.integer(0, 10_000, problems)).unwrap_or(20) as u64;
    let line = Line { baud, parity, stop_bits };
    let format_at = parity_entry.or(stop_entry).map_or(table.at, |entry| entry.at);
    (LineEntry { line, check, baud_at, format_at }, Settings { line, timing, line_check: check, slack_ms })
}

fn read_ports(table: &mut Table, seen: &mut Seen, problems: &mut Problems) -> Vec<Port> {
    let (one, several) = (table.get("port"), table.get("ports"));
    match (one, several) {
        (Some(entry), None) => read_port(entry.key, entry.at, entry.value, seen, problems).into_iter().collect(),
        (None, Some(entry)) => read_list(entry, seen, problems),
        (Some(_), Some(entry)) => {
            problems.error(entry.key_at, "port and ports exclude each other: put all doors into ports");
            Vec::new()
        }
        (None, None) => {
            let example = "port = \"pty:/tmp/standin/line1\"";
            problems.error(table.at, format!("{} needs port, for example {example}", table.name));
            Vec::new()
        }
    }
}

fn read_max_clients(table: &mut Table, ports: &[Port], problems: &mut Problems) -> usize {
    let Some(entry) = table.get("max_clients") else { return MAX_CLIENTS };
    if !ports.is_empty() && !ports.iter().any(|port| matches!(port, Port::Tcp(_) | Port::ModbusTcp(_))) {
        problems.warn(entry.key_at, "max_clients counts those of tcp: and modbus-tcp: ports, and this bus has none");
    }
    entry.integer(1, 1000, problems).map_or(MAX_CLIENTS, |count| count as usize)
}

fn read_list(entry: Entry, seen: &mut Seen, problems: &mut Problems) -> Vec<Port> {
    match entry.value {
        DeValue::Array(items) if !items.is_empty() => {
            let port =
                |item: &toml::Spanned<DeValue>| read_port(entry.key, item.span().start, item.get_ref(), seen, problems);
            items.iter().filter_map(port).collect()
        }
        DeValue::Array(_) => {
            problems.error(entry.at, "ports takes at least one port, such as [\"pty:/tmp/standin/line1\"]");
            Vec::new()
        }
        _ => {
            problems.error(entry.at, entry.refusal("a list of ports, such as [\"pty:/tmp/standin/line1\"]"));
            Vec::new()
        }
    }
}

fn read_port(key: &str, at: usize, value: &DeValue, seen: &mut Seen, problems: &mut Problems) -> Option<Port> {
    let Some(port) = value.as_str().and_then(parse_port) else {
        let allowed = "\"pty:PATH\", \"serial:PATH\", \"tcp:ADDRESS:PORT\" or \"modbus-tcp:ADDRESS:PORT\"";
        problems.error(at, format!("{key} takes {allowed}, not {}", shown(value)));
        return None;
    };
    let door = match &port {
        Port::Pty(path) | Port::Serial(path) => Some(plain(path).display().to_string()),
        // The system picks port 0 anew for each.
        Port::Tcp(addr) | Port::ModbusTcp(addr) => (addr.port() != 0).then(|| addr.to_string()),
    };
    let what = if matches!(port, Port::Pty(_) | Port::Serial(_)) { "path" } else { "address" };
    let is_first = door.is_none_or(|door| unique(what, &door, at, &mut seen.doors, problems));
    is_first.then_some(port)
}

fn parse_port(text: &str) -> Option<Port> {
    let (kind, place) = text.split_once(':')?;
    match kind {
        "pty" if is_path(place) && Path::new(place).file_name().is_some() => Some(Port::Pty(place.into())),
        "serial" if is_path(place) => Some(Port::Serial(place.into())),
        "tcp" => parse_address(place).ok().map(Port::Tcp),
        "modbus-tcp" => parse_address(place).ok().map(Port::ModbusTcp),
        _ => None,
    }
}

/// The path from the root on, without `.` and `..`, as far as that can be told without looking.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path).unwrap_or_else(|_| path.into()).components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            part => plain.push(part),
        }
    }
    plain
}
