//! The faults of the control interface (`control.md`, "Faults"), on a bus without I/O. The device is a TRC: holding
//! register 10 is the fan's switch-on temperature (40), 3 the charge voltage limit (275), coil 0 a relay (TRC-1).
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{Bench, Plan, framed};
use standin::bus::{DoorKind, Output, outcome_name};
use standin::faults::{Fault, FaultKind, Place, Target};

/// Read holding 10 and its reply: 40.
const ASK: [u8; 6] = [5, 3, 0, 10, 0, 1];
const ANSWER: [u8; 5] = [5, 3, 2, 0, 40];

fn charger() -> Bench {
    let mut bench = Plan::of("logiccon-trc", 5).named("charger").start();
    bench.bus.keep_journal();
    bench
}

fn fault(kind: FaultKind) -> Fault {
    Fault { id: 1, kind, target: Target::default(), probability: 1.0, count: None, lasts_us: None, seed: 7 }
}

fn with(kinds: &[FaultKind]) -> Bench {
    let mut bench = charger();
    for (index, kind) in kinds.iter().enumerate() {
        bench.bus.add_fault(bench.now, Fault { id: index as u64 + 1, ..fault(*kind) });
    }
    bench
}

/// Everything that comes back on a request, with the milliseconds at which each piece came.
fn heard(bench: &mut Bench, request: &[u8]) -> Vec<(u64, Vec<u8>)> {
    bench.send(&framed(request));
    let from = bench.now;
    let mut pieces = Vec::new();
    while let Some(piece) = bench.hear_within(1500) {
        pieces.push((bench.now.since_us(from) / 1000, piece));
    }
    pieces
}

fn reply(bench: &mut Bench, request: &[u8]) -> Option<Vec<u8>> {
    let pieces = heard(bench, request);
    assert!(pieces.len() < 2, "one piece: {pieces:02X?}");
    pieces.into_iter().next().map(|(_, bytes)| bytes)
}

fn hits(bench: &Bench) -> Vec<u64> {
    bench.bus.faults().list().iter().map(|active| active.hits()).collect()
}

#[test]
fn ctl_fault_drop_keeps_the_request_from_the_device() {
    let mut bench = with(&[FaultKind::Drop]);
    assert_eq!(reply(&mut bench, &[5, 6, 0, 10, 0, 50]), None);
    assert_eq!(hits(&bench), [1]);
    assert!(bench.bus.remove_fault(1));
    assert_eq!(reply(&mut bench, &ASK), Some(framed(&ANSWER)), "the write never got there");
}

#[test]
fn ctl_fault_drop_loses_a_broadcast_for_all_or_for_one() {
    let write = [0, 6, 0, 10, 0, 50];
    let read = |bench: &mut Bench, unit: u8| bench.read(unit, 3, 10, 1).unwrap()[0];
    let mut bench = Plan::of("logiccon-trc", 5).device("logiccon-trc", 6).start();
    bench.bus.add_fault(bench.now, Fault { count: Some(1), ..fault(FaultKind::Drop) });
    assert_eq!(reply(&mut bench, &write), None);
    assert_eq!((read(&mut bench, 5), read(&mut bench, 6)), (40, 40));
    let target = Target { station: Some(1), ..Target::default() };
    bench.bus.add_fault(bench.now, Fault { id: 2, count: Some(1), target, ..fault(FaultKind::Drop) });
    assert_eq!(reply(&mut bench, &write), None);
    assert_eq!((read(&mut bench, 5), read(&mut bench, 6)), (50, 40));
    assert_eq!(hits(&bench), [1, 1]);
}

#[test]
fn ctl_fault_delay_waits_and_jitters_within_its_bounds() {
    let mut bench = with(&[FaultKind::Delay { ms: 300, jitter_ms: 0 }]);
    assert_eq!(heard(&mut bench, &ASK), [(300, framed(&ANSWER))]);
    let mut bench = with(&[FaultKind::Delay { ms: 100, jitter_ms: 200 }]);
    let times: Vec<u64> = (0..20).map(|_| heard(&mut bench, &ASK)[0].0).collect();
    assert!(times.iter().all(|ms| (100..=300).contains(ms)), "{times:?}");
    assert!(times.iter().any(|ms| *ms != times[0]), "{times:?}");
}

