//! Sweeps over every model: each address with each function against the table, noise, repetition, and time in one piece
//! or in many. A new model is swept without a change here.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;
#[path = "sweep/table.rs"]
mod table;

use std::collections::BTreeSet;

use bench::{Bench, Plan, framed};
use standin::bus::Snapshot;
use standin::device::Kind;
use standin::devices::KINDS;
use standin::image::Image;
use standin::map::{Bank, Row};
use standin::options::{OptionRange, OptionRow, OptionValue};
use standin::world::{InputRange, World};
use table::{Table, Wanted, Word, read_reply, request};

const UNIT: u8 = 17;

/// Function codes that the protocol gives a body of a known form.
const KNOWN: [u8; 8] = [1, 2, 3, 4, 5, 6, 15, 16];

/// Random numbers that are the same in every run.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        // splitmix64
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next() as u8).collect()
    }
}

/// A device on a bench, and its table; every request meets the device as it was at the start.
struct Sweep {
    table: Table,
    bench: Bench,
    start: Snapshot,
    /// Writes that the table allows, and how many of them the device took.
    allowed: (usize, usize),
}

impl Sweep {
    fn of(kind: &'static Kind) -> Self {
        // Simulated time stands still, so that registers change by writes alone.
        let mut bench = Plan::of(kind.name, UNIT).clock("2014-10-27T14:22:08", 0.0).start();
        let start = bench.bus.snapshot(bench.now);
        Self { table: Table::of(kind), bench, start, allowed: (0, 0) }
    }

    fn image(&self) -> &Image {
        self.bench.bus.stations()[0].regs()
    }

    /// Asks, and holds the answer and what it left against the table.
    #[track_caller]
    fn check(&mut self, pdu: &[u8]) {
        let name = self.table.kind.name;
        let before = self.image().clone();
        let reply = self.bench.ask(&[&[UNIT][..], pdu].concat());
        let Some(reply) = reply else { panic!("{name}: no answer to {pdu:02X?}") };
        let got = reply[1..].to_vec();
        let is_exception = got[0] & 0x80 != 0;
        let wanted = self.table.wanted(pdu, &before);
        let holds = match &wanted {
            Wanted::Exactly(bytes) => got == *bytes,
            Wanted::UnlessRefused(bytes) => got == *bytes || matches!(got[..], [code, 3 | 4] if code == pdu[0] | 0x80),
        };
        assert!(holds && reply[0] == UNIT, "{name}: {pdu:02X?} gave {got:02X?}, wanted {wanted:02X?} (BUS-8)");
        if is_exception || pdu[0] <= 4 {
            assert!(before == *self.image(), "{name}: {pdu:02X?} gave {got:02X?} and changed registers (BUS-10)");
        } else {
            self.bench.bus.restore(self.bench.now, &self.start);
        }
        if let Wanted::UnlessRefused(_) = wanted {
            self.allowed.0 += 1;
            self.allowed.1 += usize::from(!is_exception);
        }
    }

    /// Words that are worth writing to an address.
    fn values(&self, addr: u16) -> BTreeSet<u16> {
        let mut values = BTreeSet::from([0, 1, 0x7FFF, 0x8000, 0xFFFF]);
        if let Some(Word { row, .. }) = self.table.words.get(&(Bank::Holding, addr)) {
            let (least, most) = row.limits();
            values.extend([least - 1, least, most, most + 1].map(|number| number as u16));
            values.insert(self.image().word(Bank::Holding, addr));
        }
        values
    }
}

/// BUS-8, BUS-9, BUS-11: spans with a gap, quantities at and beyond the limit, far addresses.
#[test]
fn bus_8_every_address_reads_as_the_table_says() {
    for kind in KINDS {
        let mut sweep = Sweep::of(kind);
        let limits = [kind.profile.read_bits_max, kind.profile.read_registers_max];
        for (function, bank) in [(1, Bank::Coil), (2, Bank::Discrete), (3, Bank::Holding), (4, Bank::Input)] {
            let most = limits[usize::from(!bank.is_bits())];
            for addr in sweep.table.addresses(bank) {
                for quantity in [1, 2, 7, most] {
                    sweep.check(&request(function, addr, quantity, None));
                }
            }
            for addr in [0, 1, 0x10, 0x8000, 0xFFFF] {
                for quantity in [0, most + 1, 0x7FFF, 0x8000, 0xFFFF] {
                    sweep.check(&request(function, addr, quantity, None));
                }
            }
        }
    }
}

