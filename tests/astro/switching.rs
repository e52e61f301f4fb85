//! The relays against two models: one that looks at the clock every second, and the list of a whole year.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use chrono::{Datelike, NaiveDate, NaiveDateTime, TimeDelta, Timelike};
use proptest::prelude::*;

use crate::bench::{Bench, Plan, time};
use crate::calendar::{AUTOMATIC, Model};
use crate::{add_programs, clock, empty, set_clock};

/// Settings, hour, minute, second, offset, active days.
type Record = [i16; 6];

const RELAY_A: i16 = 4;
const ON: i16 = 8;

/// Sunrise and sunset of Istanbul in minutes, as the device shows them on that date at noon (ASTRO-60).
fn shown() -> &'static BTreeMap<NaiveDate, [i64; 2]> {
    static SHOWN: OnceLock<BTreeMap<NaiveDate, [i64; 2]>> = OnceLock::new();
    SHOWN.get_or_init(|| {
        let mut bench = empty("kael-astro-01", "2014-10-01T12:00:00");
        let dates = NaiveDate::from_ymd_opt(2014, 10, 1).unwrap().iter_days().take(420);
        let read = |date: NaiveDate| {
            set_clock(&mut bench, date.and_hms_opt(12, 0, 0).unwrap());
            let words = bench.read(1, 3, 0x70, 4).unwrap();
            (date, [0, 2].map(|at| i64::from(words[at]) * 60 + i64::from(words[at + 1])))
        };
        dates.map(read).collect()
    })
}

/// When a program of a date fires by the clock, if its day is active.
fn time_of(record: &Record, date: NaiveDate) -> Option<NaiveDateTime> {
    let [settings, hour, minute, second, offset, days] = *record;
    if days >> date.weekday().num_days_from_monday() & 1 == 0 {
        return None;
    }
    if settings & 1 == 0 {
        return date.and_hms_opt(hour as u32, minute as u32, second as u32);
    }
    let [rise, set] = shown()[&date];
    let minutes = if settings & 2 != 0 { rise } else { set } + i64::from(offset);
    Some(date.and_hms_opt(0, 0, 0).unwrap() + TimeDelta::minutes(minutes))
}

const HOUR: TimeDelta = TimeDelta::hours(1);
const WEEK: TimeDelta = TimeDelta::days(7);

/// The hour that automatic mode skips in a year starts here.
fn spring(year: i32) -> NaiveDateTime {
    let march = NaiveDate::from_ymd_opt(year, 3, 31).unwrap();
    (march - TimeDelta::days(i64::from(march.weekday().num_days_from_sunday()))).and_hms_opt(3, 0, 0).unwrap()
}

/// Relays that are looked at every second.
struct Relays<'a> {
    clock: Model,
    programs: &'a [Record],
    /// Time and position of the last event, by relay.
    last: [Option<(NaiveDateTime, bool)>; 2],
    select: [u16; 2],
    lock: [bool; 2],
    position: [bool; 2],
    /// First and last date, while it is on.
    holiday: [Option<(NaiveDate, NaiveDate)>; 2],
    /// The clock was set into the hour that spring skips.
    lives_skipped: bool,
    /// Today's events, in order.
    today: Vec<(NaiveDateTime, usize)>,
}

impl<'a> Relays<'a> {
    fn new(local: NaiveDateTime, programs: &'a [Record]) -> Self {
        let clock = Model::new(local, Some(AUTOMATIC));
        let mut relays = Self {
            clock,
            programs,
            last: [None; 2],
            select: [0; 2],
            lock: [false; 2],
            position: [false; 2],
            holiday: [None; 2],
            lives_skipped: (spring(local.year())..spring(local.year()) + HOUR).contains(&local),
            today: Vec::new(),
        };
        relays.look_back();
        relays.settle();
        relays
    }

    fn times_on(&self, date: NaiveDate) -> Vec<(NaiveDateTime, usize)> {
        let days = (-1..=1).map(|by| date + TimeDelta::days(by));
        let times = days.flat_map(|day| {
            let slots = self.programs.iter().enumerate();
            slots.filter_map(move |(slot, record)| Some((time_of(record, day)?, slot)))
        });
        let mut times: Vec<_> = times.filter(|(at, _)| at.date() == date).collect();
        times.sort();
        times
    }