#[test]
fn ctl_fault_delay_of_one_device_keeps_no_other_waiting() {
    let mut bench = Plan::of("logiccon-trc", 5).device("logiccon-trc", 6).start();
    let target = Target { station: Some(0), ..Target::default() };
    let delay = FaultKind::Delay { ms: 300, jitter_ms: 0 };
    bench.bus.add_fault(bench.now, Fault { target, count: Some(1), ..fault(delay) });
    bench.send(&framed(&ASK));
    assert_eq!(bench.hear_within(100), None);
    let from = bench.now;
    bench.send(&framed(&[6, 3, 0, 10, 0, 1]));
    assert_eq!(bench.hear_within(1), Some(framed(&[6, 3, 2, 0, 40])));
    // The slow one answers in the order in which it was asked.
    bench.send(&framed(&[5, 3, 0, 3, 0, 1]));
    assert_eq!(bench.hear_within(250), Some(framed(&ANSWER)));
    assert!((199..=201).contains(&(bench.now.since_us(from) / 1000)), "{:?}", bench.now);
    assert_eq!(bench.hear_within(1), Some(framed(&[5, 3, 2, 1, 19])));
}

#[test]
fn ctl_journal_keeps_what_a_gone_client_has_asked() {
    let mut bench = with(&[FaultKind::Delay { ms: 300, jitter_ms: 0 }]);
    bench.send(&framed(&ASK));
    assert_eq!(bench.hear_within(100), None);
    let door = bench.door;
    bench.bus.client_closed(door);
    assert_eq!(bench.hear_within(1500), None);
    let journal = bench.bus.journal().unwrap();
    let told = &journal.records().next().unwrap().exchange;
    assert_eq!((outcome_name(&told.outcome), told.reply.len(), told.faults.len()), ("silence", 0, 1));
    assert_eq!(journal.tally().hits.get("delay"), Some(&1));
}

#[test]
fn ctl_fault_exception_answers_and_does_not_write() {
    let mut bench = with(&[FaultKind::Exception { code: 6 }]);
    assert_eq!(reply(&mut bench, &[5, 6, 0, 10, 0, 50]), Some(framed(&[5, 0x86, 6])));
    bench.bus.clear_faults();
    assert_eq!(reply(&mut bench, &ASK), Some(framed(&ANSWER)));
    let journal = bench.bus.journal().unwrap();
    let first = &journal.records().next().unwrap().exchange;
    assert_eq!((outcome_name(&first.outcome), first.exception_code()), ("exception", Some(6)));
    assert_eq!((first.faults[0].id, first.faults[0].kind), (1, "exception"));
}

#[test]
fn ctl_fault_bad_crc_damages_only_the_crc() {
    let got = reply(&mut with(&[FaultKind::BadCrc]), &ASK).unwrap();
    let good = framed(&ANSWER);
    assert_eq!(got[..5], good[..5]);
    assert_ne!(got[5..], good[5..]);
    assert_eq!(got.len(), good.len());
}

#[test]
fn ctl_fault_truncate_cuts_the_end_or_all() {
    let good = framed(&ANSWER);
    let mut bench = with(&[FaultKind::Truncate { bytes: 3 }]);
    assert_eq!(reply(&mut bench, &ASK).unwrap(), good[..4]);
    let mut bench = with(&[FaultKind::Truncate { bytes: 7 }]);
    assert_eq!(reply(&mut bench, &ASK), None);
    let last = bench.bus.journal().unwrap().records().next_back().unwrap();
    assert_eq!(outcome_name(&last.exchange.outcome), "silence");
    assert_eq!(bench.bus.counters().replies, 0);
}

#[test]
fn ctl_fault_garbage_comes_before_or_after() {
    let good = framed(&ANSWER);
    let before = reply(&mut with(&[FaultKind::Garbage { bytes: 4, place: Place::Before }]), &ASK).unwrap();
    assert_eq!((before.len(), &before[4..]), (11, &good[..]));
    let after = reply(&mut with(&[FaultKind::Garbage { bytes: 4, place: Place::After }]), &ASK).unwrap();
    assert_eq!((after.len(), &after[..7]), (11, &good[..]));
}

