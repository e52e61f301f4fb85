//! A bounded run of the bodies that `fuzz/` hands to cargo-fuzz: the seeds, what fuzzing has found, mutated seeds, and
//! random bytes.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;
#[path = "../fuzz/bodies.rs"]
mod bodies;

use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

fn body(target: &str) -> fn(&[u8]) {
    match target {
        "framer" => bodies::framer,
        "bus" => bodies::bus,
        "config" => bodies::config,
        "image" => bodies::image,
        other => panic!("no target {other}"),
    }
}

/// Runs a target on its seeds, on all that is kept under `fuzz/found`, and on so many mutated seeds and random bytes.
fn check(target: &str, cases: u32) {
    let body = body(target);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let seeds: Vec<Vec<u8>> =
        bodies::seeds(root).into_iter().filter(|seed| seed.0 == target).map(|(_, _, bytes)| bytes).collect();
    assert!(!seeds.is_empty(), "{target} has no seeds");
    for seed in &seeds {
        body(seed);
    }
    let found = root.join("fuzz/found").join(target);
    for entry in std::fs::read_dir(found).into_iter().flatten().flatten() {
        body(&std::fs::read(entry.path()).unwrap());
    }
    let strategy = prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..400),
        (any::<prop::sample::Index>(), mutations()).prop_map(move |(index, mutations)| {
            let mut bytes = index.get(&seeds).clone();
            for mutation in mutations {
                mutation.apply(&mut bytes);
            }
            bytes
        }),
    ];
    // The same cases every time: it is cargo-fuzz that looks for new ones.
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let run = runner.run(&strategy, |bytes| {
        body(&bytes);
        Ok(())
    });
    run.unwrap_or_else(|error| panic!("{target}: {error}"));
}

/// A small damage to a seed.
#[derive(Clone, Debug)]
enum Mutation {
    Change(prop::sample::Index, u8),
    Insert(prop::sample::Index, u8),
    Remove(prop::sample::Index),
    Cut(prop::sample::Index),
}

impl Mutation {
    fn apply(self, bytes: &mut Vec<u8>) {
        let place = |index: prop::sample::Index, bytes: &[u8]| index.index(bytes.len().max(1));
        match self {
            Mutation::Insert(index, byte) => bytes.insert(place(index, bytes), byte),
            _ if bytes.is_empty() => {}
            Mutation::Change(index, byte) => {
                let at = place(index, bytes);
                bytes[at] = byte;
            }
            Mutation::Remove(index) => {
                bytes.remove(place(index, bytes));
            }
            Mutation::Cut(index) => bytes.truncate(place(index, bytes)),
        }
    }
}

fn mutations() -> impl Strategy<Value = Vec<Mutation>> {
    let mutation = prop_oneof![
        4 => (any::<prop::sample::Index>(), any::<u8>()).prop_map(|(index, byte)| Mutation::Change(index, byte)),
        1 => (any::<prop::sample::Index>(), any::<u8>()).prop_map(|(index, byte)| Mutation::Insert(index, byte)),
        1 => any::<prop::sample::Index>().prop_map(Mutation::Remove),
        1 => any::<prop::sample::Index>().prop_map(Mutation::Cut),
    ];
    proptest::collection::vec(mutation, 1..8)
}

#[test]
fn bus_1_and_5_any_bytes_are_cut_into_frames_alike() {
    check("framer", 2000);
}

#[test]
fn bus_5_any_requests_leave_every_device_answering() {
    check("bus", 80);
}

#[test]
fn any_file_is_a_configuration_or_told_what_is_wrong() {
    check("config", 1000);
}

#[test]
fn bus_20_any_image_is_refused_or_lived_with() {
    check("image", 500);
}
