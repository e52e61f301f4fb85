//! Answers of the control interface for people: tables, a line each.

use std::fmt::Write;

use serde_json::Value;

/// A cell: text as it is, nothing for `null`, everything else as JSON.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Columns as wide as their widest cell, under a heading where there is one.
fn table(heading: &[&str], rows: &[Vec<String>]) -> String {
    let heading: Vec<String> = heading.iter().map(|text| (*text).to_owned()).collect();
    let lines = || (!heading.is_empty()).then_some(&heading).into_iter().chain(rows);
    let mut widths: Vec<usize> = Vec::new();
    for line in lines() {
        widths.resize(widths.len().max(line.len()), 0);
        for (width, cell) in widths.iter_mut().zip(line) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut text = String::new();
    for line in lines() {
        let cells: Vec<String> = line.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        let _ = writeln!(text, "{}", cells.join("  ").trim_end());
    }
    text
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// All of a list, or the one thing that is none.
fn each(value: &Value) -> Vec<&Value> {
    match value {
        Value::Null => Vec::new(),
        Value::Array(all) => all.iter().collect(),
        one => vec![one],
    }
}

/// What runs.
pub fn status(status: &Value) -> String {
    let mut text = format!("standin {}, {} s\n", cell(&status["version"]), cell(&status["elapsed_s"]));
    text += &clock(&status["clock"]);
    let fields = ["frames", "replies", "exceptions", "bad_crc", "dropped_bytes"];
    let rows = list(&status["buses"]).iter().map(|bus| {
        let line = &bus["line"];
        let settings = format!("{} {} {}", cell(&line["baud"]), cell(&line["parity"]), cell(&line["stop_bits"]));
        let mut row = vec![cell(&bus["name"]), cell(&bus["path"]), settings];
        row.extend(fields.iter().map(|field| cell(&bus["counters"][*field])));
        row
    });
    let heading = ["BUS", "PATH", "LINE", "FRAMES", "REPLIES", "EXCEPTIONS", "BAD", "DROPPED"];
    text + &table(&heading, &rows.collect::<Vec<_>>())
}

/// Simulated time.
pub fn clock(clock: &Value) -> String {
    format!("{} at rate {}\n", cell(&clock["now"]), cell(&clock["rate"]))
}

/// The devices, a line each.
pub fn devices(devices: &Value) -> String {
    let rows = list(devices).iter().map(|device| {
        let mut row: Vec<String> =
            ["name", "model", "bus", "unit", "boots"].iter().map(|field| cell(&device[*field])).collect();
        row.push(running(device).into());
        row
    });
    table(&["DEVICE", "MODEL", "BUS", "UNIT", "BOOTS", "STATE"], &rows.collect::<Vec<_>>())
}

fn running(device: &Value) -> &'static str {
    match (device["powered"].as_bool(), device["listening"].as_bool()) {
        (Some(true), Some(true)) => "on",
        (Some(true), _) => "restarting",
        _ => "off",
    }
}

/// The state of a device after something was done to it.
pub fn state(device: &Value) -> String {
    format!("{} is {}\n", cell(&device["name"]), running(device))
}

/// A device with all that it shows, or only readings.
pub fn device(device: &Value) -> String {
    if device["registers"].as_object().is_none() {
        return readings(device);
    }
    let mut text = devices(&Value::Array(vec![device.clone()]));
    for group in ["inputs", "coils", "registers"] {
        let _ = write!(text, "\n{}\n{}", group.to_uppercase(), readings(&device[group]));
    }
    text
}

/// Readings by name: the value, its unit, and the raw number where it is another.
pub fn readings(readings: &Value) -> String {
    let all = readings.as_object().into_iter().flatten();
    let rows = all.map(|(name, reading)| {
        let (value, raw) = (cell(&reading["value"]), cell(&reading["raw"]));
        let is_plain = raw.is_empty() || raw == value || reading["value"].is_boolean();
        let raw = if is_plain { String::new() } else { format!("(raw {raw})") };
        vec![name.clone(), value, cell(&reading["unit"]), raw]
    });
    table(&[], &rows.collect::<Vec<_>>())
}

/// Faults, and what each has done.
pub fn faults(faults: &Value) -> String {
    let own = ["id", "kind", "bus", "device", "hits", "active"];
    let rows = each(faults).into_iter().map(|fault| {
        let mut row: Vec<String> = own.iter().map(|field| cell(&fault[*field])).collect();
        let rest = fault.as_object().into_iter().flatten().filter(|(name, _)| !own.contains(&name.as_str()));
        row.push(rest.map(|(name, value)| format!("{name}={}", cell(value))).collect::<Vec<_>>().join(" "));
        row
    });
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        String::new()
    } else {
        table(&["ID", "KIND", "BUS", "DEVICE", "HITS", "ACTIVE", "MORE"], &rows)
    }
}

