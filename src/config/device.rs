//! A `[[bus.device]]` of devices.toml: model, unit, inputs, options and start values, judged by the model's own tables
//! and rules. Names no model.

use std::collections::HashMap;
use std::sync::Arc;

use toml::de::DeValue;

use crate::bus::LineCheck;
use crate::device::Kind;
use crate::devices::{KINDS, kind};
use crate::image::{Layout, Member};
use crate::line::{Address, LineOffer};
use crate::map::{Access, Point};
use crate::options::{OptionValue, Options};
use crate::station::{Setup, Station};
use crate::time::SimClock;

use super::bus::LineEntry;
use super::reader::{Entry, Problems, Table, integer, number, shown};
use super::{Seen, name, unique};

/// The largest unit number that Modbus does not reserve.
const UNIT_MAX: u8 = 247;

/// Reads a device; `None` where something that it cannot be without is wrong, which has been noted.
pub(super) fn read(
    mut table: Table,
    line: LineEntry,
    clock: &SimClock,
    units: &mut HashMap<String, usize>,
    seen: &mut Seen,
    problems: &mut Problems,
) -> Option<Setup> {
    let before = problems.errors_so_far();
    let name_entry = table.need("name", "\"yard\"", problems);
    let device_name = name_entry.and_then(|entry| name(entry, "device name", |seen| &mut seen.devices, seen, problems));
    let first_kind = KINDS.first().map_or("", |kind| kind.name);
    let model = table.need("model", &format!("{first_kind:?}"), problems);
    let kind = model.and_then(|entry| read_model(entry, problems));
    let unit_entry = table.need("unit", "1", problems);
    let unit = unit_entry.and_then(|entry| read_unit(entry, kind, units, problems));
    let inputs = sub_table(&mut table, "inputs", problems);
    let options_table = sub_table(&mut table, "options", problems);
    let registers = sub_table(&mut table, "registers", problems);
    table.finish(problems);
    let kind = kind?;
    judge_line(device_name.as_deref().unwrap_or("the device"), kind, line, problems);
    let inputs = inputs.map_or(Vec::new(), |inputs| read_inputs(&inputs, kind, problems));
    let mut options = Options::defaults(kind);
    if let Some(table) = options_table {
        read_options(&table, "", kind, &mut options, problems);
    }
    let layout = seen.layouts.entry(kind.name).or_insert_with(|| Arc::new(Layout::new(kind.map)));
    let registers_at = registers.as_ref().map(|table| table.at);
    let registers = registers.map_or(Vec::new(), |table| read_registers(&table, kind, layout, &options, problems));
    let address = Address { unit: unit?, line: line.line };
    let setup = Setup { name: device_name?, kind, address, options, inputs, registers };
    if let Some(at) = registers_at
        && problems.errors_so_far() == before
        && let Err(reasons) = Station::new(setup.clone(), Arc::clone(layout), None, clock)
    {
        for reason in reasons {
            problems.error(at, format!("{} refuses these start values: {reason}", setup.name));
        }
    }
    Some(setup)
}

fn read_model(entry: Entry, problems: &mut Problems) -> Option<&'static Kind> {
    let found = entry.value.as_str().and_then(kind);
    if found.is_none() {
        let models: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        let near = entry.value.as_str().map_or(String::new(), |name| problems.nearest(name, models.iter().copied(), 1));
        problems.error(entry.at, format!("{}{near}", entry.refusal(&format!("one of {}", models.join(", ")))));
    }
    found
}

fn read_unit(
    entry: Entry,
    kind: Option<&'static Kind>,
    units: &mut HashMap<String, usize>,
    problems: &mut Problems,
) -> Option<u8> {
    let (min, max) = kind.map_or((1, u8::MAX), |kind| kind.profile.line.units);
    let unit = integer(entry.value).and_then(|unit| u8::try_from(unit).ok());
    let Some(unit) = unit.filter(|unit| (min..=max).contains(unit)) else {
        let of = kind.map_or(String::new(), |kind| format!(" for {}", kind.name));
        return entry.refuse(&format!("a whole number, {min} to {max}{of}"), problems);
    };
    if unit > UNIT_MAX {
        let message =
            format!("unit {unit} is reserved by Modbus, whose units end at {UNIT_MAX}: many masters refuse it");
        problems.warn(entry.at, message);
    }
    // Broadcasts alone reach unit 0: any number of devices can have it.
    let is_first = unit == 0 || unique("on this bus unit", &unit.to_string(), entry.at, units, problems);
    is_first.then_some(unit)
}

fn sub_table<'a>(table: &mut Table<'a>, key: &'static str, problems: &mut Problems) -> Option<Table<'a>> {
    let entry = table.get(key)?;
    match entry.value {
        DeValue::Table(entries) => Some(Table::new(key, entry.key_at, entries)),
        _ => entry.refuse(&format!("a table, such as {key} = {{ … }}"), problems),
    }
}