/// BUS-7, BUS-8, BUS-9, BUS-10: each echo and each exception, and nothing changed behind an exception.
#[test]
fn bus_8_every_address_is_written_as_the_table_says() {
    for kind in KINDS {
        let mut sweep = Sweep::of(kind);
        for addr in sweep.table.addresses(Bank::Holding) {
            for value in sweep.values(addr) {
                sweep.check(&request(6, addr, value, None));
            }
            let here: Vec<u8> =
                sweep.image().span(Bank::Holding, addr, 2).iter().flat_map(|w| w.to_be_bytes()).collect();
            let two = if here.len() == 4 { &here } else { &vec![0; 4] };
            sweep.check(&request(16, addr, 1, Some(&two[..2])));
            sweep.check(&request(16, addr, 2, Some(two)));
            sweep.check(&request(16, addr, 2, Some(&[0x7F; 4])));
            sweep.check(&request(16, addr, 1, Some(&[0xFF; 2])));
            sweep.check(&request(16, addr, 2, Some(&two[..2])));
            sweep.check(&request(16, addr, 0, Some(&[])));
        }
        for addr in sweep.table.addresses(Bank::Coil) {
            for value in [0, 0xFF00, 1, 0xFF, 0xFF01, 0xFFFF] {
                sweep.check(&request(5, addr, value, None));
            }
            for (quantity, data) in [(1, &[0_u8][..]), (1, &[1]), (2, &[3]), (9, &[0, 0]), (9, &[0]), (0, &[])] {
                sweep.check(&request(15, addr, quantity, Some(data)));
            }
        }
        for (function, most) in [(15, kind.profile.write_bits_max), (16, kind.profile.write_registers_max)] {
            for addr in [0, 1, 0x10, 0xFFFF] {
                let bytes = if function == 15 { usize::from(most).div_ceil(8) } else { usize::from(most) * 2 };
                sweep.check(&request(function, addr, most, Some(&vec![0; bytes])));
                sweep.check(&request(function, addr, most + 1, Some(&vec![0; bytes])));
                sweep.check(&request(function, addr, 0xFFFF, Some(&[0, 0])));
            }
        }
        // Were everything refused by rules, the table would judge nothing.
        let (allowed, taken) = sweep.allowed;
        assert!(taken * 2 > allowed, "{}: of {allowed} writes that the table allows {taken} were taken", kind.name);
    }
}

#[test]
fn bus_8_every_other_function_is_refused_before_all_else() {
    for kind in KINDS {
        let mut sweep = Sweep::of(kind);
        for function in (0..=255).filter(|code| !KNOWN.contains(code)) {
            for body in [&[][..], &[0], &[0xFF, 0xFF, 0xFF, 0xFF], &[0; 20]] {
                sweep.check(&[&[function], body].concat());
                // Only the CRC ends such a frame: a byte may be left that silence has to end.
                assert!(sweep.bench.is_silent(), "{}: {function:02} was answered twice", kind.name);
            }
        }
    }
}

#[test]
fn bus_8_random_requests_are_judged_in_order() {
    for (number, kind) in KINDS.iter().enumerate() {
        let mut sweep = Sweep::of(kind);
        let mut dice = Dice(number as u64);
        let addresses = Bank::ALL.map(|bank| Vec::from_iter(sweep.table.addresses(bank)));
        for _ in 0..4000 {
            let function = dice.of(&KNOWN);
            let bank = match function {
                1 | 5 | 15 => Bank::Coil,
                2 => Bank::Discrete,
                4 => Bank::Input,
                _ => Bank::Holding,
            };
            let start = dice.of(&addresses[bank as usize]);
            let quantity = dice.of(&[0, 1, 1, 2, 3, 4, 6, 8, 9, 16, 30, 31, 100, 123, 124, 125, 126]);
            let pdu = match function {
                1..=4 => request(function, start, quantity, None),
                5 => request(function, start, dice.of(&[0, 0xFF00, 0xFF00, 7]), None),
                6 => request(function, start, dice.of(&[0, 1, 2, 5, 20, 100, 250, 1000, 0x55AA, 0xFFFF]), None),
                _ => {
                    let bytes = if function == 15 { quantity.div_ceil(8) } else { quantity * 2 }.min(246);
                    let is_short = dice.below(8) == 0;
                    let count = usize::from(bytes).saturating_sub(usize::from(is_short));
                    let data: Vec<u8> = match dice.below(3) {
                        0 => dice.bytes(count),
                        1 => vec![0; count],
                        _ => {
                            let here = (0..quantity).map(|offset| sweep.image().word(bank, start.wrapping_add(offset)));
                            here.flat_map(u16::to_be_bytes).chain(std::iter::repeat(0)).take(count).collect()
                        }
                    };
                    request(function, start, quantity, Some(&data))
                }
            };
            sweep.check(&pdu);
        }
    }
}