    /// The last events before now, by the definition (ASTRO-52).
    fn look_back(&mut self) {
        let (now, start) = (self.clock.local, spring(self.clock.local.year()));
        let mut times: Vec<_> = (-9..=0).flat_map(|by| self.times_on(now.date() + TimeDelta::days(by))).collect();
        for (at, _) in &mut times {
            if !self.lives_skipped && (start..start + HOUR).contains(at) {
                *at = start + HOUR;
            }
        }
        times.sort();
        self.last = [None; 2];
        for (at, slot) in times.into_iter().filter(|(at, _)| *at <= now && *at >= now - WEEK) {
            self.remember(at, slot);
        }
        self.today = self.times_on(now.date());
    }

    fn remember(&mut self, at: NaiveDateTime, slot: usize) -> usize {
        let settings = self.programs[slot][0];
        let side = usize::from(settings & RELAY_A == 0);
        self.last[side] = Some((at, settings & ON != 0));
        side
    }

    fn is_on_holiday(&self, side: usize) -> bool {
        let date = self.clock.local.date();
        self.holiday[side].is_some_and(|(start, end)| (start..=end).contains(&date))
    }

    fn tick(&mut self) {
        let before = self.clock.local;
        self.clock.tick();
        let local = self.clock.local;
        if local.date() != before.date() {
            self.today = self.times_on(local.date());
            for holiday in &mut self.holiday {
                *holiday = holiday.filter(|(_, end)| local.date() <= *end);
            }
        }
        let jumped = local - before > HOUR;
        let due = |at: NaiveDateTime| if jumped { before < at && at <= local } else { at == local };
        let mut fires: Vec<usize> = Vec::new();
        if self.clock.repeat_left == 0 {
            fires.extend(self.today.iter().filter(|(at, _)| due(*at)).map(|(_, slot)| *slot));
        }
        fires.sort();
        for slot in fires {
            let side = usize::from(self.programs[slot][0] & RELAY_A == 0);
            if self.is_on_holiday(side) {
                continue;
            }
            self.remember(local, slot);
            if self.select[side] >= 4 && !self.lock[side] {
                self.select[side] = 0;
            }
        }
        self.settle();
    }

    fn settle(&mut self) {
        let reached = self.clock.local + TimeDelta::seconds((self.clock.repeat_left - 1).max(0));
        for side in 0..2 {
            self.last[side] = self.last[side].filter(|(at, _)| reached - *at <= WEEK);
            let due = self.last[side].is_some_and(|(_, on)| on) && !self.is_on_holiday(side);
            if !self.lock[side] {
                self.position[side] = if self.select[side] >= 2 { self.select[side] & 1 == 1 } else { due };
            }
        }
    }

    fn assert_is(&self, bench: &mut Bench) {
        assert_eq!(clock(bench).0, self.clock.local);
        let words = bench.read(1, 3, 0x53, 6).unwrap();
        let wanted = [
            self.select[0],
            self.select[1],
            self.select[0] / 2,
            self.select[1] / 2,
            self.position[0].into(),
            self.position[1].into(),
        ];
        assert_eq!(words, wanted, "at {} in the model", self.clock.local);
    }
}

#[derive(Clone, Debug)]
enum Step {
    Pass(i64),
    Select(usize, u16),
    Lock(usize, bool),
    /// First and last date, counted from today's.
    Holiday(usize, i64, i64),
    HolidayOff(usize),
    SetBy(i64),
}

fn record() -> impl Strategy<Value = Record> {
    // Hours around the changes of season are as likely as all others together.
    let hour = prop_oneof![2 => 2..5i16, 1 => 0..24i16];
    let second = prop_oneof![Just(0i16), 0..60i16];
    let offset = prop_oneof![2 => -260..-120i16, 1 => -720..=720i16];
    let days = prop_oneof![Just(127i16), 0..128i16];
    (0..16i16, hour, 0..60i16, second, offset, days).prop_map(|(a, b, c, d, e, f)| [a, b, c, d, e, f])
}

fn moves() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (1..20_000i64).prop_map(Step::Pass),
        2 => (0..2usize, 0..6u16).prop_map(|(side, select)| Step::Select(side, select)),
        2 => (0..2usize, any::<bool>()).prop_map(|(side, lock)| Step::Lock(side, lock)),
    ]
}

fn with_sets() -> impl Strategy<Value = Step> {
    prop_oneof![3 => moves(), 1 => (-9000..9000i64).prop_map(Step::SetBy)]
}

fn with_holidays() -> impl Strategy<Value = Step> {
    prop_oneof![
        5 => moves(),
        2 => (0..2usize, -1..2i64, 0..2i64).prop_map(|(side, from, days)| Step::Holiday(side, from, from + days)),
        1 => (0..2usize).prop_map(Step::HolidayOff),
    ]
}

