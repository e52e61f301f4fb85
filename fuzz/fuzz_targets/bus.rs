#![no_main]

#[path = "../../tests/bench/mod.rs"]
mod bench;
#[path = "../bodies.rs"]
#[allow(dead_code)]
mod bodies;

libfuzzer_sys::fuzz_target!(|data: &[u8]| bodies::bus(data));