#[test]
fn bus_12_bodies_of_the_wrong_length_never_reach_a_device() {
    for kind in KINDS {
        let mut sweep = Sweep::of(kind);
        for function in KNOWN {
            for length in 0..14 {
                let body = vec![0_u8; length];
                // Of functions 15 and 16 the byte count is the fifth byte: 0 here, so five bytes are a whole body.
                let right = if function >= 15 { 5 } else { 4 };
                if length == right {
                    continue;
                }
                let before = sweep.image().clone();
                sweep.bench.send(&framed(&[&[UNIT, function], &body[..]].concat()));
                assert!(sweep.bench.is_silent(), "{}: {function:02} with {length} bytes", kind.name);
                assert!(before == *sweep.image(), "{}: {function:02} with {length} bytes", kind.name);
                ask_something(&mut sweep.bench);
            }
        }
    }
}

/// Asks every device of the bench for the first of its holding registers, and wants the answer.
#[track_caller]
fn ask_something(bench: &mut Bench) {
    for index in 0..bench.bus.stations().len() {
        let station = &bench.bus.stations()[index];
        let rows = station.kind().map.iter().copied().flatten();
        let addr = rows.filter(|row| row.bank == Bank::Holding).map(|row| row.addr).min().unwrap();
        let (name, unit, [high, low]) = (station.kind().name, station.address().unit, addr.to_be_bytes());
        let reply = bench.ask(&[unit, 3, high, low, 0, 1]);
        let word = bench.bus.stations()[index].regs().word(Bank::Holding, addr);
        let wanted = [&[unit][..], &read_reply(3, &[word])].concat();
        assert_eq!(reply, Some(wanted), "{name} is asked for {addr}");
    }
}

/// All models on one bus, each option at one of its choices.
fn everybody(dice: &mut Dice) -> Plan {
    let mut plan = Plan::default();
    for (number, kind) in KINDS.iter().enumerate() {
        plan = plan.device(kind.name, UNIT + number as u8);
        for row in kind.all_options() {
            if let Some(value) = some_choice(row, dice) {
                plan = plan.option(row.name, value);
            }
        }
    }
    plan
}

/// One of the choices of an option; numbers stay as they are.
fn some_choice(row: &OptionRow, dice: &mut Dice) -> Option<OptionValue> {
    match row.range {
        OptionRange::Choice(choices) => Some(OptionValue::Choice(dice.of(choices).into())),
        OptionRange::Flag(_) => Some(OptionValue::Flag(dice.of(&[false, true]))),
        OptionRange::Integer(..) => None,
    }
}

/// Bytes that are no request, or one that nobody meant.
fn noise(dice: &mut Dice) -> Vec<u8> {
    let unit = UNIT + dice.below(KINDS.len()) as u8;
    let count = dice.below(300);
    match dice.below(4) {
        0 => dice.bytes(count),
        1 => [vec![unit], dice.bytes(count % 20)].concat(),
        2 => {
            let mut frame = framed(&request(unit, dice.next() as u16, dice.next() as u16, None));
            frame.truncate(dice.below(frame.len()));
            frame
        }
        _ => {
            let function = dice.of(&KNOWN);
            let mut frame = framed(&[vec![unit], request(function, dice.next() as u16 & 0xFF, 2, None)].concat());
            let bit = dice.below(frame.len() * 8);
            frame[bit / 8] ^= 1 << (bit % 8);
            frame
        }
    }
}

#[test]
fn bus_5_after_any_noise_a_good_request_is_answered() {
    for seed in 0..120 {
        let mut dice = Dice(seed);
        let mut bench = everybody(&mut dice).start();
        for _ in 0..10 {
            bench.send(&noise(&mut dice));
            // The silence that ends it.
            bench.wait_ms(30);
            ask_something(&mut bench);
        }
    }
}

