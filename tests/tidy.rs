//! The architecture's invariants, read from the sources: what a file may use, name and contain.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

use standin::devices::KINDS;
use standin::image::Layout;

/// The modules from the bottom up. A module uses itself and modules of lines above its own; modules of one line may use
/// each other.
const LAYERS: &[&[&str]] = &[
    &["map"],
    &["wire"],
    &["time"],
    &["world"],
    &["image"],
    &["line"],
    &["device", "options"],
    &["faults", "station"],
    &["bus"],
    &["devices"],
    &["config", "journal"],
    &["export"],
    &["store"],
    &["http", "io"],
    &["ctl"],
    &["cli"],
    &["main"],
];

/// What a device is written in.
const WORDS_OF_DEVICES: &[&str] = &["map", "image", "line", "world", "device", "options", "time", "wire", "devices"];

/// The modules that reach the outside world; all below them can run anywhere, at any speed.
const SHELL: &[&str] = &["config", "store", "ctl", "http", "io", "cli", "main"];

/// Modules of the shell that wait for nothing and ask no clock: they read and write what they are given.
const QUIET_SHELL: &[&str] = &["config", "store"];

/// Longest file, in lines.
const LINES_MAX: usize = 600;

/// The clauses of the specifications: a word, and the numbers that exist.
const CLAUSES: &[(&str, &[std::ops::RangeInclusive<u32>])] = &[
    ("BUS", &[1..=23]),
    ("CTL", &[1..=3]),
    ("ASTRO", &[1..=3, 10..=14, 20..=23, 30..=34, 40..=42, 50..=53, 60..=70, 80..=82]),
    ("TRC", &[1..=7, 10..=15, 20..=20]),
    ("PFC", &[1..=8, 10..=20]),
    ("VOL", &[1..=5, 10..=15, 20..=22, 30..=30, 40..=50]),
];

struct Source {
    /// Path from the root of the repository, with slashes.
    path: String,
    text: String,
}

impl Source {
    /// The module of the library that it belongs to.
    fn module(&self) -> &str {
        let inner = self.path.strip_prefix("src/").unwrap();
        inner.split(['/', '.']).next().unwrap()
    }

    /// The lines that are code, with their numbers; comments are cut off.
    fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        self.text.lines().enumerate().map(|(index, line)| (index + 1, before_comment(line)))
    }

    /// Where the code holds one of the words.
    fn uses(&self, words: &[&str]) -> Vec<String> {
        let held = |line: &str| words.iter().find(|word| holds_word(line, word)).copied();
        let found = self.code().filter_map(|(number, line)| held(line).map(|word| (number, word)));
        found.map(|(number, word)| format!("{}:{number}: {word}", self.path)).collect()
    }

    /// The names behind `root::` in the code: the modules that it uses.
    fn modules_used(&self, root: &str) -> Vec<(usize, String)> {
        let start = format!("{root}::");
        let mut used = Vec::new();
        for (number, line) in self.code() {
            for (at, _) in line.match_indices(&start) {
                let is_whole = !line[..at].ends_with(is_name);
                let rest = &line[at + start.len()..];
                if is_whole && let Some(list) = rest.strip_prefix('{') {
                    used.extend(list.split(',').map(|item| (number, first_name(item.trim()))));
                } else if is_whole {
                    used.push((number, first_name(rest)));
                }
            }
        }
        used
    }
}

fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn first_name(text: &str) -> String {
    text.chars().take_while(|c| is_name(*c)).collect()
}

/// The line up to a `//` that is not within a string.
fn before_comment(line: &str) -> &str {
    let mut in_string = false;
    let mut last = ' ';
    for (at, c) in line.char_indices() {
        match c {
            '"' if last != '\\' && last != '\'' => in_string = !in_string,
            '/' if last == '/' && !in_string => return &line[..at - 1],
            _ => {}
        }
        last = if last == '\\' { ' ' } else { c };
    }
    line
}

/// Whether a line holds `word`, not as a part of a longer name.
fn holds_word(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let begins = !word.starts_with(is_name) || !line[..at].ends_with(is_name);
        let ends = !word.ends_with(is_name) || !line[at + word.len()..].starts_with(is_name);
        begins && ends
    })
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files below a folder of the repository whose names end so, in order.
fn files(folder: &str, endings: &[&str]) -> Vec<Source> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for entry in entries {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && !name.starts_with('.') {
                folders.push(path);
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                let from_root = path.strip_prefix(root()).unwrap().to_string_lossy().replace('\\', "/");
                found.push(Source { path: from_root, text: fs::read_to_string(&path).unwrap() });
            }
        }
    }
    found.sort_by(|one, other| one.path.cmp(&other.path));
    found
}

fn sources() -> Vec<Source> {
    let sources: Vec<Source> =
        files("src", &[".rs"]).into_iter().filter(|source| source.path != "src/lib.rs").collect();
    assert!(sources.len() > 20, "the sources were not found");
    sources
}

#[track_caller]
fn none(what: &str, found: Vec<String>) {
    assert!(found.is_empty(), "{what}:\n{}", found.join("\n"));
}

