//! A model's tables for people and programs: text table, Markdown, CSV, JSON. Iterates rows, knows no model.

use std::fmt::Write;

use serde::Serialize;

use crate::device::Kind;
use crate::image::{Layout, Member};
use crate::map::{Access, Bank, Keep, Row};
use crate::options::{OptionRange, OptionRow};
use crate::world::{Input, InputRange};

/// A model as JSON shows it: enough to read and write every register by its name.
#[derive(Debug, Serialize)]
pub struct Model {
    /// Its name in devices.toml.
    pub model: &'static str,
    /// What it is.
    pub title: &'static str,
    /// The manual that it is made from.
    pub manual: &'static str,
    /// Function codes that it supports.
    pub functions: &'static [u8],
    /// The most that one message may carry.
    pub limits: Limits,
    /// The line that it offers.
    pub line: LineModel,
    /// Every register, bank by bank with addresses ascending, groups one by one.
    pub registers: Vec<Register>,
    /// The world that it measures.
    pub inputs: Vec<InputModel>,
    /// The options of devices.toml.
    pub options: Vec<OptionModel>,
}

/// The most that one message may carry (BUS-9).
#[derive(Debug, Serialize)]
pub struct Limits {
    /// Registers that one read may ask for.
    pub read_registers: u16,
    /// Coils or discrete inputs that one read may ask for.
    pub read_bits: u16,
    /// Registers that one write may carry.
    pub write_registers: u16,
    /// Coils that one write may carry.
    pub write_bits: u16,
}

/// The line settings that a model offers (BUS-14).
#[derive(Debug, Serialize)]
pub struct LineModel {
    /// Least and largest unit number.
    pub units: [u8; 2],
    /// Speeds in bits a second.
    pub bauds: Vec<u32>,
    /// Parity and stop bits, such as `8N2`.
    pub formats: Vec<String>,
}

/// One register or bit.
#[derive(Debug, Serialize)]
pub struct Register {
    /// `coil`, `discrete`, `input` or `holding`.
    pub bank: &'static str,
    /// Address on the wire of its first word.
    pub address: u16,
    /// Its name.
    pub name: String,
    /// What it means.
    pub about: &'static str,
    /// Words that it takes.
    pub words: u16,
    /// How the words make up the number: `bit`, `u16`, `s16`, `u32`, `s32` (high word first), `whole+decimals` (two
    /// signed words, the second with `scale` digits), `10000s+rest` (ten thousands, then the rest).
    pub format: &'static str,
    /// Unit of measure; empty where it has none.
    pub unit: &'static str,
    /// Decimal digits: the number times 10^-scale is the value in `unit`.
    pub scale: u8,
    /// Smallest number that a write may carry; `null` where it is only read.
    pub min: Option<i64>,
    /// Largest number that a write may carry; `null` where it is only read.
    pub max: Option<i64>,
    /// Where not empty: the only numbers that a write may carry.
    pub one_of: &'static [i64],
    /// A write must carry a multiple of this.
    pub step: i64,
    /// Factory value.
    pub default: i64,
    /// `read`, `read-write`, or `command`: a write acts, and a read gives 0.
    pub access: &'static str,
    /// `ram`, or `eeprom`: kept over a restart.
    pub keep: &'static str,
    /// The clause that it comes from.
    pub clause: &'static str,
}

/// An input of the world.
#[derive(Debug, Serialize)]
pub struct InputModel {
    /// Its name in devices.toml.
    pub name: String,
    /// What it means.
    pub about: &'static str,
    /// Unit of measure; empty where it has none.
    pub unit: &'static str,
    /// `flag` or `number`.
    pub kind: &'static str,
    /// Least; `null` for a flag.
    pub min: Option<f64>,
    /// Most; `null` for a flag.
    pub max: Option<f64>,
    /// Until something else is said.
    pub default: serde_json::Value,
    /// The clause that it comes from.
    pub clause: &'static str,
}

/// An option of devices.toml.
#[derive(Debug, Serialize)]
pub struct OptionModel {
    /// Its key; `a.b` is key `b` of the table `a`.
    pub name: &'static str,
    /// What it does.
    pub about: &'static str,
    /// What it may be, in words.
    pub allowed: String,
    /// Until something else is said.
    pub default: serde_json::Value,
    /// The clause that it comes from.
    pub clause: &'static str,
}

