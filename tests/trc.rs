//! The TRC beyond its transcripts: the manual's table value by value, the physics over random sites, time and memory.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{Bench, Plan, exception, framed};
use proptest::prelude::*;
use standin::options::OptionValue;
use standin::station::Saved;

const MODEL: &str = "logiccon-trc";
const UNIT: u8 = 4;

/// The manual's table of holding registers (Tablo 3), typed from it: address, least, most.
const MANUAL: [(u16, u16, u16); 12] = [
    (0, 1, 255),
    (1, 0, 5),
    (2, 0, 1),
    (3, 215, 290),
    (4, 1, 30),
    (5, 1, 200),
    (6, 230, 270),
    (7, 150, 210),
    (8, 240, 290),
    (9, 200, 225),
    (10, 20, 60),
    (11, 15, 45),
];

/// Those whose ranges no other clause bends: unit, baud and stop bits are TRC-4's and TRC-6's.
const LIMITS: &[(u16, u16, u16)] = MANUAL.split_at(3).1;

fn plan() -> Plan {
    Plan::of(MODEL, UNIT)
}

fn accepting() -> Plan {
    plan().option("range_check", OptionValue::Choice("accept".into()))
}

#[track_caller]
fn holding(bench: &mut Bench, addr: u16) -> u16 {
    bench.read(UNIT, 3, addr, 1).unwrap()[0]
}

/// The five measurements: mains, output voltage, output current, battery current, temperature.
#[track_caller]
fn measured(bench: &mut Bench) -> [i64; 5] {
    let words = bench.read(UNIT, 4, 0, 10).unwrap();
    std::array::from_fn(|index| {
        let (high, low) = (u32::from(words[2 * index]), u32::from(words[2 * index + 1]));
        i64::from((high << 16 | low) as i32)
    })
}

/// Coils 0 to 10.
#[track_caller]
fn coils(bench: &mut Bench) -> [bool; 11] {
    let reply = bench.ask(&[UNIT, 1, 0, 0, 0, 11]).unwrap();
    assert_eq!((exception(&reply), reply[2]), (0, 2));
    std::array::from_fn(|index| reply[3 + index / 8] >> (index % 8) & 1 == 1)
}

#[test]
fn trc_5_each_limit_takes_its_range_and_no_more() {
    let mut bench = plan().start();
    for &(addr, least, most) in LIMITS {
        for value in [least, most] {
            assert_eq!(bench.write(UNIT, addr, value), 0, "{value} to {addr}");
            assert_eq!(holding(&mut bench, addr), value);
            assert_eq!(bench.write_many(UNIT, addr, &[value]), 0, "{value} to {addr}");
        }
        for value in [least - 1, most + 1, 0, 0x7FFF, 0x8000, 0xFFFF] {
            assert_eq!(bench.write(UNIT, addr, value), 3, "{value} to {addr}");
            assert_eq!(bench.write_many(UNIT, addr, &[value]), 3, "{value} to {addr}");
            assert_eq!(holding(&mut bench, addr), most);
        }
    }
}

#[test]
fn trc_5_accept_stores_every_value() {
    let mut bench = accepting().start();
    for &(addr, least, most) in LIMITS {
        for value in [least, most, least - 1, most + 1, 0, 0x7FFF, 0x8000, 0xFFFF] {
            assert_eq!(bench.write(UNIT, addr, value), 0, "{value} to {addr}");
            assert_eq!(holding(&mut bench, addr), value);
            assert_eq!(bench.write_many(UNIT, addr, &[value]), 0, "{value} to {addr}");
            assert_eq!(holding(&mut bench, addr), value);
        }
    }
}

#[test]
fn trc_4_wraps_every_word_and_echoes_it() {
    let mut bench = plan().start();
    for value in (0..=40).chain([0x7FFF, 0x8000, 0xFFFE, 0xFFFF]) {
        let [high, low] = u16::to_be_bytes(value);
        let echo = vec![UNIT, 6, 0, 1, high, low];
        assert_eq!(bench.ask(&echo), Some(echo.clone()));
        assert_eq!(holding(&mut bench, 1), if value <= 5 { value } else { value % 5 });
        let echo = vec![UNIT, 6, 0, 2, high, low];
        assert_eq!(bench.ask(&echo), Some(echo.clone()));
        assert_eq!(holding(&mut bench, 2), value % 2);
    }
}

