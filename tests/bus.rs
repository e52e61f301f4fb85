//! Clauses of the bus that a dialogue over one door cannot show: doors, line check, wire timing, memory that fails.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{Bench, Plan, exception, framed};
use standin::bus::{DoorKind, LineCheck, Output, Timing};
use standin::line::{Line, Parity};
use standin::options::OptionValue;
use standin::station::Outcome;
use standin::time::Instant;

const READ_TWO: [u8; 6] = [4, 3, 0, 5, 0, 2];
const TWO: [u8; 7] = [4, 3, 4, 0x00, 0xBE, 0x00, 0xFA];

fn trc() -> Plan {
    Plan::of("logiccon-trc", 4)
}

/// Everything that the bus hands out now.
fn outputs(bench: &mut Bench) -> Vec<Output> {
    std::iter::from_fn(|| bench.bus.poll(bench.now)).collect()
}

#[test]
fn bus_5_frame_timeout_is_three_and_a_half_characters_and_the_slack() {
    let mut plan = trc();
    // 3.5 characters of 11 bits at 9600 baud are 4.0104 ms; above 19200 baud 1.75 ms.
    assert_eq!(plan.settings.frame_timeout_us(), 4011 + 20_000);
    plan.settings.line = Line { baud: 4800, parity: Parity::None, stop_bits: 1 };
    assert_eq!(plan.settings.frame_timeout_us(), 7292 + 20_000);
    plan.settings.line.baud = 38_400;
    plan.settings.slack_ms = 0;
    assert_eq!(plan.settings.frame_timeout_us(), 1750);
    // Just above 19200 baud 3.5 characters of 11 bits are longer than that.
    plan.settings.line = Line { baud: 20_000, parity: Parity::None, stop_bits: 2 };
    assert_eq!(plan.settings.frame_timeout_us(), 1925);
}

#[test]
fn bus_1_damage_of_256_bytes_is_no_longer_than_a_frame() {
    let mut bench = Plan::of("kael-astro-01", 1).start();
    bench.bus.observe(true);
    for (length, wanted) in [(256, "the CRC is wrong (BUS-4)"), (257, "more than 256 bytes")] {
        let door = bench.door;
        bench.bus.receive(bench.now, door, &[&[1, 3], [0xA5; 255].as_slice()].concat()[..length]);
        bench.now = bench.now.plus_ms(1000);
        let told = outputs(&mut bench).into_iter().find_map(|output| match output {
            Output::Exchange(exchange) => Some(exchange.outcome.clone()),
            _ => None,
        });
        assert!(matches!(told, Some(Outcome::Silence(reason)) if reason.starts_with(wanted)), "{length}: {told:?}");
    }
}

#[test]
fn bus_5_requests_behind_a_slow_reply_survive_a_silence() {
    let mut bench = trc().option("response_delay_ms", OptionValue::Integer(300)).start();
    bench.send(&[framed(&READ_TWO), framed(&READ_TWO)].concat());
    bench.now = Instant(200_000);
    let door = bench.door;
    bench.bus.receive(bench.now, door, &[0xFF]);
    assert_eq!(bench.hear(), Some(framed(&TWO)));
    assert_eq!(bench.now, Instant(300_000));
    assert_eq!(bench.hear(), Some(framed(&TWO)));
}

#[test]
fn bus_5_bytes_that_nobody_reads_do_not_pile_up() {
    let mut bench = trc().option("response_delay_ms", OptionValue::Integer(60_000)).start();
    let request = framed(&READ_TWO);
    let flood: Vec<u8> = request.iter().copied().cycle().take(1 << 20).collect();
    bench.send(&flood);
    let mut replies = 0;
    while bench.hear_within(60_000).is_some() {
        replies += 1;
    }
    assert_eq!(replies, 16 * 1024 / request.len(), "what waits is bounded by 16 KiB");
}

#[test]
fn bus_6_doors_frame_for_themselves_and_get_their_own_replies() {
    let mut bench = trc().start();
    let other = bench.bus.open_door(bench.now, DoorKind::Virtual);
    let request = framed(&READ_TWO);
    let door = bench.door;
    bench.bus.receive(bench.now, door, &request[..4]);
    bench.bus.receive(bench.now, other, &request);
    assert!(matches!(&outputs(&mut bench)[..], [Output::Transmit { door, .. }] if *door == other));
    bench.bus.receive(bench.now, door, &request[4..]);
    assert!(matches!(&outputs(&mut bench)[..], [Output::Transmit { door: to, .. }] if *to == door));
}

