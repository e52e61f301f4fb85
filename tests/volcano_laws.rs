//! Laws that hold for the Volcano whatever is written to it and whatever the weather: registers that bind each other,
//! the control against a second one made from the clauses, the room's energy, and time in one piece or in many.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{Bench, Plan, exception};
use proptest::prelude::*;

const MODEL: &str = "hmi-volcano-ec";

/// What may happen to a controller.
#[derive(Clone, Debug)]
enum Event {
    Write(u16, u16),
    WriteMany(u16, Vec<u16>),
    Coil(u16, bool),
    Coils(u16, Vec<bool>),
    Input(&'static str, f64),
    Pass(f64),
    Restart,
}

fn any_value() -> impl Strategy<Value = u16> {
    prop_oneof![0..4_u16, 0..120_u16, 0..1500_u16, 400..4100_u16, 3500..10_500_u16, any::<u16>()]
}

/// Values that the zone's temperatures take in one unit or the other.
fn temperatures() -> impl Strategy<Value = Event> {
    let celsius = (23..28_u16, 150..4100_u16).prop_map(|(addr, value)| Event::Write(addr, value));
    let fahrenheit = (23..28_u16, 3550..10_450_u16).prop_map(|(addr, value)| Event::Write(addr, value));
    let limits = (500..3600_u16, 400..1600_u16).prop_map(|(min, gap)| Event::WriteMany(26, vec![min, min + gap]));
    let hot_limits = (4100..9600_u16, 800..2000_u16).prop_map(|(min, gap)| Event::WriteMany(26, vec![min, min + gap]));
    prop_oneof![celsius, fahrenheit, limits, hot_limits]
}

fn units() -> impl Strategy<Value = Event> {
    any::<bool>().prop_map(|is_fahrenheit| Event::Coil(5, is_fahrenheit))
}

fn schedules() -> impl Strategy<Value = Event> {
    (28..40_u16, prop::collection::vec(0..1440_u16, 1..5)).prop_map(|(addr, mut minutes)| {
        minutes.truncate(usize::from(40 - addr));
        Event::WriteMany(addr, minutes)
    })
}

fn event() -> impl Strategy<Value = Event> {
    let many = (3..41_u16, prop::collection::vec(any_value(), 1..6)).prop_map(|(addr, mut values)| {
        values.truncate(usize::from(41 - addr));
        Event::WriteMany(addr, values)
    });
    let coils = (2..7_u16, prop::collection::vec(any::<bool>(), 1..5)).prop_map(|(addr, mut bits)| {
        bits.truncate(usize::from(7 - addr));
        Event::Coils(addr, bits)
    });
    prop_oneof![
        4 => (3..41_u16, any_value()).prop_map(|(addr, value)| Event::Write(addr, value)),
        4 => temperatures(),
        2 => schedules(),
        3 => many,
        2 => units(),
        1 => (2..7_u16, any::<bool>()).prop_map(|(addr, on)| Event::Coil(addr, on)),
        1 => coils,
        2 => (-10.0..40.0_f64).prop_map(|celsius| Event::Input("room_temperature", celsius)),
        1 => prop::sample::select(vec!["ntc_1_fault", "ntc_2_connected", "ntc_2_fault"])
            .prop_flat_map(|name| (Just(name), prop::bool::ANY))
            .prop_map(|(name, on)| Event::Input(name, f64::from(u8::from(on)))),
        2 => prop_oneof![0.1..3.0_f64, 100.0..90_000.0_f64].prop_map(Event::Pass),
        1 => Just(Event::Restart),
    ]
}

/// Lets an event happen; gives the exception code of a write, 0 for what is no write.
fn play(bench: &mut Bench, event: &Event) -> u8 {
    match event {
        Event::Write(addr, value) => bench.write(1, *addr, *value),
        Event::WriteMany(addr, values) => bench.write_many(1, *addr, values),
        Event::Coil(addr, on) => {
            let reply = bench.ask(&[1, 5, 0, *addr as u8, if *on { 0xFF } else { 0 }, 0]);
            let is_reset = *addr == 3 && *on;
            bench.wait_ms(if is_reset { 500 } else { 0 });
            exception(&reply.expect("a reply"))
        }
        Event::Coils(addr, bits) => {
            let byte = bits.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
            let reply = bench.ask(&[1, 15, 0, *addr as u8, 0, bits.len() as u8, 1, byte]);
            bench.wait_ms(500);
            exception(&reply.expect("a reply"))
        }
        Event::Input(name, value) => {
            bench.input(name, *value);
            0
        }
        Event::Pass(seconds) => {
            bench.advance_s(*seconds);
            0
        }
        Event::Restart => {
            bench.restart("");
            bench.wait_ms(500);
            0
        }
    }
}

/// All registers and coils, by address.
struct State {
    holding: Vec<u16>,
    input: Vec<u16>,
    discrete: u8,
    coils: u8,
}

impl State {
    fn of(bench: &mut Bench) -> Self {
        Self {
            holding: bench.read(1, 3, 0, 41).unwrap(),
            input: bench.read(1, 4, 0, 2).unwrap(),
            discrete: bench.ask(&[1, 2, 0, 0, 0, 2]).unwrap()[3],
            coils: bench.ask(&[1, 1, 0, 0, 0, 7]).unwrap()[3],
        }
    }