#[test]
fn trc_6_every_unit_from_1_to_255_answers_from_the_next_request_on() {
    let mut bench = plan().start();
    let mut unit = UNIT;
    for next in (1..=255).rev() {
        assert_eq!(bench.ask(&[unit, 6, 0, 0, 0, next]), Some(vec![unit, 6, 0, 0, 0, next]));
        assert_eq!(bench.ask(&[next, 3, 0, 0, 0, 1]), Some(vec![next, 3, 2, 0, next]));
        unit = next;
    }
}

#[test]
fn trc_13_a_forced_limit_holds_too() {
    let mut bench = plan().start();
    bench.force("ac_high_limit", 200);
    assert_eq!(bench.get("relay8_ac_high"), 1);
    assert_eq!(bench.get("battery_current"), -20);
}

#[test]
fn trc_15_a_change_in_the_middle_of_a_step_counts_to_the_microsecond() {
    // 36 A for 0.3 s are 0.003 Ah of 10 Ah, in the middle of a second or across two.
    for start_s in [0.0, 0.2, 0.9, 0.999_999] {
        let site = plan().input("ac_voltage", 0.0).input("battery_capacity", 10.0).input("load_current", 0.0);
        let mut bench = site.register("output_current_limit", 200).start();
        bench.advance_s(start_s);
        bench.input("load_current", 18.0);
        bench.advance_s(0.6);
        bench.input("load_current", 0.0);
        bench.advance_s(1000.0);
        let charge = bench.input_value("battery_charge");
        assert!((charge - 0.8997).abs() < 1e-9, "{charge} when started at {start_s} s");
    }
}