fn play(start: NaiveDateTime, programs: &[Record], steps: &[Step]) {
    let mut bench = empty("kael-astro-01", "2014-10-01T12:00:00");
    add_programs(&mut bench, programs);
    set_clock(&mut bench, start);
    let mut relays = Relays::new(start, programs);
    relays.assert_is(&mut bench);
    for step in steps {
        match step {
            Step::Pass(seconds) => {
                bench.advance_s(*seconds as f64);
                (0..*seconds).for_each(|_| relays.tick());
            }
            Step::Select(side, select) => {
                let code = bench.write(1, 0x53 + *side as u16, *select);
                assert_eq!(code, if relays.lock[*side] { 4 } else { 0 });
                if code == 0 {
                    relays.select[*side] = *select;
                }
            }
            Step::Lock(side, lock) => {
                assert_eq!(bench.write(1, 0x51 + *side as u16, u16::from(*lock)), 0);
                relays.lock[*side] = *lock;
            }
            Step::Holiday(side, from, to) => {
                let [from, to] = [from, to].map(|by| relays.clock.local.date() + TimeDelta::days(*by));
                let words = |date: NaiveDate| [date.year() - 2000, date.month() as i32, date.day() as i32];
                let mut block = vec![1];
                block.extend([words(from), words(to)].concat().into_iter().map(|word| word as u16));
                assert_eq!(bench.write_many(1, 0x40 + 7 * *side as u16, &block), 0);
                relays.holiday[*side] = Some((from, to)).filter(|(_, to)| relays.clock.local.date() <= *to);
            }
            Step::HolidayOff(side) => {
                assert_eq!(bench.write(1, 0x40 + 7 * *side as u16, 0), 0);
                relays.holiday[*side] = None;
            }
            Step::SetBy(by) => {
                let to = relays.clock.local + TimeDelta::seconds(*by);
                set_clock(&mut bench, to);
                let skipped = spring(to.year());
                relays.lives_skipped = (skipped..skipped + HOUR).contains(&to);
                relays.clock.set(to);
                relays.look_back();
            }
        }
        relays.settle();
        relays.assert_is(&mut bench);
        if let Step::Holiday(side, ..) = step {
            let status = bench.get(["holiday_a_status", "holiday_b_status"][*side]);
            let wanted = match relays.holiday[*side] {
                None => 0,
                Some((start, _)) if relays.clock.local.date() < start => 1,
                Some(_) => 2,
            };
            assert_eq!(status, wanted);
        }
    }
}

/// Two hours or so before a change of season.
fn start() -> impl Strategy<Value = NaiveDateTime> {
    let changes = ["2014-10-26T01:00:00", "2015-03-29T00:30:00", "2015-10-25T01:00:00", "2014-12-30T20:00:00"];
    (0..changes.len(), -20_000..12_000i64).prop_map(move |(at, by)| time(changes[at]) + TimeDelta::seconds(by))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn astro_50_51_52_53_60_as_if_it_were_looked_at_every_second_while_the_clock_is_set(
        start in start(), programs in prop::collection::vec(record(), 1..8),
        steps in prop::collection::vec(with_sets(), 1..16)
    ) {
        play(start, &programs, &steps);
    }

    #[test]
    fn astro_40_42_51_53_60_as_if_it_were_looked_at_every_second_through_holidays(
        start in start(), programs in prop::collection::vec(record(), 1..8),
        steps in prop::collection::vec(with_holidays(), 1..24)
    ) {
        play(start, &programs, &steps);
    }
}

/// A switching of a relay: when, by the simulation's clock, and to what.
type Switching = (NaiveDateTime, bool);

/// The year's events of a relay by the simulation's clock, which starts with the device's in winter and never shifts.
fn listed(programs: &[Record], side: usize, from: NaiveDate, days: usize) -> Vec<Switching> {
    let (summer, winter) = (time("2015-03-29T03:00:00"), time("2015-10-25T04:00:00"));
    let civil = |local: NaiveDateTime| match local {
        local if local < summer => local,
        local if local < summer + HOUR => summer,
        local if local < winter => local - HOUR,
        local => local,
    };
    let mut events = Vec::new();
    for date in from.iter_days().take(days) {
        for (slot, record) in programs.iter().enumerate() {
            if usize::from(record[0] & RELAY_A == 0) == side {
                events.extend(time_of(record, date).map(|at| (at, slot, record[0] & ON != 0)));
            }
        }
    }
    events.sort_by_key(|(at, slot, _)| (civil(*at), *slot));
    let mut switchings = Vec::new();
    for (index, (at, _, on)) in events.iter().enumerate() {
        switchings.push((civil(*at), *on));
        // Seven days back an event still counts, a second later no more.
        let forgotten = *at + WEEK + TimeDelta::seconds(1);
        let next = events.get(index + 1).map_or(NaiveDateTime::MAX, |next| next.0);
        if *on && forgotten < next {
            switchings.push((civil(forgotten), false));
        }
    }
    switchings
}