#[test]
fn ctl_fault_wrong_unit_and_function_have_a_good_crc() {
    assert_eq!(reply(&mut with(&[FaultKind::WrongUnit]), &ASK), Some(framed(&[6, 3, 2, 0, 40])));
    assert_eq!(reply(&mut with(&[FaultKind::WrongFunction]), &ASK), Some(framed(&[5, 4, 2, 0, 40])));
    let mut both = with(&[FaultKind::WrongFunction, FaultKind::WrongUnit]);
    assert_eq!(reply(&mut both, &ASK), Some(framed(&[6, 4, 2, 0, 40])));
    // An exception stays one: input register 10 does not exist.
    let mut bench = with(&[FaultKind::WrongFunction]);
    assert_eq!(reply(&mut bench, &[5, 4, 0, 10, 0, 1]), Some(framed(&[5, 0x85, 2])));
}

#[test]
fn ctl_fault_split_sends_two_pieces() {
    let good = framed(&ANSWER);
    let mut bench = with(&[FaultKind::Split { at: 3, gap_ms: 80 }]);
    assert_eq!(heard(&mut bench, &ASK), [(0, good[..3].to_vec()), (80, good[3..].to_vec())]);
    assert_eq!(bench.bus.counters().replies, 1);
    assert_eq!(bench.bus.journal().unwrap().records().next().unwrap().exchange.reply_us, 80_000);
}

#[test]
fn ctl_fault_stale_repeats_the_reply_before() {
    let mut bench = charger();
    assert_eq!(reply(&mut bench, &ASK), Some(framed(&ANSWER)));
    bench.bus.add_fault(bench.now, Fault { count: Some(1), ..fault(FaultKind::Stale) });
    // Holding 3 and 4 are 275 and 20.
    assert_eq!(reply(&mut bench, &[5, 3, 0, 3, 0, 2]), Some(framed(&ANSWER)));
    assert_eq!(reply(&mut bench, &[5, 3, 0, 3, 0, 2]), Some(framed(&[5, 3, 4, 1, 19, 0, 20])));
}

#[test]
fn ctl_fault_echo_brings_the_request_first() {
    let mut bench = with(&[FaultKind::Echo]);
    assert_eq!(reply(&mut bench, &ASK), Some([framed(&ASK), framed(&ANSWER)].concat()));
}

#[test]
fn ctl_fault_offline_hears_and_says_nothing() {
    let mut bench = with(&[FaultKind::Offline]);
    assert_eq!(reply(&mut bench, &[5, 6, 0, 10, 0, 50]), None);
    assert_eq!(reply(&mut bench, &[0, 6, 0, 10, 0, 50]), None);
    assert_eq!(hits(&bench), [2]);
    bench.bus.clear_faults();
    assert_eq!(reply(&mut bench, &ASK), Some(framed(&ANSWER)));
}

#[test]
fn ctl_fault_offline_counts_what_is_no_frame_too() {
    let mut bench = charger();
    bench.bus.add_fault(bench.now, Fault { probability: 0.0, ..fault(FaultKind::Offline) });
    bench.bus.add_fault(bench.now, Fault { id: 2, ..fault(FaultKind::Offline) });
    assert_eq!(reply(&mut bench, &ASK), None, "one of two cables is pulled");
    bench.send(&[5, 3, 0, 10, 0, 1, 0, 0]);
    assert_eq!(bench.hear_within(500), None);
    assert_eq!(hits(&bench), [0, 2]);
    assert_eq!(bench.bus.journal().unwrap().tally().hits.get("offline"), Some(&2));
}

#[test]
fn ctl_fault_noise_comes_with_its_probability() {
    let mut bench = charger();
    bench.bus.add_fault(bench.now, Fault { probability: 0.0, ..fault(FaultKind::Noise { per_minute: 6000 }) });
    assert_eq!(bench.hear_within(5000), None);
    assert_eq!(hits(&bench), [0]);
}