/// What happens to a charger: a time until it, and an input or a register.
#[derive(Clone, Debug)]
enum Event {
    Input(&'static str, f64),
    Write(u16, u16),
}

fn event() -> impl Strategy<Value = Event> {
    let number = |name, most: f64| (0.0..=most).prop_map(move |value: f64| Event::Input(name, value));
    let flag = |name| any::<bool>().prop_map(move |flag| Event::Input(name, f64::from(u8::from(flag))));
    let limit = (0..LIMITS.len(), 0.0..=1.0).prop_map(|(index, share): (usize, f64)| {
        let (addr, least, most) = LIMITS[index];
        Event::Write(addr, least + (f64::from(most - least) * share).round() as u16)
    });
    prop_oneof![
        2 => prop_oneof![Just(0.0), Just(230.0), 140.0..280.0].prop_map(|volts| Event::Input("ac_voltage", volts)),
        1 => (-20.0..60.0).prop_map(|c: f64| Event::Input("ambient_temperature", c)),
        2 => number("load_current", 25.0),
        1 => number("battery_charge", 1.0),
        1 => (0.5..50.0).prop_map(|ah: f64| Event::Input("battery_capacity", ah)),
        1 => flag("battery_connected"),
        1 => flag("short_circuit"),
        1 => flag("dc_leak_positive"),
        1 => flag("dc_leak_negative"),
        1 => flag("alarm_silenced"),
        4 => limit,
    ]
}

fn happen(bench: &mut Bench, event: &Event) {
    match *event {
        Event::Input(name, value) => bench.input(name, value),
        Event::Write(addr, value) => assert_eq!(bench.write(UNIT, addr, value), 0),
    }
}

/// What must hold whatever the site and the settings are, by what the bus shows.
fn check_laws(bench: &mut Bench, was: &[bool; 11]) -> Result<[bool; 11], TestCaseError> {
    let [mains, volts, output, battery, temperature] = measured(bench);
    let relays = coils(bench);
    let limits: Vec<i64> = bench.read(UNIT, 3, 0, 12).unwrap().iter().map(|word| i64::from(*word)).collect();
    let value = |bench: &mut Bench, name: &str| bench.input_value(name);
    let (load, shorted) = (value(bench, "load_current"), value(bench, "short_circuit") == 1.0);
    let feeds = !relays[7] && !relays[8];
    let state =
        format!("{mains} V, {volts}, {output}, {battery}, {temperature} °C, {relays:?}, {limits:?}, load {load}");

    // Kirchhoff, in tenths of an ampere: what the rectifier gives is what load and battery take (TRC-10).
    let given = output + battery;
    prop_assert!((0..=limits[5]).contains(&given), "{}", state);
    prop_assert!(battery <= limits[4], "{}", state);
    let held = ((load * 10.0).round() as i64).min(limits[5]);
    if shorted {
        prop_assert_eq!((volts, battery, output), (0, 0, if feeds { limits[5] } else { 0 }), "{}", state);
    } else if feeds {
        prop_assert_eq!(output, held, "{}", state);
        // Above the charge voltage only a battery that needs no rectifier stands (TRC-10).
        prop_assert!(volts <= limits[3] || given == 0 || battery == 0, "{}", state);
    } else {
        prop_assert_eq!(given, 0, "{}", state);
        prop_assert!(output == held && volts >= 199 || volts == 0 && output == 0, "{}", state);
    }
    // The contactor (TRC-11, TRC-14): no battery, short circuit or a cut-off, which needs bad mains.
    let wired = value(bench, "battery_connected") == 1.0;
    prop_assert!(!relays[2] || wired && !shorted, "{}", state);
    prop_assert!(relays[2] || !wired || shorted || !feeds, "{}", state);
    prop_assert!(relays[2] || battery == 0, "{}", state);
    prop_assert!(relays[2] || feeds || volts == 0 && output == 0, "{}", state);
    // The causes of the relays (TRC-1), those with a memory by their hysteresis (TRC-13).
    prop_assert_eq!(relays[3], shorted, "{}", state);
    prop_assert_eq!(relays[4], !shorted && load > limits[5] as f64 / 10.0, "{}", state);
    prop_assert_eq!(relays[5], value(bench, "dc_leak_negative") == 1.0, "{}", state);
    prop_assert_eq!(relays[6], value(bench, "dc_leak_positive") == 1.0, "{}", state);
    for (relay, beyond) in
        [(7, mains - limits[6]), (8, limits[7] - mains), (9, volts - limits[8]), (10, limits[9] - volts)]
    {
        // Between "beyond" and "2 inside" it is as it was; as it was a second ago is not known within that second.
        prop_assert!(beyond <= 0 || relays[relay], "relay {} {}", relay + 1, state);
        prop_assert!(beyond > -2 || !relays[relay], "relay {} {}", relay + 1, state);
        prop_assert!(beyond > 0 || beyond <= -2 || relays[relay] == was[relay], "relay {} {}", relay + 1, state);
    }
    prop_assert!(temperature < limits[10] || relays[1], "{}", state);
    prop_assert!(temperature > limits[11] || temperature >= limits[10] || !relays[1], "{}", state);
    let silenced = value(bench, "alarm_silenced") == 1.0;
    prop_assert_eq!(relays[0], !silenced && relays[3..].iter().any(|relay| *relay), "{}", state);
    Ok(relays)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// TRC-10 to TRC-14: bounds, Kirchhoff, conservation of charge, continuity, second by second.
    #[test]
    fn trc_10_the_laws_hold_in_every_state(
        script in prop::collection::vec((prop_oneof![0_u32..5, 0_u32..120], event()), 1..25),
    ) {
        let mut bench = plan().start();
        let mut relays = coils(&mut bench);
        for (seconds, event) in script {
            let capacity_as = bench.input_value("battery_capacity") * 3600.0;
            let before = bench.input_value("battery_charge");
            let mut taken_as = 0.0;
            for _ in 0..seconds {
                let (charge, flow) = (bench.input_value("battery_charge"), measured(&mut bench));
                bench.advance_s(1.0);
                // Continuity: a second moves the charge by the current of that second alone.
                let moved_as = (bench.input_value("battery_charge") - charge) * capacity_as;
                let shown_as = flow[3] as f64 / 10.0;
                prop_assert!((moved_as - shown_as).abs() <= 0.1 + 1e-6, "{moved_as} As, shown {shown_as} A");
                // And the temperature by no more than the fan's time constant lets it, and a rounding.
                let ambient = bench.input_value("ambient_temperature");
                let way = (flow[4] as f64 - ambient).abs().max(1.5 * flow[2] as f64 / 10.0) + 1.0;
                prop_assert!(((measured(&mut bench)[4] - flow[4]) as f64).abs() <= 1.0 + way / 120.0);
                taken_as += shown_as;
                relays = check_laws(&mut bench, &relays)?;
            }
            // Conservation: the charge has moved by the integral of the current, within its rounding.
            let charge = bench.input_value("battery_charge");
            prop_assert!((0.0..=1.0).contains(&charge));
            let moved_as = (charge - before) * capacity_as;
            prop_assert!((moved_as - taken_as).abs() <= 0.1 * f64::from(seconds) + 1e-6, "{moved_as} As, {taken_as} As");
            happen(&mut bench, &event);
            // The event may have moved relays any way; from here on they are held against themselves.
            relays = coils(&mut bench);
            check_laws(&mut bench, &relays)?;
        }
    }

    /// TRC-15: looking often or never, at any rate, the same happenings give the same registers.
    #[test]
    fn trc_15_polls_and_rates_change_nothing(
        script in prop::collection::vec((0_u64..4000, event()), 1..12),
    ) {
        let mut unwatched = plan().start();
        let mut watched = plan().clock("2014-10-27T14:22:08", 1.0).start();
        let mut fast = plan().clock("2014-10-27T14:22:08", 500.0).start();
        for (halves, event) in &script {
            unwatched.advance_s(*halves as f64 / 2.0);
            for _ in 0..*halves {
                watched.wait_ms(500);
                if halves % 7 == 0 {
                    measured(&mut watched);
                }
            }
            fast.wait_ms(*halves);
            for bench in [&mut unwatched, &mut watched, &mut fast] {
                happen(bench, event);
            }
        }
        let last = unwatched.bus.stations()[0].regs().clone();
        let charge = unwatched.input_value("battery_charge");
        for bench in [&mut watched, &mut fast] {
            prop_assert_eq!(&last, bench.bus.stations()[0].regs());
            prop_assert_eq!(charge, bench.input_value("battery_charge"));
        }
    }

    /// TRC-5: with option "accept" no value in any register breaks the physics.
    #[test]
    fn trc_5_accepted_nonsense_breaks_nothing(
        words in prop::collection::vec(prop_oneof![any::<u16>(), 0_u16..400], 9..=9),
        script in prop::collection::vec((0_u32..5000, event()), 1..10),
    ) {
        let mut bench = accepting().start();
        prop_assert_eq!(bench.write_many(UNIT, 3, &words), 0);
        for (seconds, event) in script {
            bench.advance_s(f64::from(seconds));
            happen(&mut bench, &event);
            let [_, volts, output, battery, _] = measured(&mut bench);
            prop_assert!((0..=i64::from(u16::MAX)).contains(&output));
            prop_assert!(volts <= 300 && (0..=i64::from(u16::MAX)).contains(&(output + battery)));
            prop_assert!((0.0..=1.0).contains(&bench.input_value("battery_charge")));
        }
    }

    /// TRC-7, BUS-4: one damaged bit: at most the addressed device speaks, and the next request is answered.
    #[test]
    fn trc_7_a_damaged_frame_never_disturbs_the_next(bit in 0_usize..64, unit in 4_u8..=5, function in 3_u8..=6) {
        prop_assume!(function != 5);
        let mut bench = plan().device(MODEL, 5).start();
        let mut frame = framed(&[unit, function, 0, 0, 0, 1]);
        frame[bit / 8] ^= 1 << (bit % 8);
        bench.send(&frame);
        let answer = bench.hear_within(100);
        let wanted = (4..=5).contains(&frame[0]).then(|| framed(&[frame[0], frame[1] | 0x80, 3]));
        prop_assert_eq!(answer, wanted);
        prop_assert!(bench.is_silent());
        for unit in [4, 5] {
            prop_assert_eq!(bench.ask(&[unit, 3, 0, 0, 0, 1]), Some(vec![unit, 3, 2, 0, unit]));
        }
    }
}

#[test]
fn trc_15_a_year_at_once_is_a_year_day_by_day() {
    let start = || plan().input("ac_voltage", 0.0).input("load_current", 0.01).start();
    let (mut once, mut daily) = (start(), start());
    once.advance_s(365.0 * 86_400.0);
    (0..365).for_each(|_| daily.advance_s(86_400.0));
    // 0.01 A empty 0.9 of 7 Ah in 630 h, less the 0.001 V on the battery's resistance: the contactor has opened.
    assert_eq!(once.get("relay3_battery_contactor"), 0);
    assert_eq!(once.bus.stations()[0].regs(), daily.bus.stations()[0].regs());
    assert_eq!(once.input_value("battery_charge"), daily.input_value("battery_charge"));
}

fn worked() -> Bench {
    // 10 min at 15 A: 0.9 - 2.5/7 = 0.5429 are left; the fan has come and brought it near to 31 °C.
    let mut bench = plan().input("ac_voltage", 0.0).input("load_current", 15.0).start();
    assert_eq!(bench.write(UNIT, 9, 222), 0);
    bench.advance_s(600.0);
    bench
}

#[test]
fn trc_20_the_image_wins_over_inputs() {
    let mut bench = worked();
    let before = measured(&mut bench);
    let charge = bench.input_value("battery_charge");
    assert!((charge - (0.9 - 2.5 / 7.0)).abs() < 1e-9);
    let image = bench.saved("");
    let site = plan().input("battery_charge", 0.5).input("ambient_temperature", 5.0).input("load_current", 15.0);
    let mut next = site.input("ac_voltage", 0.0).register("dc_low_limit", 201).start_with(&[Some(image)]);
    assert_eq!(next.input_value("battery_charge"), charge);
    assert_eq!(measured(&mut next), before);
    assert_eq!(holding(&mut next, 9), 222);
}

#[test]
fn trc_20_a_charge_that_is_set_is_kept() {
    let mut bench = plan().start();
    bench.advance_s(100.5);
    bench.input("battery_charge", 0.25);
    let mut next = plan().start_with(&[Some(bench.saved(""))]);
    assert_eq!(next.input_value("battery_charge"), 0.25);
}

#[test]
fn trc_20_an_image_that_makes_no_sense_is_refused() {
    let good: Saved = worked().saved("");
    for device in [
        serde_json::Value::Null,
        serde_json::json!({ "battery_charge": 1.5, "temperature": 25.0 }),
        serde_json::json!({ "battery_charge": 0.5 }),
        serde_json::json!({ "battery_charge": 0.5, "temperature": 25.0, "colour": 3 }),
        serde_json::json!({ "battery_charge": "half", "temperature": 25.0 }),
    ] {
        let image = Saved { device: device.clone(), ..good.clone() };
        let started = std::panic::catch_unwind(|| plan().start_with(&[Some(image)]));
        assert!(started.is_err(), "{device} was taken");
    }
}

#[test]
fn trc_20_limits_that_were_accepted_are_there_when_the_option_is_taken_away() {
    // The manual's own example of function 16 (TRC-5).
    let mut bench = accepting().start();
    assert_eq!(bench.write_many(UNIT, 9, &[35, 29, 50]), 0);
    let mut next = plan().start_with(&[Some(bench.saved(""))]);
    assert_eq!(next.read(UNIT, 3, 9, 3).unwrap(), [35, 29, 50]);
    assert_eq!(next.write(UNIT, 9, 35), 3);
}

#[test]
fn trc_20_an_image_with_line_settings_that_no_write_leaves_is_refused() {
    // Baud 6 would have wrapped to 1, two stop bits to 0, and unit 256 never was one (TRC-4, TRC-6).
    let good: Saved = accepting().start().saved("");
    for (name, raw) in [("baud", 6), ("stop_bits", 2), ("unit", 0), ("unit", 256)] {
        let mut image = good.clone();
        image.registers.insert(name.into(), raw);
        let started = std::panic::catch_unwind(|| accepting().start_with(&[Some(image)]));
        assert!(started.is_err(), "{name} {raw} was taken");
    }
}