/// A model with all its registers, inputs and options.
pub fn model(kind: &'static Kind) -> Model {
    let profile = &kind.profile;
    let mut formats: Vec<String> = Vec::new();
    for (parity, stop_bits, _) in profile.line.formats {
        let format = format!("8{}{stop_bits}", parity.letter());
        if !formats.contains(&format) {
            formats.push(format);
        }
    }
    Model {
        model: kind.name,
        title: kind.title,
        manual: kind.manual,
        functions: profile.functions,
        limits: Limits {
            read_registers: profile.read_registers_max,
            read_bits: profile.read_bits_max,
            write_registers: profile.write_registers_max,
            write_bits: profile.write_bits_max,
        },
        line: LineModel {
            units: [profile.line.units.0, profile.line.units.1],
            bauds: profile.line.bauds.iter().map(|(baud, _)| *baud).collect(),
            formats,
        },
        registers: Layout::new(kind.map).members().map(register).collect(),
        inputs: kind.inputs.iter().map(input).collect(),
        options: kind.all_options().map(option).collect(),
    }
}

/// A register as it is exported.
pub fn register(member: Member) -> Register {
    let row = member.row;
    let listed = row.one_of.iter().min().zip(row.one_of.iter().max());
    let limits = listed.map_or(row.limits(), |(min, max)| (*min, *max));
    let limits = (row.access != Access::Read).then_some(limits);
    Register {
        bank: row.bank.name(),
        address: member.addr(),
        name: member.name(),
        about: row.about.trim(),
        words: row.words(),
        format: row.format.name(),
        unit: row.unit,
        scale: row.scale,
        min: limits.map(|(min, _)| min),
        max: limits.map(|(_, max)| max),
        one_of: row.one_of,
        step: row.step,
        default: row.default_of(member.index),
        access: access(row),
        keep: keep(row),
        clause: row.cite,
    }
}

fn input(input: &Input) -> InputModel {
    let (kind, min, max, default) = match input.range {
        InputRange::Flag { default } => ("flag", None, None, default.into()),
        InputRange::Number { min, max, default } => ("number", Some(min), Some(max), default.into()),
    };
    let (name, about, unit, clause) = (input.name(), input.about.trim(), input.unit, input.cite);
    InputModel { name, about, unit, kind, min, max, default, clause }
}

fn option(row: &OptionRow) -> OptionModel {
    let default = match row.range {
        OptionRange::Integer(_, _, default) => default.into(),
        OptionRange::Flag(default) => default.into(),
        OptionRange::Choice(choices) => choices[0].into(),
    };
    OptionModel { name: row.name, about: row.about, allowed: row.range.allowed(), default, clause: row.cite }
}

/// What the bus may do with a row: `read`, `read-write` or `command`.
pub const fn access(row: &Row) -> &'static str {
    match row.access {
        Access::Read => "read",
        Access::ReadWrite => "read-write",
        Access::Command => "command",
    }
}

const fn keep(row: &Row) -> &'static str {
    match row.keep {
        Keep::Ram => "ram",
        Keep::Eeprom | Keep::Device => "eeprom",
    }
}

/// What a write may carry; empty where it is only read.
fn range(row: &Row) -> String {
    if row.access == Access::Read { String::new() } else { row.allowed() }
}

/// What a row's number counts: `0.1 V`.
fn counts(row: &Row) -> String {
    match row.scale {
        0 => row.unit.into(),
        digits => format!("0.{}1 {}", "0".repeat(usize::from(digits) - 1), row.unit).trim_end().into(),
    }
}

/// A model as JSON, indented.
pub fn json(kind: &'static Kind) -> String {
    // Serializing plain structs with string keys cannot fail.
    serde_json::to_string_pretty(&model(kind)).unwrap_or_default() + "\n"
}

/// The registers as CSV, one a line, with a line of headings.
pub fn csv(kind: &'static Kind) -> String {
    let mut out = String::from(
        "bank,address,name,words,format,unit,scale,min,max,one_of,step,default,access,keep,clause,about\n",
    );
    let number = |number: Option<i64>| number.map_or(String::new(), |number| number.to_string());
    for register in model(kind).registers {
        let one_of: Vec<String> = register.one_of.iter().map(i64::to_string).collect();
        let fields = [
            register.bank.into(),
            register.address.to_string(),
            register.name,
            register.words.to_string(),
            register.format.into(),
            register.unit.into(),
            register.scale.to_string(),
            number(register.min),
            number(register.max),
            one_of.join(" "),
            register.step.to_string(),
            register.default.to_string(),
            register.access.into(),
            register.keep.into(),
            register.clause.into(),
            register.about.into(),
        ];
        out += &fields.map(|field| csv_field(&field)).join(",");
        out.push('\n');
    }
    out
}

fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}