/// Requests and what came of them; or how many.
pub fn journal(journal: &Value) -> String {
    if let Some(count) = journal.get("count") {
        return format!("{count}\n");
    }
    let mut text = String::new();
    for entry in list(journal) {
        text += &exchange(entry);
    }
    text
}

/// A request in a line, and below it why it was not done and what it may have been meant to be.
fn exchange(entry: &Value) -> String {
    let who = match entry["device"].as_str() {
        Some(device) => device.to_owned(),
        None => format!("unit {}", cell(&entry["unit"])),
    };
    let span = match (&entry["address"], &entry["quantity"]) {
        (Value::Null, _) => String::new(),
        (address, quantity) if quantity == 1 => format!(" {address}"),
        (address, quantity) => format!(" {address}+{quantity}"),
    };
    let values = list(&entry["values"]).iter().map(cell).collect::<Vec<_>>().join(" ");
    let what = format!("{}{span}", cell(&entry["function_name"]));
    let outcome = match (entry["outcome"].as_str(), entry["code"].as_u64()) {
        (Some("exception"), Some(code)) => format!("exception {code:02}"),
        (Some(outcome), _) => outcome.to_owned(),
        (None, _) => String::new(),
    };
    let took = entry["reply_ms"].as_f64().map_or(String::new(), |ms| format!(", {ms} ms"));
    let values = if values.is_empty() { String::new() } else { format!(" [{values}]") };
    let mut text = format!("{} {} {who}: {what}{values}: {outcome}{took}\n", cell(&entry["now"]), cell(&entry["bus"]));
    if let Some(reason) = entry["reason"].as_str() {
        let clause = entry["clause"].as_str().map_or(String::new(), |clause| format!(" ({clause})"));
        let _ = writeln!(text, "    {reason}{clause}");
    }
    for fault in list(&entry["faults"]) {
        let _ = writeln!(text, "    fault {}: {}", cell(&fault["id"]), cell(&fault["kind"]));
    }
    if let Some(hint) = entry["hint"].as_str() {
        let _ = writeln!(text, "    hint: {hint}");
    }
    text
}

/// Snapshots.
pub fn snapshots(snapshots: &Value) -> String {
    let rows = each(snapshots).into_iter().map(|kept| vec![cell(&kept["name"]), cell(&kept["now"])]);
    table(&[], &rows.collect::<Vec<_>>())
}

/// An event in a line.
pub fn event(name: &str, data: &Value) -> String {
    let head = format!("{} {}", cell(&data["now"]), cell(&data["device"]));
    match name {
        "exchange" => exchange(data),
        "change" => {
            let (was, value, unit) = (cell(&data["was"]), cell(&data["value"]), cell(&data["unit"]));
            format!("{head}: {} {was} -> {value} {unit}", cell(&data["register"])).trim_end().to_owned() + "\n"
        }
        "boot" => format!("{head}: start {}\n", cell(&data["boots"])),
        "power" => format!("{head}: power {}\n", if data["powered"] == true { "on" } else { "off" }),
        "fault" => format!("{}: fault {} hits: {}\n", cell(&data["bus"]), cell(&data["id"]), cell(&data["kind"])),
        "lost" => format!("{} events are lost: this reader is too slow\n", cell(&data["count"])),
        other => format!("{other} {data}\n"),
    }
}