#[test]
fn no_file_is_longer_than_its_readers_patience() {
    let mut all = files("src", &[".rs"]);
    all.extend(files("tests", &[".rs", ".py", ".txt"]));
    all.extend(files("scripts", &[""]));
    // Nobody reads what cargo writes.
    all.retain(|source| !source.path.ends_with(".lock"));
    let long = all.iter().filter(|source| source.text.lines().count() > LINES_MAX);
    none(
        "files above 600 lines",
        long.map(|source| format!("{}: {}", source.path, source.text.lines().count())).collect(),
    );
}

#[test]
fn dependencies_point_down_only() {
    let layer = |module: &str| LAYERS.iter().position(|layer| layer.contains(&module));
    let mut wrong = Vec::new();
    for source in sources() {
        let own = layer(source.module()).unwrap_or_else(|| panic!("{} has no layer: give it one", source.path));
        let mut used = source.modules_used("crate");
        used.extend(source.modules_used("standin"));
        for (number, module) in used {
            // The macros that declare registers and inputs are exported at the root.
            let module = match module.as_str() {
                "registers" => "map",
                "inputs" => "world",
                module => module,
            };
            if layer(module).is_none_or(|used| used > own) {
                wrong.push(format!("{}:{number}: {} uses {module}", source.path, source.module()));
            }
        }
    }
    none("modules that use what lies above them", wrong);
}

#[test]
fn below_the_shell_there_is_no_clock_file_thread_lock_or_chance() {
    let world = [
        "tokio",
        "std::time",
        "SystemTime",
        "Utc",
        "Local",
        "Clock::now",
        "std::fs",
        "std::env",
        "std::io",
        "std::net",
        "std::process",
        "std::thread",
        "thread_local",
        "Mutex",
        "RwLock",
        "Condvar",
        "OnceLock",
        "LazyLock",
        "OnceCell",
        "LazyCell",
        "static mut",
        "std::sync::atomic",
        "std::sync::mpsc",
        "rand",
        "getrandom",
        "tracing",
        "println",
        "eprintln",
        "print",
        "eprint",
        "dbg",
    ];
    let core = sources().into_iter().filter(|source| !SHELL.contains(&source.module()));
    none("the core reaches outside", core.flat_map(|source| source.uses(&world)).collect());
    let quiet = sources().into_iter().filter(|source| QUIET_SHELL.contains(&source.module()));
    let waits = ["tokio", "std::time", "SystemTime", "Utc", "Local", "std::thread"];
    none("reading and keeping wait for nothing", quiet.flat_map(|source| source.uses(&waits)).collect());
}

/// The folders of the devices.
fn device_folders() -> Vec<String> {
    let mut folders: Vec<String> = sources()
        .iter()
        .filter_map(|source| {
            source.path.strip_prefix("src/devices/")?.split_once('/').map(|(folder, _)| folder.to_owned())
        })
        .collect();
    folders.dedup();
    assert!(folders.len() >= 4, "{folders:?}");
    folders
}

#[test]
fn a_device_uses_the_engines_words_and_no_other_device() {
    let folders = device_folders();
    let mut wrong = Vec::new();
    for source in sources() {
        let Some((own, _)) = source.path.strip_prefix("src/devices/").and_then(|path| path.split_once('/')) else {
            continue;
        };
        for (number, module) in source.modules_used("crate") {
            let is_macro = ["registers", "inputs"].contains(&module.as_str());
            if !is_macro && !WORDS_OF_DEVICES.contains(&module.as_str()) {
                wrong.push(format!("{}:{number}: {module}", source.path));
            }
        }
        for other in folders.iter().filter(|folder| *folder != own) {
            wrong.extend(source.uses(&[&format!("{other}::"), &format!("::{other}")]));
        }
    }
    none("a device uses what it must not", wrong);
}

#[test]
fn nothing_but_the_list_of_devices_names_one() {
    let mut names: Vec<String> = KINDS.iter().map(|kind| format!("\"{}\"", kind.name)).collect();
    names.extend(device_folders().iter().flat_map(|folder| [format!("devices::{folder}"), format!("{folder}::KIND")]));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let outside = sources().into_iter().filter(|source| !source.path.starts_with("src/devices/"));
    none("a device is named outside devices/", outside.flat_map(|source| source.uses(&names)).collect());
}

#[test]
fn unsafe_code_is_that_of_descriptors_alone() {
    let all = files("src", &[".rs"]).into_iter().chain(files("tests", &[".rs"]));
    let others = all.filter(|source| source.path != "src/io/fd.rs" && source.path != "tests/tidy.rs");
    none("unsafe code", others.flat_map(|source| source.uses(&["unsafe", "unsafe_code"])).collect());
}

