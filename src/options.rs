//! Options of a device in devices.toml: declared with the model, judged before the device is built.

use std::collections::BTreeMap;

use crate::device::Kind;

/// An option of a device in devices.toml; `a.b` is key `b` of the table `a`.
#[derive(Clone, Copy, Debug)]
pub struct OptionRow {
    /// Its key.
    pub name: &'static str,
    /// What it does.
    pub about: &'static str,
    /// What it may be, and what it is until said.
    pub range: OptionRange,
    /// The clause that it comes from.
    pub cite: &'static str,
}

/// What an option may be; the default comes last, or first of the choices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionRange {
    /// A whole number: least, most, default.
    Integer(i64, i64, i64),
    /// True or false: default.
    Flag(bool),
    /// One of these words, the first being the default.
    Choice(&'static [&'static str]),
}

impl OptionRange {
    /// What the option may be, in words.
    pub fn allowed(&self) -> String {
        match self {
            OptionRange::Integer(min, max, _) => format!("a whole number, {min} to {max}"),
            OptionRange::Flag(_) => "true or false".into(),
            OptionRange::Choice(choices) => format!("\"{}\"", choices.join("\" or \"")),
        }
    }
}

/// Options that every device has.
pub const COMMON_OPTIONS: &[OptionRow] = &[OptionRow {
    name: "response_delay_ms",
    about: "time that the device takes before it answers, added in both timings",
    range: OptionRange::Integer(0, 60_000, 0),
    cite: "BUS-17",
}];

/// The option of models that answer a damaged frame (BUS-4).
pub const CRC_ERROR_REPLY: OptionRow = OptionRow {
    name: "crc_error_reply",
    about: "what a frame with a wrong CRC gets",
    range: OptionRange::Choice(&["exception", "silent"]),
    cite: "BUS-4",
};

/// The option of models that are silent while they restart.
pub const BOOT_MS: OptionRow = OptionRow {
    name: "boot_ms",
    about: "time without answers while the device restarts",
    range: OptionRange::Integer(0, 600_000, 500),
    cite: "ASTRO-80, VOL-3",
};

/// The value of an option.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OptionValue {
    /// A whole number.
    Integer(i64),
    /// True or false.
    Flag(bool),
    /// A word.
    Choice(String),
}

/// The options of one device: complete, every value one that its row allows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    values: BTreeMap<&'static str, OptionValue>,
}

impl Options {
    /// All options of a model at their defaults.
    pub fn defaults(kind: &Kind) -> Self {
        let value = |row: &OptionRow| match row.range {
            OptionRange::Integer(_, _, default) => OptionValue::Integer(default),
            OptionRange::Flag(default) => OptionValue::Flag(default),
            OptionRange::Choice(choices) => OptionValue::Choice(choices[0].into()),
        };
        Self { values: kind.all_options().map(|row| (row.name, value(row))).collect() }
    }

    /// Sets an option.
    ///
    /// # Errors
    /// What is allowed, where the value is not.
    pub fn set(&mut self, row: &'static OptionRow, value: OptionValue) -> Result<(), String> {
        let allowed = match (&row.range, &value) {
            (OptionRange::Integer(min, max, _), OptionValue::Integer(number)) => (min..=max).contains(&number),
            (OptionRange::Flag(_), OptionValue::Flag(_)) => true,
            (OptionRange::Choice(choices), OptionValue::Choice(word)) => choices.contains(&word.as_str()),
            _ => false,
        };
        if !allowed {
            return Err(row.range.allowed());
        }
        self.values.insert(row.name, value);
        Ok(())
    }

    /// A whole number; 0 where the model has no such option.
    pub fn integer(&self, name: &str) -> i64 {
        match self.values.get(name) {
            Some(OptionValue::Integer(number)) => *number,
            _ => 0,
        }
    }

    /// A yes or no; false where the model has no such option.
    pub fn flag(&self, name: &str) -> bool {
        matches!(self.values.get(name), Some(OptionValue::Flag(true)))
    }

    /// Whether an option is set to this word.
    pub fn is(&self, name: &str, word: &str) -> bool {
        matches!(self.values.get(name), Some(OptionValue::Choice(choice)) if choice == word)
    }
}