#[test]
fn ctl_fault_noise_comes_unasked_at_about_its_rate() {
    let mut bench = with(&[FaultKind::Noise { per_minute: 60 }]);
    let mut bursts = 0;
    for _ in 0..600 {
        bench.heard.clear();
        bench.wait_ms(1000);
        bursts += bench.heard.len();
    }
    // 600 are expected of a Poisson process; five standard deviations are 122.
    assert!((478..=722).contains(&bursts), "{bursts}");
    assert_eq!(hits(&bench), [bursts as u64]);
}

#[test]
fn ctl_fault_stuck_register_shows_a_number_that_is_not_there() {
    let mut bench = charger();
    let member = bench.bus.stations()[0].layout().named("output_voltage").unwrap();
    let stuck = FaultKind::StuckRegister { member, words: [0, 123], value: 123 };
    let mut fault = fault(stuck);
    fault.target.station = Some(0);
    let before = bench.read(5, 4, 0, 4).unwrap();
    bench.bus.add_fault(bench.now, fault);
    // Input registers 2 and 3 are the output voltage, high word first.
    assert_eq!(bench.read(5, 4, 0, 4).unwrap(), [before[0], before[1], 0, 123]);
    assert_eq!(bench.read(5, 4, 3, 1).unwrap(), [123], "its second word alone");
    assert_eq!(bench.read(5, 4, 0, 2).unwrap(), before[..2], "a read beside it");
    assert_eq!(hits(&bench), [2]);
    bench.bus.clear_faults();
    assert_eq!(bench.read(5, 4, 2, 2).unwrap(), before[2..]);

    let member = bench.bus.stations()[0].layout().named("relay2_fan").unwrap();
    let mut fault = self::fault(FaultKind::StuckRegister { member, words: [1, 0], value: 1 });
    fault.target.station = Some(0);
    bench.bus.add_fault(bench.now, fault);
    let coils = reply(&mut bench, &[5, 1, 0, 0, 0, 3]).unwrap();
    assert_eq!(coils[3] & 0b010, 0b010, "coil 1 is stuck at 1");
}

#[test]
fn ctl_fault_targets_narrow_what_is_hit() {
    let target = Target { station: Some(1), functions: vec![3], addresses: vec![(0, 4), (10, 10)] };
    let mut bench = Plan::of("logiccon-trc", 5).device("logiccon-trc", 6).start();
    bench.bus.add_fault(bench.now, Fault { target, ..fault(FaultKind::Drop) });
    let mut is_hit = |request: &[u8]| reply(&mut bench, request).is_none();
    assert!(is_hit(&[6, 3, 0, 10, 0, 1]));
    assert!(is_hit(&[6, 3, 0, 4, 0, 2]), "it touches address 4");
    assert!(!is_hit(&[6, 3, 0, 5, 0, 5]), "5 to 9 lie between");
    assert!(!is_hit(&[6, 6, 0, 10, 0, 50]), "another function");
    assert!(!is_hit(&[5, 3, 0, 10, 0, 1]), "another device");
}

#[test]
fn ctl_fault_count_and_time_use_it_up() {
    let mut bench = charger();
    bench.bus.add_fault(bench.now, Fault { count: Some(2), ..fault(FaultKind::Drop) });
    let answers: Vec<bool> = (0..4).map(|_| reply(&mut bench, &ASK).is_some()).collect();
    assert_eq!(answers, [false, false, true, true]);
    assert!(!bench.bus.is_fault_active(bench.now, 1));
    bench.bus.add_fault(bench.now, Fault { id: 2, lasts_us: Some(5_000_000), ..fault(FaultKind::Drop) });
    assert_eq!(reply(&mut bench, &ASK), None);
    bench.wait_ms(5000);
    assert!(!bench.bus.is_fault_active(bench.now, 2));
    assert!(reply(&mut bench, &ASK).is_some());
}

#[test]
fn ctl_fault_probability_is_about_kept_and_a_seed_repeats_it() {
    let run = |seed: u64| -> Vec<bool> {
        let mut bench = charger();
        bench.bus.add_fault(bench.now, Fault { probability: 0.3, seed, ..fault(FaultKind::Drop) });
        (0..1000)
            .map(|_| {
                bench.send(&framed(&ASK));
                bench.hear_within(1).is_none()
            })
            .collect()
    };
    let first = run(7);
    let lost = first.iter().filter(|lost| **lost).count();
    // 300 are expected; five standard deviations are 72.
    assert!((228..=372).contains(&lost), "{lost}");
    assert_eq!(run(7), first);
    assert_ne!(run(8), first);
}