/// A line setting that the model does not offer is an error, and with `line_check = "off"` a warning (BUS-14).
fn judge_line(name: &str, kind: &Kind, entry: LineEntry, problems: &mut Problems) {
    for missing in kind.profile.line.missing(entry.line) {
        let at = if missing.starts_with("baud") { entry.baud_at } else { entry.format_at };
        let message = format!("{name} ({}) does not offer {missing}", kind.name);
        match entry.check {
            LineCheck::Off => problems.warn(at, format!("{message}; its register shows the factory value")),
            _ => problems.error(at, message),
        }
    }
}

fn read_inputs(table: &Table, kind: &'static Kind, problems: &mut Problems) -> Vec<(usize, f64)> {
    let mut values = Vec::new();
    for entry in table.entries() {
        let Some(index) = kind.input(entry.key) else {
            let near = problems.nearest(entry.key, kind.inputs.iter().map(|input| input.name()), 3);
            problems.error(entry.key_at, format!("{} has no input {:?}{near}", kind.name, entry.key));
            continue;
        };
        let input = &kind.inputs[index];
        let value = match entry.value {
            DeValue::Boolean(flag) if input.is_flag() => Some(f64::from(u8::from(*flag))),
            value if !input.is_flag() => number(value),
            _ => None,
        };
        match value.filter(|value| input.admits(*value)) {
            Some(value) => values.push((index, value)),
            None => problems.error(entry.at, entry.refusal(&input.allowed())),
        }
    }
    values
}

/// Reads the options of a table; nested tables make dotted names.
fn read_options(table: &Table, prefix: &str, kind: &'static Kind, options: &mut Options, problems: &mut Problems) {
    for entry in table.entries() {
        let name = format!("{prefix}{}", entry.key);
        let nested = format!("{name}.");
        if let DeValue::Table(entries) = entry.value
            && kind.all_options().any(|row| row.name.starts_with(&nested))
        {
            read_options(&Table::new(&name, entry.at, entries), &nested, kind, options, problems);
            continue;
        }
        let Some(row) = kind.all_options().find(|row| row.name == name) else {
            let near = problems.nearest(&name, kind.all_options().map(|row| row.name), 2);
            problems.error(entry.key_at, format!("{} has no option {name:?}{near}", kind.name));
            continue;
        };
        let allowed = match option_value(entry.value) {
            Some(value) => options.set(row, value),
            // No row takes a value of this type: the answer is what the row does take.
            None => options.set(row, OptionValue::Choice(String::new())),
        };
        if let Err(allowed) = allowed {
            problems.error(entry.at, format!("{name} takes {allowed}, not {}", shown(entry.value)));
        }
    }
}

fn option_value(value: &DeValue) -> Option<OptionValue> {
    match value {
        DeValue::Boolean(flag) => Some(OptionValue::Flag(*flag)),
        DeValue::Integer(_) => integer(value).map(OptionValue::Integer),
        DeValue::String(word) => Some(OptionValue::Choice(word.to_string())),
        _ => None,
    }
}

/// Reads start values and judges each alone; together they are judged by the station that they start.
fn read_registers(
    table: &Table,
    kind: &'static Kind,
    layout: &Layout,
    options: &Options,
    problems: &mut Problems,
) -> Vec<(String, i64)> {
    let device = (kind.build)(options);
    let mut values = Vec::new();
    for entry in table.entries() {
        let Some(member) = layout.named(entry.key) else {
            let near = problems.nearest(entry.key, layout.members().map(|member| member.name()), 3);
            let near = if near.is_empty() { ";".into() } else { near };
            let list = format!("`standin registers {}` lists them", kind.name);
            problems.error(entry.key_at, format!("{} has no register {:?}{near} {list}", kind.name, entry.key));
            continue;
        };
        if let Some(place) = set_elsewhere(&kind.profile.line, member) {
            problems.error(entry.key_at, format!("{} is set by {place}, not under registers", entry.key));
            continue;
        }
        if member.row.access == Access::Read {
            let message = format!("{} is only read: it has no start value ({})", entry.key, member.row.cite);
            problems.error(entry.key_at, message);
            continue;
        }
        let raw = match entry.value {
            DeValue::Boolean(flag) if member.row.bank.is_bits() => Some(i64::from(*flag)),
            value => integer(value),
        };
        let fits = |raw: &i64| member.row.format.encode(*raw, device.scale(member.row)).is_some();
        match raw.filter(|raw| fits(raw) && device.admits(member.row, *raw)) {
            Some(raw) => values.push((entry.key.to_owned(), raw)),
            None => {
                let allowed = format!("{} ({})", entry.refusal(&member.row.allowed()), member.row.cite);
                problems.error(entry.at, allowed);
            }
        }
    }
    values
}

/// Where a unit or line register is set instead.
fn set_elsewhere(offer: &LineOffer, member: Member) -> Option<&'static str> {
    let is = |point: Point<u16>| (point.bank(), point.addr()) == (member.row.bank, member.addr());
    if is(offer.unit) {
        return Some("the device's key `unit`");
    }
    if is(offer.baud) {
        return Some("the bus' key `baud`");
    }
    let of_format = offer.formats.iter().flat_map(|format| format.2).any(|(point, _)| is(*point));
    of_format.then_some("the bus' keys `parity` and `stop_bits`")
}