#[test]
fn bus_8_modbus_tcp_asks_by_unit_and_keeps_its_transactions() {
    let mut bench = trc().start();
    let door = bench.bus.open_door(bench.now, DoorKind::Tcp);
    bench.bus.receive_pdu(bench.now, door, 7, 4, &READ_TWO[1..]);
    bench.bus.receive_pdu(bench.now, door, 8, 4, &[3, 0, 99, 0, 1]);
    bench.bus.receive_pdu(bench.now, door, 9, 5, &READ_TWO[1..]);
    let wanted = [(Some(7), TWO.to_vec()), (Some(8), vec![4, 0x83, 2])];
    let got: Vec<_> = outputs(&mut bench)
        .into_iter()
        .map(|output| match output {
            Output::Transmit { transaction, bytes, .. } => (transaction, bytes),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(got, wanted);
}

#[test]
fn bus_15_a_collision_is_told_once_and_heals() {
    let mut bench = trc().device("logiccon-trc", 5).start();
    assert_eq!(bench.write(5, 0, 4), 0);
    assert_eq!(bench.ask(&READ_TWO), None);
    assert_eq!(bench.ask(&READ_TWO), None);
    let told = bench.notes.iter().filter(|note| note.contains("BUS-15")).count();
    assert_eq!(told, 1, "{:?}", bench.notes);
    bench.force("device2.unit", 5);
    assert_eq!(bench.ask(&READ_TWO), Some(TWO.to_vec()));
}

#[test]
fn bus_16_warn_answers_and_warns_once_per_client_and_device() {
    let mut bench = trc().device("logiccon-trc", 5).start();
    let door = bench.door;
    bench.bus.line_seen(door, 19_200, 2);
    for _ in 0..3 {
        assert_eq!(bench.ask(&READ_TWO), Some(TWO.to_vec()));
    }
    assert_eq!(bench.notes.len(), 1, "{:?}", bench.notes);
    bench.ask(&[5, 3, 0, 5, 0, 2]);
    assert_eq!(bench.notes.len(), 2, "{:?}", bench.notes);
    bench.bus.client_closed(door);
    bench.ask(&READ_TWO);
    assert_eq!(bench.notes.len(), 3, "{:?}", bench.notes);
}

#[test]
fn bus_16_enforce_hears_nothing_at_another_speed() {
    let mut plan = trc().device("logiccon-trc", 5);
    plan.settings.line_check = LineCheck::Enforce;
    let mut bench = plan.start();
    let door = bench.door;
    bench.bus.line_seen(door, 19_200, 2);
    assert_eq!(bench.ask(&READ_TWO), None);
    bench.bus.line_seen(door, 9600, 2);
    assert_eq!(bench.ask(&READ_TWO), Some(TWO.to_vec()));
    // The device's own baud register moves it away: 4 is 19200.
    assert_eq!(bench.write(4, 1, 4), 0);
    assert_eq!(bench.ask(&READ_TWO), None);
    assert!(bench.ask(&[5, 3, 0, 5, 0, 2]).is_some());
    bench.bus.line_seen(door, 19_200, 2);
    assert_eq!(bench.ask(&READ_TWO), Some(TWO.to_vec()));
    assert_eq!(bench.ask(&[5, 3, 0, 5, 0, 2]), None);
}

#[test]
fn bus_16_off_checks_nothing() {
    let mut plan = trc();
    plan.settings.line_check = LineCheck::Off;
    let mut bench = plan.start();
    let door = bench.door;
    bench.bus.line_seen(door, 1200, 1);
    assert_eq!(bench.ask(&READ_TWO), Some(TWO.to_vec()));
    assert!(bench.notes.is_empty());
}

#[test]
fn bus_17_wire_timing_takes_the_line_s_time() {
    for baud in [4800, 9600, 19_200, 38_400] {
        let line = Line { baud, parity: Parity::None, stop_bits: 2 };
        let mut plan = trc().option("response_delay_ms", OptionValue::Integer(7)).line(line);
        plan.settings.timing = Timing::Wire;
        let mut bench = plan.start();
        bench.send(&framed(&READ_TWO));
        assert!(bench.hear().is_some());
        // 8 characters of the request, 3.5 of silence, 9 of the reply, 11 bits each, and the device's own 7 ms.
        let wanted_us = 20.5 * 11.0 * 1e6 / f64::from(baud) + 7000.0;
        assert!((bench.now.0 as f64 - wanted_us).abs() <= 1.0, "{baud}: {} us, wanted {wanted_us}", bench.now.0);
    }
}

#[test]
fn bus_15_devices_that_hear_different_speeds_do_not_collide() {
    let mut plan = trc().device("logiccon-trc", 5);
    plan.settings.line_check = LineCheck::Enforce;
    let mut bench = plan.start();
    let door = bench.door;
    bench.bus.line_seen(door, 9600, 2);
    // The second moves to 19200, then to the first one's unit.
    assert_eq!(bench.write(5, 1, 4), 0);
    bench.bus.line_seen(door, 19_200, 2);
    assert_eq!(bench.write(5, 0, 4), 0);
    assert_eq!(bench.read(4, 3, 1, 1), Ok(vec![4]));
    bench.bus.line_seen(door, 9600, 2);
    assert_eq!(bench.read(4, 3, 1, 1), Ok(vec![2]));
    // Broadcasts reach only who hears them.
    bench.send(&framed(&[0, 6, 0, 11, 0, 40]));
    assert_eq!(bench.read(4, 3, 11, 1), Ok(vec![40]));
    bench.bus.line_seen(door, 19_200, 2);
    assert_eq!(bench.read(4, 3, 11, 1), Ok(vec![30]));
}

#[test]
fn bus_16_a_device_that_hears_nothing_is_silent_about_damage_too() {
    let mut plan = trc();
    plan.settings.line_check = LineCheck::Enforce;
    let mut bench = plan.start();
    let door = bench.door;
    bench.bus.line_seen(door, 19_200, 2);
    bench.send(&[4, 3, 0, 5, 0, 2, 0, 0]);
    assert_eq!(bench.hear(), None);
    bench.bus.line_seen(door, 9600, 2);
    bench.send(&[4, 3, 0, 5, 0, 2, 0, 0]);
    assert_eq!(bench.hear(), Some(framed(&[4, 0x83, 3])));
}

#[test]
fn bus_17_a_write_of_the_baud_is_answered_at_the_old_speed() {
    let mut plan = trc();
    plan.settings.timing = Timing::Wire;
    let mut bench = plan.start();
    // 9600 baud 8N2: 8 characters, 3.5 of silence, 8 of the echo, 11 bits each: 22.344 ms.
    assert_eq!(bench.write(4, 1, 4), 0);
    assert!(bench.now.0.abs_diff(22_344) <= 1, "{} us", bench.now.0);
    // Then 19200: 8, 3.5 and 7 characters: 10.599 ms more.
    assert_eq!(bench.read(4, 3, 1, 1), Ok(vec![4]));
    assert!(bench.now.0.abs_diff(22_344 + 10_599) <= 1, "{} us", bench.now.0);
}

#[test]
fn bus_17_characters_have_ten_bits_without_parity_and_eleven_with_it() {
    for (parity, bits) in [(Parity::None, 10.0), (Parity::Even, 11.0), (Parity::Odd, 11.0)] {
        let mut plan = Plan::of("logiccon-pfc24s-tcr", 4).line(Line { baud: 57_600, parity, stop_bits: 1 });
        plan.settings.timing = Timing::Wire;
        let mut bench = plan.start();
        assert_eq!(bench.read(4, 3, 244, 1), Ok(vec![5]));
        let wanted_us = 18.5 * bits * 1e6 / 57_600.0;
        assert!((bench.now.0 as f64 - wanted_us).abs() <= 1.0, "{} us, wanted {wanted_us}", bench.now.0);
    }
}

#[test]
fn bus_19_a_write_that_cannot_be_kept_is_answered_04_and_not_done() {
    let mut bench = trc().start();
    bench.bus.keep_memory();
    assert!(matches!(&outputs(&mut bench)[..], [Output::Persist { station: 0, .. }]));
    let door = bench.door;
    bench.bus.receive(bench.now, door, &framed(&[4, 6, 0, 11, 0, 40]));
    let first = bench.bus.poll(bench.now).unwrap();
    let Output::Persist { station, saved } = first else { panic!("the image comes before the reply: {first:?}") };
    assert_eq!(saved.registers["fan_off_temperature"], 40);
    bench.bus.keep_failed(station, "the disk is full");
    let rest = outputs(&mut bench);
    let reply = rest.iter().find_map(|output| match output {
        Output::Transmit { bytes, .. } => Some(bytes.clone()),
        _ => None,
    });
    assert_eq!(reply, Some(framed(&[4, 0x86, 4])));
    assert_eq!(bench.get("fan_off_temperature"), 30);
    // The next write is kept.
    bench.bus.receive(bench.now, door, &framed(&[4, 6, 0, 11, 0, 41]));
    let rest = outputs(&mut bench);
    assert!(matches!(&rest[..], [Output::Persist { .. }, Output::Transmit { .. }]), "{rest:?}");
    assert_eq!(bench.get("fan_off_temperature"), 41);
}

#[test]
fn bus_19_a_read_or_a_refused_write_keeps_nothing() {
    let mut bench = trc().start();
    bench.bus.keep_memory();
    outputs(&mut bench);
    let door = bench.door;
    for request in [&READ_TWO[..], &[4, 6, 0, 11, 0, 99], &[4, 6, 0, 11, 0, 30]] {
        bench.bus.receive(bench.now, door, &framed(request));
        let outputs = outputs(&mut bench);
        assert!(matches!(&outputs[..], [Output::Transmit { .. }]), "{outputs:?}");
    }
}

#[test]
fn bus_19_an_image_brings_a_device_back() {
    let mut bench = trc().start();
    assert_eq!(bench.write(4, 11, 44), 0);
    let saved = bench.saved("");
    let mut again = trc().register("fan_off_temperature", 20).start_with(&[Some(saved)]);
    // BUS-22: start values are laid down when a device has no image yet; the image wins.
    assert_eq!(again.get("fan_off_temperature"), 44);
}

#[test]
fn bus_14_an_image_that_differs_wins_and_the_log_says_so() {
    let mut bench = trc().start();
    let untouched = bench.saved("");
    assert_eq!(bench.write(4, 0, 9), 0);
    let saved = bench.saved("");
    let mut again = trc().start_with(&[Some(saved)]);
    assert_eq!(again.ask(&READ_TWO), None);
    assert!(again.ask(&[9, 3, 0, 5, 0, 2]).is_some());
    assert!(
        matches!(&again.notes[..], [note] if note.contains("unit 9") && note.contains("BUS-14")),
        "{:?}",
        again.notes
    );
    let mut same = trc().start_with(&[Some(untouched)]);
    assert!(same.ask(&READ_TWO).is_some());
    assert!(same.notes.is_empty());
}

#[test]
fn bus_20_an_image_with_a_foreign_or_missing_register_is_no_image() {
    let saved = trc().start().saved("");
    let mut foreign = saved.clone();
    foreign.registers.insert("rtc_year".into(), 14);
    let mut missing = saved.clone();
    missing.registers.remove("fan_off_temperature");
    let mut wild = saved;
    wild.registers.insert("fan_off_temperature".into(), 70_000);
    for image in [foreign, missing, wild] {
        let started = std::panic::catch_unwind(|| trc().start_with(&[Some(image)]));
        assert!(started.is_err());
    }
}

#[test]
fn bus_20_a_forced_number_never_makes_an_image_that_no_start_takes() {
    // 0, 300 and 9 are nothing that these registers may hold (TRC-4, TRC-6); what was there before them is kept.
    let mut bench = trc().start();
    assert_eq!(bench.write(4, 1, 4), 0);
    for (name, raw) in [("unit", 0), ("unit", 300), ("baud", 9)] {
        bench.force(name, raw);
        assert_eq!(bench.get(name), raw);
    }
    // One that it may hold is kept, read-only or not.
    bench.force("charge_current_limit", 7);
    let mut next = trc().start_with(&[Some(bench.saved(""))]);
    assert_eq!(["unit", "baud", "charge_current_limit"].map(|name| next.get(name)), [4, 4, 7]);
    // What is written after it is kept again.
    bench.force("baud", 2);
    assert_eq!(bench.saved("").registers["baud"], 2);
    bench.force("baud", 10);
    assert_eq!(bench.saved("").registers["baud"], 2);
}

#[test]
fn bus_23_what_a_gone_client_left_is_forgotten() {
    let mut bench = trc().start();
    let (door, request) = (bench.door, framed(&READ_TWO));
    bench.bus.receive(bench.now, door, &request[..5]);
    bench.bus.client_closed(door);
    assert_eq!(exception(&bench.ask(&READ_TWO).unwrap()), 0);
}