    fn coil(&self, addr: u8) -> bool {
        self.coils >> addr & 1 == 1
    }

    fn number(&self, addr: usize) -> i32 {
        i32::from(self.holding[addr] as i16)
    }

    /// The rules between registers, from the clauses.
    fn check(&self) {
        let is_fahrenheit = self.coil(5);
        let (low, high, gap, eco, correction) =
            if is_fahrenheit { (4100, 10_400, 900, 3600..=7200, 1440) } else { (500, 4000, 500, 200..=2200, 800) };
        let (target, min, max) = (self.number(23), self.number(26), self.number(27));
        assert!(low <= min && max <= high, "VOL-14: {min} to {max}");
        assert!(max - min >= gap, "VOL-14: {min} to {max}");
        assert!(min <= target && target <= max, "VOL-13: {target} outside {min} to {max}");
        assert!(eco.contains(&self.number(24)), "VOL-10: eco {}", self.number(24));
        assert!((50..=200).contains(&self.number(25)), "VOL-10: delta {}", self.number(25));
        assert!((23..28).all(|addr| self.number(addr) % 50 == 0), "VOL-10: half degrees {:?}", &self.holding[23..28]);
        assert!(self.number(3).abs() <= correction, "VOL-1: correction {}", self.number(3));
        for period in self.holding[28..40].chunks(2) {
            assert!(period[0] < period[1] && period[1] <= 1425, "VOL-15: {period:?}");
            assert!(period.iter().all(|minute| minute % 15 == 0), "VOL-11: {period:?}");
        }
        assert!(matches!(self.holding[22], 0 | 1 | 15..=100), "VOL-12: {}", self.holding[22]);
        assert!(matches!((self.holding[18], self.holding[21]), (1, 0) | (2, 1) | (3, 0 | 1)), "VOL-42");
        let last = match self.holding[7] {
            2 => 28 + u16::from(self.holding[6].is_multiple_of(4)),
            4 | 6 | 9 | 11 => 30,
            _ => 31,
        };
        assert!((1..=last).contains(&self.holding[8]), "VOL-20: {:?}", &self.holding[6..9]);
        assert!(!self.coil(3), "VOL-47");
        assert_eq!(self.input[1] == 0, self.holding[19] == 0, "VOL-44");
        assert!(self.holding[12] <= 1000 && !(self.coil(0) && self.coil(1)), "VOL-43, VOL-45");
        let is_stopped = !self.coil(2) && self.holding[20] == 0 || self.input[0] == 0x8000;
        assert!(!is_stopped || (self.coils & 3, self.holding[12]) == (0, 0), "VOL-46, VOL-48");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn vol_10_to_21_no_sequence_of_writes_breaks_a_rule_between_registers(
        events in prop::collection::vec(event(), 1..60),
    ) {
        let mut bench = Plan::of(MODEL, 1).line(bench_line()).start();
        let mut before = State::of(&mut bench);
        for event in &events {
            let code = play(&mut bench, event);
            let after = State::of(&mut bench);
            after.check();
            prop_assert!(matches!(code, 0 | 2 | 3));
            if code != 0 {
                prop_assert_eq!(&before.holding, &after.holding, "refused {:?} (BUS-10)", event);
            }
            before = after;
        }
    }

    #[test]
    fn vol_30_there_and_back_gives_the_old_temperatures_whatever_came_before(
        events in prop::collection::vec(prop_oneof![3 => temperatures(), 1 => units()], 1..40),
        correction in -800..=800_i16,
    ) {
        let mut bench = Plan::of(MODEL, 1).register("ntc_1_correct", i64::from(correction)).start();
        for event in &events {
            play(&mut bench, event);
        }
        let before = State::of(&mut bench);
        for _ in 0..3 {
            play(&mut bench, &Event::Coil(5, !before.coil(5)));
            State::of(&mut bench).check();
            play(&mut bench, &Event::Coil(5, before.coil(5)));
        }
        // The fan may have come or gone: half a degree of hysteresis is less in °F.
        let mut after = State::of(&mut bench).holding;
        after[12] = before.holding[12];
        prop_assert_eq!(&after, &before.holding);
    }
}

/// The line that go_to_default leaves, so that the device stays in reach.
fn bench_line() -> standin::line::Line {
    standin::line::Line { baud: 9600, parity: standin::line::Parity::Even, stop_bits: 1 }
}

/// A second controller, from VOL-41 to VOL-48 alone.
#[derive(Default)]
struct Twin {
    is_heating: bool,
    is_cooling: bool,
    is_protecting: bool,
}

impl Twin {
    /// Valves and fan for the state of the registers.
    fn follow(&mut self, state: &State) -> (bool, bool, i32) {
        let reading = i32::from(state.input[0] as i16);
        if reading == -32768 {
            *self = Self::default();
            return (false, false, 0);
        }
        let is_fahrenheit = state.coil(5);
        let (target, eco, delta) = (state.number(23), state.number(24), state.number(25));
        match state.holding[20] {
            0 => self.is_protecting = false,
            _ if reading < eco => self.is_protecting = true,
            _ if reading >= eco + if is_fahrenheit { 180 } else { 100 } => self.is_protecting = false,
            _ => {}
        }
        let works = state.coil(2) && matches!(state.input[1], 0 | 1 | 3);
        let heats = works && state.holding[21] == 1 && state.holding[18] != 1;
        let cools = works && state.holding[21] == 0 && state.holding[18] != 2 && !self.is_protecting;
        self.is_heating = heats && (reading <= target - delta || self.is_heating && reading < target);
        self.is_cooling = cools && (reading >= target + delta || self.is_cooling && reading > target);
        let speed = i32::from(state.holding[22]) * 10;
        let more = i32::from(state.holding[16]);
        let automatic = {
            let share = f64::from((target - reading).abs()) / if is_fahrenheit { 900.0 } else { 500.0 };
            ((share * 1000.0).round() as i32).clamp(150, 1000)
        };
        let mut fan = 0;
        if self.is_heating || self.is_cooling {
            fan = 1000.min(more + if state.holding[40] == 1 { automatic } else { speed });
        }
        if self.is_protecting && state.holding[20] == 2 {
            fan = fan.max(1000.min(more + speed.max(150)));
        }
        (self.is_heating || self.is_protecting, self.is_cooling, fan)
    }
}

fn control_event() -> impl Strategy<Value = Event> {
    let write = |addr: u16, values: std::ops::RangeInclusive<u16>| {
        values.prop_map(move |value| Event::Write(addr, value)).boxed()
    };
    prop_oneof![
        10 => (16.0..24.0_f64).prop_map(|celsius| Event::Input("room_temperature", (celsius * 4.0).round() / 4.0)),
        2 => write(23, 1700..=2300),
        2 => write(24, 1600..=2000),
        1 => write(25, 50..=200),
        1 => write(16, 0..=400),
        1 => write(20, 0..=2),
        1 => write(21, 0..=1),
        1 => write(18, 1..=3),
        1 => write(22, 0..=100),
        1 => write(40, 0..=1),
        1 => write(19, 0..=1),
        1 => write(9, 0..=23),
        1 => write(23, 6200..=7400),
        1 => write(24, 6200..=7000),
        1 => any::<bool>().prop_map(|on| Event::Coil(2, on)),
        1 => units(),
        1 => any::<bool>().prop_map(|on| Event::Input("ntc_1_fault", f64::from(u8::from(on)))),
        2 => Just(Event::Pass(1.0)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn vol_41_to_48_the_control_does_what_the_clauses_say(
        events in prop::collection::vec(control_event(), 1..80),
    ) {
        let mut bench = Plan::of(MODEL, 1).input("outside_temperature", 18.0).start();
        let mut twin = Twin::default();
        for event in &events {
            play(&mut bench, event);
            // A write is followed at once, the room when it is measured, a second later at most.
            for _ in 0..2 {
                let state = State::of(&mut bench);
                let wanted = twin.follow(&state);
                let got = (state.coil(0), state.coil(1), i32::from(state.holding[12]));
                prop_assert_eq!(got, wanted, "after {:?}, reading {}", event, state.input[0] as i16);
                bench.advance_s(1.0);
            }
            let state = State::of(&mut bench);
            let is_sound = bench.input_value("ntc_1_fault") == 0.0;
            prop_assert_eq!((state.discrete & 1 == 1, state.input[0] != 0x8000), (is_sound, is_sound));
            twin.follow(&state);
        }
    }
}

/// A room and its surroundings.
#[derive(Clone, Debug)]
struct Weather {
    room: f64,
    outside: f64,
    water: f64,
    chilled: f64,
    speed: u16,
    mode: u16,
    target: u16,
}

fn weather() -> impl Strategy<Value = Weather> {
    let numbers = (-5.0..45.0_f64, -30.0..45.0_f64, 0.0..95.0_f64, 0.0..40.0_f64);
    (numbers, 0..=100_u16, 0..=1_u16, 500..=4000_u16).prop_map(
        |((room, outside, water, chilled), speed, mode, target)| Weather {
            room,
            outside,
            water,
            chilled,
            speed,
            mode,
            target,
        },
    )
}

impl Weather {
    fn plan(&self) -> Plan {
        Plan::of(MODEL, 1)
            .input("room_temperature", self.room)
            .input("outside_temperature", self.outside)
            .input("water_temperature", self.water)
            .input("chilled_water_temperature", self.chilled)
            .register("zone_fan_speed", i64::from(self.speed))
            .register("zone_mode", i64::from(self.mode))
            .register("zone_temperature_target", i64::from(self.target))
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn vol_49_heating_never_cools_and_cooling_never_heats(weather in weather()) {
        let mut live = weather.plan().start();
        let mut idle = weather.plan().register("power_on_off", 0).start();
        let mut low = weather.room;
        for _ in 0..120 {
            let (heats, cools) = (live.get("state_output_1") == 1, live.get("state_output_2") == 1);
            // The same room, left alone for the same second.
            idle.input("room_temperature", low);
            live.advance_s(1.0);
            idle.advance_s(1.0);
            let (next, alone) = (live.input_value("room_temperature"), idle.input_value("room_temperature"));
            let is_right = match (heats, cools) {
                (true, false) if weather.water > low => next > alone,
                (false, true) if weather.chilled < low => next < alone,
                _ => next == alone,
            };
            prop_assert!(is_right, "from {low} to {next}, alone to {alone}: {heats} {cools}");
            // No jump without a cause: nothing around it is as strong as 0.1 °C a second.
            prop_assert!((next - low).abs() < 0.1);
            low = next;
        }
    }

    #[test]
    fn vol_49_the_room_stays_between_what_is_around_it(weather in weather(), hours in 1..200_u32) {
        let mut bench = weather.plan().start();
        bench.advance_s(f64::from(hours) * 3600.0);
        let room = bench.input_value("room_temperature");
        let mut around = vec![weather.room, weather.outside];
        around.push(if weather.mode == 1 { weather.water } else { weather.chilled });
        let low = around.iter().copied().fold(f64::MAX, f64::min);
        let high = around.iter().copied().fold(f64::MIN, f64::max);
        prop_assert!(low - 1e-9 <= room && room <= high + 1e-9, "{} is not between {} and {}", room, low, high);
    }

    #[test]
    fn vol_49_more_fan_warms_more(weather in weather(), slow in 15..=99_u16) {
        let cold = Weather { room: 10.0, water: 60.0, mode: 1, target: 4000, ..weather };
        let mut slower = Weather { speed: slow, ..cold.clone() }.plan().start();
        let mut faster = Weather { speed: slow + 1, ..cold }.plan().start();
        slower.advance_s(300.0);
        faster.advance_s(300.0);
        prop_assert!(faster.input_value("room_temperature") > slower.input_value("room_temperature"));
    }

    #[test]
    fn vol_49_one_long_advance_is_many_short_ones(
        weather in weather(),
        events in prop::collection::vec((event(), 0.05..7000.0_f64), 1..8),
        pieces in prop::collection::vec(0.001..1.0_f64, 1..12),
        is_automatic in any::<bool>(),
    ) {
        let plan = || {
            let plan = weather.plan().line(bench_line()).register("zone_eco_frost_mode", 2).register("zone_program", 1);
            plan.register("fan_regulation_mode", i64::from(is_automatic)).register("ntc_period", 7)
        };
        let (mut whole, mut split) = (plan().start(), plan().start());
        for (event, seconds) in &events {
            let us = (seconds * 1e6) as i64;
            whole.bus.advance_clock(whole.now, us);
            let sum: f64 = pieces.iter().sum();
            let mut left = us;
            for piece in &pieces {
                let part = ((us as f64 * piece / sum) as i64).min(left);
                split.bus.advance_clock(split.now, part);
                left -= part;
            }
            split.bus.advance_clock(split.now, left);
            prop_assert_eq!(play(&mut whole, event), play(&mut split, event));
            let (one, other) = (State::of(&mut whole), State::of(&mut split));
            prop_assert_eq!((one.holding, one.input, one.coils), (other.holding, other.input, other.coils));
            let rooms = [&mut whole, &mut split].map(|bench| bench.input_value("room_temperature").to_bits());
            prop_assert_eq!(rooms[0], rooms[1]);
        }
    }
}

#[test]
fn vol_49_a_clock_at_any_rate_gives_the_same_day() {
    let day = |rate: f64| {
        let plan = Plan::of(MODEL, 1).clock("2014-10-27T06:00:00", rate);
        let plan = plan.register("zone_mode", 1).register("zone_program", 1).register("zone_fan_speed", 60);
        let mut bench = plan.register("zone_eco_frost_mode", 2).start();
        bench.wait_us((86_400e6 / rate) as u64);
        let state = State::of(&mut bench);
        (state.holding, state.input, state.coils, bench.input_value("room_temperature").to_bits())
    };
    let slow = day(100.0);
    assert_eq!(day(3600.0), slow);
    assert_eq!(day(86_400.0), slow);
}

#[test]
fn vol_40_a_year_passes_at_once_and_the_clock_is_right() {
    let mut bench = Plan::of(MODEL, 1).clock("2014-01-01T00:00:00", 1.0).register("zone_mode", 1).start();
    bench.advance_s(365.0 * 86_400.0);
    let state = State::of(&mut bench);
    // 1 January 2015 was a Thursday.
    assert_eq!(state.holding[5..12], [3, 15, 1, 1, 0, 0, 0]);
    assert!((2148..=2202).contains(&state.input[0]), "{}", state.input[0]);
}