#[test]
fn astro_52_60_a_year_at_rate_86400_gives_the_switchings_of_the_list() {
    const RATE: i64 = 86_400;
    let programs: Vec<Record> = vec![
        [13, 0, 0, 0, 0, 127],   // A on at sunset
        [7, 0, 0, 0, 15, 31],    // A off at sunrise + 15, Monday to Friday
        [7, 0, 0, 0, 90, 96],    // A off at sunrise + 90 on the weekend
        [4, 1, 30, 0, 0, 15],    // A off at 01:30:00, Monday to Thursday
        [12, 3, 30, 30, 0, 127], // A on at 03:30:30, skipped in spring and repeated in autumn
        [4, 3, 45, 0, 0, 127],   // A off at 03:45:00
        [12, 4, 0, 0, 0, 64],    // A on at 04:00:00 on Sundays
        [9, 0, 0, 0, -720, 1],   // B on 12 hours before Monday's sunset, and in spring off minutes before the next
        [8, 23, 59, 59, 0, 4],   // B on at 23:59:59 on Wednesdays
        [0, 0, 0, 0, 0, 8],      // B off at 00:00:00 on Thursdays
    ];
    // The start's week is there, too: the relays are right from the start.
    let start = time("2014-10-27T14:22:08");
    let plan = Plan::of("kael-astro-03", 1).clock("2014-10-27T14:22:08", 0.0);
    let mut bench = plan.register("delete_all_programs", 0x55AA).start();
    add_programs(&mut bench, &programs);
    bench.bus.set_rate(bench.now, RATE as f64);
    let began = bench.now;
    let end = start + TimeDelta::days(366);
    let mut checks = Vec::new();
    for side in 0..2 {
        let list = listed(&programs, side, start.date() - TimeDelta::days(8), 380);
        let mut position = false;
        let mut count = 0;
        for (index, (at, on)) in list.iter().enumerate() {
            let before = std::mem::replace(&mut position, *on);
            if *at <= start || *at >= end {
                continue;
            }
            count += u32::from(before != *on);
            let us = (*at - start).num_microseconds().unwrap();
            let same = list.get(index + 1).is_some_and(|next| next.0 == *at);
            if list[index - 1].0 != *at {
                checks.push(((us - 1) / RATE, side, before));
            }
            if !same {
                checks.push(((us + RATE - 1) / RATE, side, *on));
                let next = list.get(index + 1).map_or(end, |next| next.0);
                let middle = us + (next - *at).num_microseconds().unwrap() / 2;
                checks.push((middle / RATE, side, *on));
            }
        }
        assert!(count > [700, 100][side], "relay {side} switches {count} times");
    }
    checks.sort();
    for (elapsed_us, side, on) in checks {
        let now = (bench.now.0 - began.0) as i64;
        bench.wait_us((elapsed_us - now).max(0) as u64);
        let civil = bench.bus.moment(bench.now).civil;
        assert_eq!(bench.get(["relay_a", "relay_b"][side]) == 1, on, "relay {side} at {civil} of the simulation");
    }
    assert_eq!(clock(&mut bench).0.date().year(), 2015);
    assert!(clock(&mut bench).0.month() >= 10 && clock(&mut bench).0.hour() < 24);
}

/// CPU time of this thread: what others do on the machine does not count.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux' account of this thread");
    text.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

#[test]
fn astro_52_a_year_in_one_step_is_a_year_in_many_and_costs_less_than_two_seconds() {
    let programs: Vec<Record> = (0..96).map(|n| [n % 16, n % 24, n * 7 % 60, n % 60, n * 13 - 600, 1 + n]).collect();
    let bench = || {
        let mut bench = Plan::of("kael-astro-03", 1).clock("2014-10-27T14:22:08", 1.0).start();
        add_programs(&mut bench, &programs);
        assert_eq!(bench.write_many(1, 0x53, &[5, 4]), 0);
        bench
    };
    let (mut once, mut often) = (bench(), bench());
    let before = cpu_s();
    once.advance_s(365.0 * 86_400.0);
    let cost = cpu_s() - before;
    assert!(cost < 2.0, "a year with 100 programs costs {cost} s of CPU");
    for _ in 0..365 * 8 {
        often.advance_s(3.0 * 3600.0);
    }
    assert_eq!(once.get("program_count"), 100);
    assert_eq!(once.bus.stations()[0].regs(), often.bus.stations()[0].regs());
}