/// The registers as a table for a terminal, one a line.
pub fn table(kind: &'static Kind) -> String {
    let layout = Layout::new(kind.map);
    let mut lines =
        vec![["BANK", "ADDR", "HEX", "NAME", "FORMAT", "COUNTS", "WRITE", "FACTORY", "MEMORY"].map(String::from)];
    for member in layout.members() {
        let row = member.row;
        lines.push([
            row.bank.name().into(),
            member.addr().to_string(),
            format!("{:04X}", member.addr()),
            member.name(),
            row.format.name().into(),
            counts(row),
            if row.access == Access::Read { "-".into() } else { row.allowed() },
            row.default_of(member.index).to_string(),
            keep(row).into(),
        ]);
    }
    let mut widths = [0; 9];
    for line in &lines {
        for (width, cell) in widths.iter_mut().zip(line) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut out = String::new();
    for line in lines {
        let cells: Vec<String> = line.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        out += cells.join("  ").trim_end();
        out.push('\n');
    }
    out
}

/// The model as Markdown in the manual's layout: a table a bank, a group of registers on one line.
pub fn markdown(kind: &'static Kind) -> String {
    let model = model(kind);
    let functions: Vec<String> = model.functions.iter().map(|function| format!("{function:02}")).collect();
    let mut out =
        format!("# {}: {}\n\nManual: {}. Functions {}. ", kind.name, kind.title, kind.manual, functions.join(", "));
    let (limits, line) = (&model.limits, &model.line);
    let bauds: Vec<String> = line.bauds.iter().map(u32::to_string).collect();
    let _ = writeln!(
        out,
        "Units {} to {}; {} baud; {}. A message carries at most {} registers or {} bits read, {} or {} written.",
        line.units[0],
        line.units[1],
        bauds.join(", "),
        line.formats.join(", "),
        limits.read_registers,
        limits.read_bits,
        limits.write_registers,
        limits.write_bits
    );
    for bank in Bank::ALL {
        bank_table(kind, bank, &mut out);
    }
    if !kind.rules.is_empty() {
        out += "\n## Rules\n\n| a write is refused unless | clause |\n|---|---|\n";
        for rule in kind.rules {
            let _ = writeln!(out, "| {} | {} |", rule.says, rule.cite);
        }
    }
    if !kind.inputs.is_empty() {
        out += "\n## Inputs\n\n| name | meaning | range | default | clause |\n|---|---|---|---|---|\n";
        for input in kind.inputs {
            let default =
                if input.is_flag() { (input.default() != 0.0).to_string() } else { input.default().to_string() };
            let about = input.about.trim();
            let _ = writeln!(out, "| {} | {about} | {} | {default} | {} |", input.name(), input.allowed(), input.cite);
        }
    }
    out += "\n## Options\n\n| name | meaning | range | default | clause |\n|---|---|---|---|---|\n";
    for option in &model.options {
        let OptionModel { name, about, allowed, default, clause } = option;
        let default = default.as_str().map_or(default.to_string(), str::to_owned);
        let _ = writeln!(out, "| {name} | {about} | {allowed} | {default} | {clause} |");
    }
    out
}

fn bank_table(kind: &Kind, bank: Bank, out: &mut String) {
    let title = match bank {
        Bank::Coil => "Coils",
        Bank::Discrete => "Discrete inputs",
        Bank::Input => "Input registers",
        Bank::Holding => "Holding registers",
    };
    let mut rows: Vec<&Row> = kind.map.iter().copied().flatten().filter(|row| row.bank == bank).collect();
    rows.sort_by_key(|row| row.addr);
    if rows.is_empty() {
        return;
    }
    let _ = writeln!(out, "\n## {title}\n");
    *out += "| address | hex | name | meaning | format | counts | write | factory | memory | clause |\n";
    *out += "|---|---|---|---|---|---|---|---|---|---|\n";
    for row in rows {
        let (address, name) = match row.count {
            1 => (row.addr.to_string(), row.ident.to_lowercase()),
            count => (
                format!("{} + {}(n−1)", row.addr, row.stride),
                format!("{}, n = 1 … {count}", row.ident.to_lowercase()),
            ),
        };
        let cells = [
            address,
            format!("{:04X}", row.addr),
            name,
            row.about.trim().replace('|', "\\|"),
            row.format.name().into(),
            counts(row),
            if row.access == Access::Command { format!("{} (command)", range(row)) } else { range(row) },
            factory(row),
            keep(row).into(),
            row.cite.into(),
        ];
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
}

/// The factory value; of a group whose members differ, all of them.
fn factory(row: &Row) -> String {
    if row.defaults.is_empty() {
        return row.default.to_string();
    }
    let values: Vec<String> = row.defaults.iter().map(i64::to_string).collect();
    let rest = if row.defaults.len() < usize::from(row.count) { " …" } else { "" };
    format!("{}{rest}", values.join(", "))
}
