//! devices.toml: what is accepted, and every kind of error with its line and column, all of a file at once.

#![allow(clippy::unwrap_used)]

mod accepted;
mod devices;
mod refused;

use proptest::prelude::*;
use standin::config::{Config, EXAMPLE, Overrides};
use standin::time::civil;

fn parse(text: &str) -> Result<Config, String> {
    parse_with(text, &Overrides::default())
}

fn parse_with(text: &str, overrides: &Overrides) -> Result<Config, String> {
    let host = civil(2024, 2, 29, 12, 0, 0);
    Config::parse("t", text.as_bytes(), overrides, host).map_err(|error| error.to_string())
}

/// The text is refused with exactly these lines.
#[track_caller]
fn refused(text: &str, expected: &[&str]) {
    match parse(text) {
        Ok(_) => panic!("accepted, but should be refused:\n{text}"),
        Err(error) => assert_eq!(error.lines().collect::<Vec<_>>(), expected, "of:\n{text}"),
    }
}

#[track_caller]
fn accepted(text: &str) -> Config {
    parse(text).unwrap_or_else(|error| panic!("refused:\n{error}"))
}

/// A bus with one heater and these further lines in its device: the lines given begin at line 8.
fn heater(lines: &str) -> String {
    format!(
        "[[bus]]\nname = \"line1\"\nport = \"pty:/tmp/p\"\n[[bus.device]]\nname = \"heater\"\n\
         model = \"hmi-volcano-ec\"\nunit = 4\n{lines}"
    )
}

/// A bus with one charger and these further lines in its device: the lines given begin at line 8.
fn charger(lines: &str) -> String {
    heater(lines).replace("heater", "charger").replace("hmi-volcano-ec", "logiccon-trc")
}

/// A bus without devices and these further lines: the lines given begin at line 3.
fn bus(lines: &str) -> String {
    format!("[[bus]]\nname = \"line1\"\n{lines}")
}

proptest! {
    #[test]
    fn any_bytes_get_an_answer(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = Config::parse("t", &bytes, &Overrides::default(), civil(2024, 1, 1, 0, 0, 0));
    }

    /// Pieces of the language in any order get deeper than bytes do.
    #[test]
    fn any_mix_of_the_languages_words_gets_an_answer(words in prop::collection::vec(prop::sample::select(WORDS), 0..60)) {
        let _ = parse(&words.concat());
    }

    /// A good file with a piece torn out, or put in, has an answer that names a place of the file.
    #[test]
    fn a_damaged_file_is_answered_in_place(at in 0..EXAMPLE.len(), cut in 0..80_usize, put in prop::sample::select(WORDS)) {
        let mut bytes = EXAMPLE.as_bytes().to_vec();
        let end = (at + cut).min(bytes.len());
        bytes.splice(at..end, put.bytes());
        let lines = bytes.iter().filter(|byte| **byte == b'\n').count() + 1;
        if let Err(error) = Config::parse("t", &bytes, &Overrides::default(), civil(2024, 1, 1, 0, 0, 0)) {
            prop_assert!(!error.problems.is_empty());
            for problem in &error.problems {
                let (line, column) = problem.place.unwrap();
                prop_assert!((1..=lines).contains(&line) && column >= 1, "{problem:?}");
            }
        }
    }
}

const WORDS: &[&str] = &[
    "[[bus]]\n",
    "[[bus.device]]\n",
    "[bus.device.registers]\n",
    "[clock]\n",
    "[control]\n",
    "name = ",
    "\"line1\"\n",
    "port = ",
    "\"pty:/tmp/p\"\n",
    "model = ",
    "\"logiccon-trc\"\n",
    "\"hmi-volcano-ec\"\n",
    "unit = ",
    "1\n",
    "-9223372036854775808\n",
    "inputs = { ",
    "options = { ",
    "registers = { ",
    "room_temperature = ",
    "1e999",
    ", ",
    "}\n",
    "[",
    "]\n",
    "\"",
    "'''",
    "\n",
    "start = ",
    "2014-10-27T14:22:08\n",
    "rtc_day = ",
    "31\n",
    "0x",
    "true\n",
    "baud = ",
    "parity = ",
    "\"even\"\n",
    "# ",
    "=",
    ".",
    "\u{0}",
    "ntc_1_correct = ",
    "charge_voltage_limit = ",
    "zone_temperature_target = ",
    "\u{feff}",
    "ü",
];