#[test]
fn nothing_is_left_to_be_done() {
    // The words are put together here so that this file does not hold them.
    let words = [
        concat!("TO", "DO"),
        concat!("FIX", "ME"),
        concat!("XX", "X"),
        concat!("to", "do!"),
        concat!("unimpl", "emented!"),
        concat!("#[ig", "nore"),
        concat!("should", "_panic"),
    ];
    let mut wrong = Vec::new();
    for folder in ["src", "tests", "scripts", "docs", ".ci"] {
        for source in files(folder, &[".rs", ".py", ".txt", ".md", ".toml", ".sh"]) {
            for (index, line) in source.text.lines().enumerate() {
                if words.iter().any(|word| holds_word(line, word)) {
                    wrong.push(format!("{}:{}: {}", source.path, index + 1, line.trim()));
                }
            }
        }
    }
    none("something is left to be done", wrong);
}

/// The clauses that a text names, as `ASTRO-12` or `astro_12`.
fn clauses_in(text: &str) -> Vec<(&'static str, u32)> {
    let mut named = Vec::new();
    for (word, _) in CLAUSES {
        for spelling in [format!("{word}-"), format!("{}_", word.to_lowercase())] {
            for (at, _) in text.match_indices(&spelling) {
                let is_whole = !text[..at].ends_with(|c: char| c.is_alphanumeric());
                let digits: String = text[at + spelling.len()..].chars().take_while(char::is_ascii_digit).collect();
                if let (true, Ok(number)) = (is_whole, digits.parse()) {
                    named.push((*word, number));
                }
            }
        }
    }
    named
}

fn exists((word, number): (&str, u32)) -> bool {
    let numbers = CLAUSES.iter().find(|(known, _)| *known == word).map(|(_, numbers)| numbers);
    numbers.is_some_and(|numbers| numbers.iter().any(|range| range.contains(&number)))
}

/// What tests: tests, transcripts, interop tests, and the tests that stand in the sources; not the lists of this file, and
/// not the maps, which only repeat what the rows cite.
fn tests() -> Vec<Source> {
    let mut tests = files("tests", &[".rs", ".txt", ".py"]);
    tests.retain(|source| source.path != "tests/tidy.rs");
    tests.extend(sources().into_iter().filter_map(|mut source| {
        let at = source.text.find("#[cfg(test)]")?;
        source.text = source.text[at..].to_owned();
        Some(source)
    }));
    tests
}

#[test]
fn every_clause_is_named_by_a_test() {
    let named: Vec<(&str, u32)> = tests().iter().flat_map(|source| clauses_in(&source.text)).collect();
    // The control interface is a module of its own; where it is not there, its clauses beyond configuration are not either.
    let has_control = root().join("src/http").exists();
    let all = CLAUSES.iter().flat_map(|(word, numbers)| numbers.iter().cloned().flatten().map(move |n| (*word, n)));
    let wanted = all.filter(|clause| has_control || clause.0 != "CTL" || clause.1 == 1);
    let missing = wanted.filter(|clause| !named.contains(clause));
    none("clauses without a test", missing.map(|(word, number)| format!("{word}-{number}")).collect());
}

#[test]
fn every_clause_that_is_cited_exists() {
    let mut wrong = Vec::new();
    let mut cited = |place: String, cite: &str| {
        let clauses = clauses_in(cite);
        if clauses.is_empty() || !clauses.iter().copied().all(exists) {
            wrong.push(format!("{place} cites {cite:?}"));
        }
    };
    for kind in KINDS {
        for member in Layout::new(kind.map).members() {
            cited(format!("{} {}", kind.name, member.name()), member.row.cite);
        }
        kind.rules.iter().for_each(|rule| cited(format!("{} rule {:?}", kind.name, rule.says), rule.cite));
        kind.inputs.iter().for_each(|input| cited(format!("{} input {}", kind.name, input.name()), input.cite));
        kind.all_options().for_each(|option| cited(format!("{} option {}", kind.name, option.name), option.cite));
    }
    for source in tests().into_iter().chain(sources()) {
        let unknown = clauses_in(&source.text).into_iter().filter(|clause| !exists(*clause));
        wrong.extend(unknown.map(|(word, number)| format!("{} names {word}-{number}", source.path)));
    }
    none("clauses that do not exist", wrong);
}

#[test]
fn the_searches_find_what_they_look_for() {
    let source = Source {
        path: "src/bus/mod.rs".into(),
        text:
            "use crate::{io, map}; // crate::http\nlet at = std::time::Instant::now(); let s = \"http://x\"; unsafe {}"
                .into(),
    };
    assert_eq!(source.module(), "bus");
    assert_eq!(source.modules_used("crate"), [(1, "io".to_owned()), (1, "map".to_owned())]);
    assert_eq!(source.uses(&["std::time", "Insta"]), ["src/bus/mod.rs:2: std::time"]);
    assert_eq!(source.uses(&["unsafe"]), ["src/bus/mod.rs:2: unsafe"]);
    assert_eq!(clauses_in("ASTRO-12, astro_13_works, XASTRO-14, VOL-"), [("ASTRO", 12), ("ASTRO", 13)]);
    assert!(exists(("VOL", 50)) && !exists(("VOL", 51)) && !exists(("TRC", 8)));
}