/// What may happen on a bench: requests good and bad, inputs, plugs, time and its jumps.
fn happen(bench: &mut Bench, dice: &mut Dice) {
    let index = dice.below(KINDS.len());
    let (kind, unit) = (KINDS[index], bench.bus.stations()[index].address().unit);
    let name = format!("device{}", index + 1);
    match dice.below(12) {
        0 => bench.send(&noise(dice)),
        1 => bench.power(&name, dice.of(&[false, true, true])),
        2 => bench.restart(&name),
        3 => bench.jump(dice.of(&["2014-10-31T23:59:50", "2015-03-29T02:59:59", "2016-02-29T12:00:00"])),
        4 => bench.advance_s(dice.below(100_000) as f64 / 7.0),
        5 => bench.wait_ms(dice.below(3000) as u64),
        6 => {
            let input = &kind.inputs[dice.below(kind.inputs.len())];
            let value = match input.range {
                InputRange::Flag { .. } => dice.below(2) as f64,
                InputRange::Number { min, max, .. } => min + (max - min) * dice.below(1001) as f64 / 1000.0,
            };
            bench.input(&format!("{name}.{}", input.name()), value);
        }
        _ => {
            let rows: Vec<&Row> = kind.map.iter().copied().flatten().collect();
            let row = dice.of(&rows);
            let addr = row.addr_of(dice.below(usize::from(row.count)) as u16);
            let (least, most) = row.limits();
            let value = (least + dice.below((most - least + 1) as usize) as i64) as u16;
            let function = dice.of(match row.bank {
                Bank::Coil => &[1, 5, 15],
                Bank::Discrete => &[2],
                Bank::Input => &[4],
                Bank::Holding => &[3, 6, 6, 16],
            });
            let pdu = match function {
                5 => request(5, addr, if value == 0 { 0 } else { 0xFF00 }, None),
                6 => request(6, addr, value, None),
                15 => request(15, addr, 1, Some(&[value as u8 & 1])),
                16 => request(16, addr, 1, Some(&value.to_be_bytes())),
                _ => request(function, addr, row.words(), None),
            };
            bench.send(&framed(&[&[unit][..], &pdu].concat()));
        }
    }
}

/// Everything that a bench shows: registers and inputs of all its devices.
fn shown(bench: &mut Bench) -> Vec<(Image, World, u32)> {
    bench.bus.live_to(bench.now);
    let stations = bench.bus.stations().iter();
    stations.map(|station| (station.regs().clone(), station.world().clone(), station.boots())).collect()
}

#[test]
fn bus_18_the_same_script_gives_the_same_bytes() {
    let mut replies = 0;
    for seed in 0..24 {
        let play = || {
            let mut dice = Dice(1000 + seed);
            let mut bench = everybody(&mut dice).clock("2014-10-25T22:00:00", dice.of(&[1.0, 60.0, 3600.0])).start();
            let mut heard = Vec::new();
            for _ in 0..100 {
                happen(&mut bench, &mut dice);
                heard.push((bench.hear_within(200), bench.now));
            }
            (heard, shown(&mut bench))
        };
        let (first, second) = (play(), play());
        assert!(first == second, "script {seed} went another way the second time");
        replies += first.0.iter().filter(|heard| heard.0.is_some()).count();
    }
    assert!(replies > 480, "of 2400 happenings {replies} were answered");
}

#[test]
fn bus_18_one_long_advance_equals_a_thousand_short_ones() {
    for seed in 0..6 {
        let prepared = || {
            let mut dice = Dice(2000 + seed);
            let mut bench = everybody(&mut dice).clock("2014-10-24T21:13:47", 0.0).start();
            (0..40).for_each(|_| happen(&mut bench, &mut dice));
            (0..KINDS.len()).for_each(|index| bench.power(&format!("device{}", index + 1), true));
            bench.wait_ms(2000);
            bench
        };
        let (mut long, mut short) = (prepared(), prepared());
        assert!(shown(&mut long) == shown(&mut short));
        let end_us: i64 = 259_200_000_000 + 1_234_567;
        for step in 0..1000 {
            let step_us = end_us * (step + 1) / 1000 - end_us * step / 1000;
            short.bus.advance_clock(short.now, step_us);
        }
        long.bus.advance_clock(long.now, end_us);
        for (index, (long, short)) in shown(&mut long).into_iter().zip(shown(&mut short)).enumerate() {
            let kind = KINDS[index];
            for row in kind.map.iter().copied().flatten() {
                for addr in (0..row.count).map(|index| row.addr_of(index)) {
                    let words = |image: &Image| image.span(row.bank, addr, row.words()).to_vec();
                    let (long, short) = (words(&long.0), words(&short.0));
                    assert!(long == short, "{} {} {addr}: {long:?}, {short:?} (seed {seed})", kind.name, row.ident);
                }
            }
            assert!(long == short, "{}: the world or the boots differ (seed {seed})", kind.name);
        }
    }
}
