//! Reading a TOML document with the place of everything in it, and collecting what is wrong. Knows TOML, not the keys.

use std::collections::HashSet;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// What was found wrong so far, by its place in the text.
#[derive(Debug)]
pub(super) struct Problems<'a> {
    text: &'a str,
    line_starts: Vec<usize>,
    errors: Vec<(usize, String)>,
    warnings: Vec<(usize, String)>,
    /// Places of which everything has been said.
    settled: HashSet<usize>,
}

/// Line and column, both from 1, and what is wrong there.
pub(super) type Found = ((usize, usize), String);

/// After so many errors nobody is helped by looking for what else was meant, and it takes its time.
const ERRORS_WITH_ADVICE: usize = 200;

impl<'a> Problems<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(at, _)| at + 1)).collect();
        Self { text, line_starts, errors: Vec::new(), warnings: Vec::new(), settled: HashSet::new() }
    }

    pub(super) fn error(&mut self, at: usize, message: impl Into<String>) {
        if !self.settled.contains(&at) {
            self.errors.push((at, message.into()));
        }
    }

    /// What is wrong at a place has been said: what else is found there only follows from it.
    pub(super) fn settle(&mut self, at: usize) {
        self.settled.insert(at);
    }

    pub(super) fn warn(&mut self, at: usize, message: impl Into<String>) {
        self.warnings.push((at, message.into()));
    }

    pub(super) fn errors_so_far(&self) -> usize {
        self.errors.len()
    }

    /// The line of a place in the text, from 1.
    pub(super) fn line(&self, at: usize) -> usize {
        self.line_starts.partition_point(|start| *start <= at)
    }

    /// The known names that are most like `name`, at most `count` of them, as the end of an error text; empty where
    /// none is like it.
    pub(super) fn nearest(
        &self,
        name: &str,
        known: impl IntoIterator<Item = impl Into<String>>,
        count: usize,
    ) -> String {
        if self.errors.len() > ERRORS_WITH_ADVICE {
            return String::new();
        }
        let mut near: Vec<(f64, String)> =
            known.into_iter().map(Into::into).map(|known| (likeness(name, &known), known)).collect();
        near.sort_by(|(one, name), (other, other_name)| other.total_cmp(one).then_with(|| name.cmp(other_name)));
        let least = near.first().map_or(LIKENESS_MIN, |(best, _)| LIKENESS_MIN.max(best - LIKENESS_SPREAD));
        near.retain(|(likeness, _)| *likeness >= least);
        let names: Vec<String> = near.into_iter().take(count).map(|(_, name)| name).collect();
        if names.is_empty() { String::new() } else { format!("; did you mean {}?", names.join(" or ")) }
    }

    /// Errors and warnings in the order of the text, each once.
    pub(super) fn into_parts(mut self) -> (Vec<Found>, Vec<Found>) {
        let errors = std::mem::take(&mut self.errors);
        let warnings = std::mem::take(&mut self.warnings);
        (self.in_order(errors), self.in_order(warnings))
    }

    fn in_order(&self, mut found: Vec<(usize, String)>) -> Vec<Found> {
        found.sort();
        found.dedup();
        let (mut line, mut column, mut seen) = (0, 0, 0);
        let mut placed = Vec::new();
        for (at, message) in found {
            let at = at.min(self.text.len());
            if self.line(at) != line {
                line = self.line(at);
                (column, seen) = (1, self.line_starts[line - 1]);
            }
            // The byte order mark that some editors put first is no column.
            let between = self.text.get(seen..at).unwrap_or("");
            column += between.chars().filter(|c| *c != BYTE_ORDER_MARK).count();
            seen = at;
            placed.push(((line, column), message));
        }
        placed
    }
}

/// Names less like than this are no help.
const LIKENESS_MIN: f64 = 0.7;

/// Beside a name that is this much more like, another is no help either.
const LIKENESS_SPREAD: f64 = 0.08;

/// How much one name is like another, 0 to 1; where one holds the other, much.
fn likeness(one: &str, other: &str) -> f64 {
    let holds = one.len().min(other.len()) >= 3 && (one.contains(other) || other.contains(one));
    strsim::jaro_winkler(one, other).max(if holds { 0.9 } else { 0.0 })
}

const BYTE_ORDER_MARK: char = '\u{feff}';

/// A table whose keys are being asked for one after the other.
#[derive(Debug)]
pub(super) struct Table<'a> {
    /// How error texts call it.
    pub(super) name: String,
    /// Where it begins.
    pub(super) at: usize,
    entries: &'a DeTable<'a>,
    known: Vec<&'static str>,
}

/// A key and its value, with their places.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry<'a> {
    pub(super) key: &'a str,
    pub(super) key_at: usize,
    pub(super) at: usize,
    pub(super) value: &'a DeValue<'a>,
}

impl<'a> Table<'a> {
    pub(super) fn new(name: impl Into<String>, at: usize, entries: &'a DeTable<'a>) -> Self {
        Self { name: name.into(), at, entries, known: Vec::new() }
    }