#[test]
fn ctl_fault_order_decides_how_they_compose() {
    let good = framed(&ANSWER);
    let echo = framed(&ASK);
    let garbage = FaultKind::Garbage { bytes: 2, place: Place::Before };
    let echo_first = reply(&mut with(&[FaultKind::Echo, garbage]), &ASK).unwrap();
    assert_eq!(echo_first[2..], [echo.clone(), good.clone()].concat());
    let garbage_first = reply(&mut with(&[garbage, FaultKind::Echo]), &ASK).unwrap();
    assert_eq!((&garbage_first[..8], &garbage_first[10..]), (&echo[..], &good[..]));
    // A reply that was cut has no CRC left to be damaged; one that was damaged can be cut.
    let mut bench = with(&[FaultKind::Truncate { bytes: 1 }, FaultKind::BadCrc]);
    assert_eq!(reply(&mut bench, &ASK).unwrap(), good[..6]);
    assert_eq!(hits(&bench), [1, 0]);
    // A request that is lost does not get its exception.
    let mut bench = with(&[FaultKind::Drop, FaultKind::Exception { code: 4 }]);
    assert_eq!(reply(&mut bench, &ASK), None);
    assert_eq!(hits(&bench), [1, 0]);
}

#[test]
fn ctl_fault_of_the_line_does_not_touch_modbus_tcp() {
    let mut bench =
        with(&[FaultKind::BadCrc, FaultKind::Echo, FaultKind::Split { at: 1, gap_ms: 1 }, FaultKind::WrongUnit]);
    let door = bench.bus.open_door(bench.now, DoorKind::Tcp);
    bench.bus.receive_pdu(bench.now, door, 77, 5, &ASK[1..]);
    let mut sent = Vec::new();
    while let Some(output) = bench.bus.poll(bench.now) {
        if let Output::Transmit { transaction, bytes, .. } = output {
            sent.push((transaction, bytes));
        }
    }
    assert_eq!(sent, [(Some(77), vec![6, 3, 2, 0, 40])]);
    assert_eq!(hits(&bench), [0, 0, 0, 1]);
}

#[test]
fn ctl_snapshot_brings_faults_and_their_chance_back() {
    let mut bench = charger();
    bench.bus.add_fault(bench.now, Fault { probability: 0.5, ..fault(FaultKind::Drop) });
    let run = |bench: &mut Bench| -> Vec<bool> {
        (0..50)
            .map(|_| {
                bench.send(&framed(&ASK));
                bench.hear_within(1).is_none()
            })
            .collect()
    };
    run(&mut bench);
    let snapshot = bench.bus.snapshot(bench.now);
    let before = hits(&bench);
    let first = run(&mut bench);
    bench.bus.clear_faults();
    bench.bus.restore(bench.now, &snapshot);
    assert_eq!(hits(&bench), before);
    assert_eq!(run(&mut bench), first);
}

#[test]
fn ctl_snapshot_takes_delays_back_to_where_they_were() {
    // The Astro is silent for boot_ms after a restart: 500 ms of its own elapsed time.
    let mut bench = Plan::of("kael-astro-01", 1).start();
    bench.wait_ms(1000);
    bench.restart("");
    bench.wait_ms(200);
    let ask = [1, 3, 0, 16, 0, 7];
    let snapshot = bench.bus.snapshot(bench.now);
    let moment = bench.bus.moment(bench.now);
    bench.wait_ms(10_000);
    let later = bench.ask(&ask);
    assert!(later.is_some());
    bench.bus.restore(bench.now, &snapshot);
    let back = bench.bus.moment(bench.now);
    assert_eq!((back.civil, back.running_us), (moment.civil, moment.running_us));
    assert_eq!(back.elapsed, bench.now, "the program's own time goes on");
    bench.wait_ms(250);
    assert_eq!(bench.ask(&ask), None, "300 ms of the restart are left");
    bench.wait_ms(60);
    assert!(bench.ask(&ask).is_some());
}
