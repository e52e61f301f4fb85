//! The register maps, held twice against the manuals: the Markdown export equals the committed `maps/<model>.md`, so that
//! a changed map shows in review, and a second transcription, `maps/<model>.tsv`, typed from the manual, agrees with it.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use expect_test::expect_file;
use standin::device::Kind;
use standin::devices::KINDS;
use standin::export;
use standin::image::{Layout, Member};
use standin::map::{Access, Bank, Keep};

fn file(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "maps", name].iter().collect()
}

/// `UPDATE_EXPECT=1` writes the files anew.
#[test]
fn the_export_of_each_model_is_the_committed_one() {
    for kind in KINDS {
        expect_file![file(&format!("{}.md", kind.name))].assert_eq(&export::markdown(kind));
    }
}

#[test]
fn astro_1_the_map_of_the_astro_01_agrees_with_the_manual() {
    agrees("kael-astro-01");
}

#[test]
fn astro_1_the_map_of_the_astro_03_agrees_with_the_manual() {
    agrees("kael-astro-03");
}

#[test]
fn trc_1_the_map_of_the_trc_agrees_with_the_manual() {
    agrees("logiccon-trc");
}

#[test]
fn pfc_1_the_map_of_the_pfc_agrees_with_the_manual() {
    agrees("logiccon-pfc24s-tcr");
}

#[test]
fn vol_1_the_map_of_the_volcano_agrees_with_the_manual() {
    agrees("hmi-volcano-ec");
}

#[test]
fn every_model_has_a_second_transcription() {
    for kind in KINDS {
        assert!(file(&format!("{}.tsv", kind.name)).exists(), "tests/maps/{}.tsv is missing", kind.name);
    }
}

/// A line of a transcription: one address.
struct Line<'a> {
    name: &'a str,
    access: &'a str,
    range: &'a str,
    factory: &'a str,
    eeprom: &'a str,
}

/// The transcription of a model has the same addresses as its map, with the same names, access, range, factory value and
/// memory, wherever the manual or a clause tells them.
#[track_caller]
fn agrees(model: &str) {
    let kind = KINDS.iter().find(|kind| kind.name == model).unwrap();
    let text = fs::read_to_string(file(&format!("{model}.tsv"))).unwrap();
    let typed = typed(&text);
    let mut wrong = Vec::new();
    let map = map(kind);
    for (place, (member, word)) in &map {
        match typed.get(place) {
            Some(line) => wrong.extend(differences(line, *member, *word).into_iter().map(|text| (*place, text))),
            None => wrong.push((*place, format!("{} is not in the transcription", member.name()))),
        }
    }
    let missing = typed.iter().filter(|(place, _)| !map.contains_key(place));
    wrong.extend(missing.map(|(place, line)| (*place, format!("{} is not in the map", line.name))));
    let report: Vec<String> =
        wrong.iter().map(|((bank, addr), text)| format!("{} {addr} (0x{addr:04X}): {text}", bank.name())).collect();
    assert!(report.is_empty(), "{model} and its transcription disagree:\n{}", report.join("\n"));
}

/// Every address of a model: the register it belongs to, and which word of it.
fn map(kind: &'static Kind) -> BTreeMap<(Bank, u16), (Member, u16)> {
    let members: Vec<Member> = Layout::new(kind.map).members().collect();
    let words = |member: Member| {
        (0..member.row.words()).map(move |word| ((member.row.bank, member.addr() + word), (member, word)))
    };
    members.into_iter().flat_map(words).collect()
}

#[track_caller]
fn typed(text: &str) -> BTreeMap<(Bank, u16), Line<'_>> {
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    let mut typed = BTreeMap::new();
    for line in lines {
        let [bank, addr, name, access, range, factory, eeprom, _manual] =
            line.split('\t').collect::<Vec<_>>().try_into().unwrap_or_else(|_| panic!("not eight columns: {line}"));
        let bank = Bank::ALL.into_iter().find(|known| known.name() == bank).unwrap();
        let addr = match addr.strip_prefix("0x") {
            Some(hex) => u16::from_str_radix(hex, 16).unwrap(),
            None => addr.parse().unwrap(),
        };
        let twin = typed.insert((bank, addr), Line { name, access, range, factory, eeprom });
        assert!(twin.is_none(), "typed twice: {line}");
    }
    typed
}

fn differences(line: &Line, member: Member, word: u16) -> Vec<String> {
    let row = member.row;
    let mut found = Vec::new();
    let mut compare = |what: &str, manual: &str, program: String| {
        if manual != "?" && manual != program {
            found.push(format!("{} has {what} {program}, the manual {manual}", member.name()));
        }
    };
    compare("the name", line.name, if word == 0 { member.name() } else { format!("{}+{word}", member.name()) });
    compare("access", line.access, if row.access == Access::Read { "R".into() } else { "RW".into() });
    if word > 0 {
        return found;
    }
    if row.access != Access::Read {
        compare("the range", &hull(line.range), range_of(member));
    }
    compare("the factory value", line.factory, row.default_of(member.index).to_string());
    compare("EEPROM", line.eeprom, if row.keep != Keep::Ram { "yes".into() } else { "no".into() });
    found
}

/// What a write of a register may carry, in the notation of the transcriptions.
fn range_of(member: Member) -> String {
    let row = member.row;
    if !row.one_of.is_empty() {
        let mut numbers = row.one_of.to_vec();
        numbers.sort_unstable();
        return numbers.iter().map(i64::to_string).collect::<Vec<_>>().join(",");
    }
    let (min, max) = row.limits();
    let step = if row.step == 1 { String::new() } else { format!("/{}", row.step) };
    format!("{min}..{max}{step}")
}

/// A row holds the numbers of both temperature units; its device's rules narrow them.
fn hull(range: &str) -> String {
    if !range.contains('|') {
        return range.into();
    }
    let ends = |part: &str| -> (i64, i64) {
        let (min, max) = part.split_once("..").unwrap();
        (min.parse().unwrap(), max.parse().unwrap())
    };
    let (mins, maxs): (Vec<i64>, Vec<i64>) = range.split('|').map(ends).unzip();
    format!("{}..{}", mins.iter().min().unwrap(), maxs.iter().max().unwrap())
}