    /// The entry of a key, which is known from now on.
    pub(super) fn get(&mut self, key: &'static str) -> Option<Entry<'a>> {
        self.known.push(key);
        self.entries.get_key_value(key).map(|(key, value)| Entry::new(key, value))
    }

    /// The entry of a key that must be there.
    pub(super) fn need(&mut self, key: &'static str, example: &str, problems: &mut Problems) -> Option<Entry<'a>> {
        let entry = self.get(key);
        if entry.is_none() {
            problems.error(self.at, format!("{} needs {key}, for example {key} = {example}", self.name));
        }
        entry
    }

    /// The table under a key; absent, it is `None`.
    pub(super) fn table(&mut self, key: &'static str, problems: &mut Problems) -> Option<Table<'a>> {
        let entry = self.get(key)?;
        match entry.value {
            DeValue::Table(entries) => Some(Table::new(format!("[{key}]"), entry.key_at, entries)),
            _ => {
                problems.error(entry.at, entry.refusal(&format!("a table: [{key}]")));
                None
            }
        }
    }

    /// The tables of an array of tables; absent, there are none.
    pub(super) fn tables(&mut self, key: &'static str, name: &str, problems: &mut Problems) -> Vec<Table<'a>> {
        let Some(entry) = self.get(key) else { return Vec::new() };
        let DeValue::Array(items) = entry.value else {
            problems.error(entry.key_at, format!("{key} is a list of tables: write {name} with two brackets"));
            return Vec::new();
        };
        let mut tables = Vec::new();
        for item in items.iter() {
            match item.get_ref() {
                DeValue::Table(entries) => tables.push(Table::new(name, item.span().start, entries)),
                other => problems.error(item.span().start, format!("{key} takes tables, not {}", shown(other))),
            }
        }
        tables
    }

    /// All entries in the order of the text.
    pub(super) fn entries(&self) -> Vec<Entry<'a>> {
        let mut entries: Vec<Entry> = self.entries.iter().map(|(key, value)| Entry::new(key, value)).collect();
        entries.sort_by_key(|entry| entry.key_at);
        entries
    }

    /// Complains about the keys that nobody asked for.
    pub(super) fn finish(self, problems: &mut Problems) {
        for entry in self.entries() {
            if !self.known.contains(&entry.key) {
                let near = problems.nearest(entry.key, self.known.iter().copied(), 1);
                let known = self.known.join(", ");
                let message = format!("unknown key {:?}: {} takes {known}{near}", entry.key, self.name);
                problems.error(entry.key_at, message);
            }
        }
    }
}

impl<'a> Entry<'a> {
    fn new(key: &'a Spanned<std::borrow::Cow<'a, str>>, value: &'a Spanned<DeValue<'a>>) -> Self {
        Self { key: key.get_ref(), key_at: key.span().start, at: value.span().start, value: value.get_ref() }
    }

    /// What is wrong with its value: the key, the value given and what is allowed.
    pub(super) fn refusal(&self, allowed: &str) -> String {
        format!("{} takes {allowed}, not {}", self.key, shown(self.value))
    }

    pub(super) fn refuse<T>(&self, allowed: &str, problems: &mut Problems) -> Option<T> {
        problems.error(self.at, self.refusal(allowed));
        None
    }

    /// Its text.
    pub(super) fn text(&self, allowed: &str, problems: &mut Problems) -> Option<&'a str> {
        match self.value {
            DeValue::String(text) => Some(text),
            _ => self.refuse(allowed, problems),
        }
    }

    /// Its whole number, within limits.
    pub(super) fn integer(&self, min: i64, max: i64, problems: &mut Problems) -> Option<i64> {
        let number = integer(self.value).filter(|number| (min..=max).contains(number));
        number.or_else(|| self.refuse(&format!("a whole number, {min} to {max}"), problems))
    }

    /// The value that one of the words stands for.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&str, T)], problems: &mut Problems) -> Option<T> {
        if let DeValue::String(text) = self.value
            && let Some((_, value)) = choices.iter().find(|(word, _)| word == text)
        {
            return Some(*value);
        }
        let words: Vec<String> = choices.iter().map(|(word, _)| format!("{word:?}")).collect();
        self.refuse(&words.join(" or "), problems)
    }
}

/// The whole number of a value; `None` where it is none or does not fit.
pub(super) fn integer(value: &DeValue) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// The number of a value, whole or not.
pub(super) fn number(value: &DeValue) -> Option<f64> {
    match value {
        DeValue::Integer(_) => integer(value).map(|number| number as f64),
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

/// A value as error texts show it.
pub(super) fn shown(value: &DeValue) -> String {
    match value {
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Integer(integer) => integer.to_string(),
        DeValue::Float(float) => float.to_string(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(_) => "a list".into(),
        DeValue::Table(_) => "a table".into(),
    }
}
