//! The PFC24S-TCR in long runs and random surroundings: what no single dialogue shows. Expectations are made here from
//! the formulas of PFC-10 to PFC-16, not from the relay's code.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use std::sync::Arc;

use bench::{Bench, Plan};
use proptest::array::uniform3;
use proptest::prelude::*;
use standin::image::Layout;
use standin::options::OptionValue;
use standin::station::{Saved, Station};
use standin::time::SimClock;

const MODEL: &str = "logiccon-pfc24s-tcr";
const PHASES: [&str; 3] = ["a", "b", "c"];

/// A step as a test sets it.
#[derive(Clone, Debug)]
struct Step {
    is_capacitive: bool,
    status: u16,
    hundredths: i64,
    connection: usize,
    delay_100ms: u16,
}

/// A grid as a test sets it.
#[derive(Clone, Debug)]
struct Grid {
    volts: [f64; 3],
    kw: [f64; 3],
    kvar: [f64; 3],
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let power = prop_oneof![Just(100), Just(250), Just(500), Just(1000), Just(2000), 0..4000_i64];
    let status = prop_oneof![6 => Just(0_u16), 1 => Just(1), 1 => Just(2)];
    let step = (proptest::bool::weighted(0.8), status, power, 0..7_usize, 0..10_u16).prop_map(
        |(is_capacitive, status, hundredths, connection, delay_100ms)| Step {
            is_capacitive,
            status,
            hundredths,
            connection,
            delay_100ms,
        },
    );
    proptest::collection::vec(step, 24)
}

fn grid() -> impl Strategy<Value = Grid> {
    let volts = prop_oneof![3 => Just(230.0), 1 => (190.0..260.0).prop_map(thousandths)];
    let power = (-40.0..60.0).prop_map(thousandths);
    (uniform3(volts), uniform3(power.clone()), uniform3(power)).prop_map(|(volts, kw, kvar)| Grid { volts, kw, kvar })
}

fn thousandths(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

fn planned(steps: &[Step]) -> Plan {
    let mut plan = Plan::of(MODEL, 1);
    for (index, step) in steps.iter().enumerate() {
        let name = |what: &str| format!("step_{}_{what}", index + 1);
        plan = plan
            .register(&name("type"), i64::from(step.is_capacitive))
            .register(&name("status"), i64::from(step.status))
            .register(&name("power_whole"), step.hundredths / 100)
            .register(&name("power_decimals"), step.hundredths % 100)
            .register(&name("connection"), step.connection as i64)
            .register(&name("switch_in_delay"), i64::from(step.delay_100ms) * 100)
            .register(&name("switch_out_delay"), i64::from(step.delay_100ms) * 100)
            .register(&name("delay_unit"), 2);
    }
    plan
}

fn set_grid(bench: &mut Bench, grid: &Grid) {
    for (index, phase) in PHASES.iter().enumerate() {
        bench.input(&format!("voltage_{phase}"), grid.volts[index]);
        bench.input(&format!("load_active_{phase}"), grid.kw[index]);
        bench.input(&format!("load_reactive_{phase}"), grid.kvar[index]);
    }
}

/// What a step adds to the total reactive power in kvar (PFC-10).
fn adds(step: &Step, grid: &Grid) -> f64 {
    let kvar = step.hundredths as f64 / 100.0 * if step.is_capacitive { -1.0 } else { 1.0 };
    let phase = |index: usize| (grid.volts[index] / 230.0).powi(2);
    let line = |a: usize, b: usize| {
        let (a, b) = (grid.volts[a], grid.volts[b]);
        (a * a + b * b - 2.0 * a * b * 120.0_f64.to_radians().cos()) / (398.0 * 398.0)
    };
    kvar * match step.connection {
        index @ 0..=2 => phase(index),
        3 => line(0, 1),
        4 => line(1, 2),
        5 => line(2, 0),
        _ => (phase(0) + phase(1) + phase(2)) / 3.0,
    }
}

fn connected(bench: &mut Bench) -> Vec<bool> {
    let reply = bench.ask(&[1, 1, 0, 0, 0, 24]).unwrap();
    (0..24).map(|step| reply[3 + step / 8] >> (step % 8) & 1 == 1).collect()
}

fn total_kvar(bench: &mut Bench) -> f64 {
    bench.get("reactive_power_total") as f64 / 1000.0
}

/// What `reach` kvar of reactors leave of a distance from the target.
fn after_reactors(error: f64, reach: f64) -> f64 {
    if error < 0.0 { (error + reach).min(0.0) } else { error }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// PFC-11, PFC-13: whatever the load and the steps, every switching brings the total closer to the target, it settles
    /// within the sum of the delays, and in the end no single step would bring it closer.
    #[test]
    fn pfc_11_the_closed_loop_settles(
        steps in steps(),
        grids in proptest::collection::vec(grid(), 1..4),
        reference in -200..200_i64,
        star in prop_oneof![Just(0_i64), 1..30_i64],
    ) {
        let mut bench = planned(&steps)
            .register("target", 1)
            .register("reference_var_1", reference.abs())
            .register("reference_sign_1", i64::from(reference < 0))
            .register("star_tcr_power_whole", star)
            .register("star_tcr_status", 1)
            .start();
        for grid in &grids {
            set_grid(&mut bench, grid);
            let delays: u64 = steps.iter().map(|step| u64::from(step.delay_100ms) * 2).sum();
            let mut distance = (total_kvar(&mut bench) - reference as f64).abs();
            for _ in 0..=delays {
                bench.wait_ms(100);
                let next = (total_kvar(&mut bench) - reference as f64).abs();
                prop_assert!(next <= distance + 0.0015, "from {distance} to {next} kvar");
                distance = next;
            }
            let settled = connected(&mut bench);
            let counts: Vec<i64> = (1..=24).map(|step| bench.get(&format!("step_{step}_switch_count"))).collect();
            bench.advance_s(86_400.0);
            prop_assert_eq!(&connected(&mut bench), &settled);
            let later: Vec<i64> = (1..=24).map(|step| bench.get(&format!("step_{step}_switch_count"))).collect();
            prop_assert_eq!(counts, later, "it hunts");

            let load: f64 = grid.kvar.iter().sum();
            let of_steps: f64 = (0..24).filter(|step| settled[*step]).map(|step| adds(&steps[step], grid)).sum();
            let error = load + of_steps - reference as f64;
            let rest = after_reactors(error, star as f64);
            prop_assert!((total_kvar(&mut bench) - (reference as f64 + rest)).abs() < 0.002);
            for (index, step) in steps.iter().enumerate() {
                match step.status {
                    1 => prop_assert!(settled[index], "step {} is fixed", index + 1),
                    2 => prop_assert!(!settled[index], "step {} is passive", index + 1),
                    _ => {
                        let change = if settled[index] { -adds(step, grid) } else { adds(step, grid) };
                        let other = after_reactors(error + change, star as f64);
                        prop_assert!(other.abs() > rest.abs() - 0.0015, "step {} would leave {other}, not {rest}", index + 1);
                    }
                }
            }
        }
    }

    /// PFC-11: what the steps can serve is served: the total ends as close as any choice among ten steps, from nothing.
    #[test]
    fn pfc_11_a_load_that_the_steps_can_serve_is_served(
        powers in proptest::collection::vec(1..4000_i64, 10),
        load in 0..30_000_i64,
    ) {
        let mut steps = vec![
            Step { is_capacitive: true, status: 2, hundredths: 0, connection: 6, delay_100ms: 1 };
            24
        ];
        for (step, hundredths) in steps.iter_mut().zip(&powers) {
            (step.status, step.hundredths) = (0, *hundredths);
        }
        let third = load as f64 / 300.0;
        let mut plan = planned(&steps);
        for phase in PHASES {
            plan = plan.input(&format!("load_reactive_{phase}"), third);
        }
        let mut bench = plan.start();
        bench.wait_ms(1000);
        let best = (0..1024_u32).map(|choice| {
            let sum: i64 = (0..10).filter(|step| choice >> step & 1 == 1).map(|step| powers[step]).sum();
            (load - sum).abs()
        });
        let best = best.min().unwrap() as f64 / 100.0;
        let rest = total_kvar(&mut bench).abs();
        prop_assert!((rest - best).abs() < 0.0015, "it leaves {rest} kvar, {best} are possible");
    }

    /// PFC-11: of equal steps none is switched more than one cycle more often than another, whatever the load does.
    #[test]
    fn pfc_11_equal_steps_are_used_evenly(loads in proptest::collection::vec(0..24_u32, 20..60)) {
        let step = Step { is_capacitive: true, status: 0, hundredths: 500, connection: 6, delay_100ms: 0 };
        let mut bench = planned(&vec![step; 24]).input("load_reactive_b", 0.0).input("load_reactive_c", 0.0).start();
        for load in loads {
            bench.input("load_reactive_a", f64::from(load) * 5.0);
            bench.advance_s(60.0);
            prop_assert_eq!(total_kvar(&mut bench), 0.0);
        }
        let counts: Vec<i64> = (1..=24).map(|step| bench.get(&format!("step_{step}_switch_count"))).collect();
        let spread = counts.iter().max().unwrap() - counts.iter().min().unwrap();
        prop_assert!(spread <= 2, "{counts:?}");
    }

    /// PFC-10: all values that are read agree with each other, for any voltages, loads and steps.
    #[test]
    fn pfc_10_the_measurements_agree(steps in steps(), grid in grid(), thd in 0..4000_u32) {
        let mut bench = planned(&steps).register("compensation", 0).start();
        set_grid(&mut bench, &grid);
        bench.input("thd_current", f64::from(thd) / 100.0);
        let mut kilo = |name: &str| bench.get(name) as f64 / 1000.0;
        for what in ["a", "b", "c", "total"] {
            let p = kilo(&format!("active_power_{what}"));
            let q = kilo(&format!("reactive_power_{what}"));
            let s = kilo(&format!("apparent_power_{what}"));
            prop_assert!((s - p.hypot(q)).abs() < 0.0015, "{what}: {s} of {p} and {q}");
            if what != "total" {
                let factor = kilo(&format!("power_factor_{what}"));
                prop_assert!((factor.abs() * s - p.abs()).abs() < 0.0006 * s + 0.002, "{what}: {factor} of {p} and {s}");
                prop_assert!(factor.signum() == q.signum() || q == 0.0 || factor == 0.0);
                let amperes = kilo(&format!("current_{what}")) * 10.0;
                let volts = kilo(&format!("voltage_{what}n")) * 10.0;
                prop_assert!((amperes * volts / 1000.0 - s).abs() < 0.005 * volts / 1000.0 + 0.005 * amperes / 1000.0 + 0.001);
            }
        }
        for power in ["active_power", "reactive_power"] {
            let sum: f64 = PHASES.iter().map(|phase| kilo(&format!("{power}_{phase}"))).sum();
            let total = kilo(&format!("{power}_total"));
            prop_assert!((sum - total).abs() < 0.0025, "{sum} is not {total}");
        }
        // The load and the steps that are fixed, phase by phase in sum.
        let fixed: f64 = steps.iter().filter(|step| step.status == 1).map(|step| adds(step, &grid)).sum();
        let wanted = grid.kvar.iter().sum::<f64>() + fixed;
        prop_assert!((kilo("reactive_power_total") - wanted).abs() < 0.001);
        let distortion = kilo("current_b_thd") * 10.0;
        let mut squares = 0.0;
        for order in 2..=31 {
            let percent = kilo(&format!("current_b_harmonic_{order}")) * 10.0;
            squares += percent * percent;
            if order % 2 == 1 {
                let third = kilo("current_b_harmonic_3") * 10.0;
                prop_assert!((percent * f64::from(order) - third * 3.0).abs() < 0.005 * f64::from(order) + 0.016);
            } else {
                prop_assert_eq!(percent, 0.0);
            }
        }
        prop_assert!((squares.sqrt() - distortion).abs() < 0.02, "{} of {distortion}", squares.sqrt());
    }

    /// PFC-14, PFC-15: energies are the sum of power and time between the changes, hours the time that steps were in, and
    /// a step is in when its switchings are odd in number.
    #[test]
    fn pfc_15_the_books_balance(
        steps in steps(),
        lives in proptest::collection::vec((grid(), 1..400_u32), 1..8),
    ) {
        let mut bench = planned(&steps).start();
        let mut energies = [0.0; 3];
        let mut hours = [0_u64; 24];
        for (grid, tenths) in &lives {
            set_grid(&mut bench, grid);
            // All delays are whole tenths of a second, so between them nothing changes.
            for _ in 0..*tenths {
                let kw = bench.get("active_power_total") as f64 / 1000.0;
                let kvar = bench.get("reactive_power_total") as f64 / 1000.0;
                for (energy, power) in energies.iter_mut().zip([kw, kvar, -kvar]) {
                    *energy += power.max(0.0) * 0.1 / 3600.0;
                }
                for (hours, is_in) in hours.iter_mut().zip(connected(&mut bench)) {
                    *hours += u64::from(is_in);
                }
                bench.wait_ms(100);
            }
        }
        let names = ["active_energy_total", "inductive_energy_total", "capacitive_energy_total"];
        let counted = names.map(|name| bench.get(name) as f64 / 1000.0);
        for (counted, energy) in counted.iter().zip(energies) {
            // The display cuts, and what was read to make the sum was rounded.
            prop_assert!((-0.00101..0.0001).contains(&(counted - energy)), "{counted} of {energy}");
        }
        let ratio = bench.get("inductive_energy_ratio") as f64 / 1000.0;
        if energies[0] > 0.5 && ratio < 60_000.0 {
            prop_assert!((ratio / 100.0 * energies[0] - energies[1]).abs() < 0.001 + energies[1] * 0.001);
        }
        let is_in = connected(&mut bench);
        for step in 0..24 {
            let shown = bench.get(&format!("step_{}_hours_in", step + 1)) as u64;
            prop_assert_eq!(shown, hours[step] / 36, "step {}", step + 1);
            let count = bench.get(&format!("step_{}_switch_count", step + 1));
            prop_assert_eq!(count % 2 == 1, is_in[step]);
        }
    }

    /// PFC-20: one long advance and many short ones end alike in all 658 input registers and all coils.
    #[test]
    fn pfc_20_the_state_does_not_depend_on_how_often_it_is_looked_at(
        steps in steps(),
        grid in grid(),
        reset in prop_oneof![Just(0_i64), 3..40_i64],
        cuts in proptest::collection::vec(1..200_000_i64, 1..60),
    ) {
        let build = || {
            let mut bench = planned(&steps)
                .register("device_reset_period", reset)
                .register("energy_reset_period", 1)
                .register("overcurrent_limit", 150)
                .register("overcurrent_action", 1)
                .register("undervoltage_limit", 205)
                .register("undervoltage_action", 2)
                .register("undervoltage_output", 2)
                .clock("2014-10-27T23:59:30", 1.0)
                .start();
            set_grid(&mut bench, &grid);
            bench
        };
        let (mut once, mut often) = (build(), build());
        let whole: i64 = cuts.iter().sum();
        once.advance_s(whole as f64 / 1000.0);
        for cut in &cuts {
            often.advance_s(*cut as f64 / 1000.0);
        }
        prop_assert_eq!(all(&mut once), all(&mut often));
    }
}

/// All coils and input registers as they are read.
fn all(bench: &mut Bench) -> Vec<u16> {
    let mut words: Vec<u16> = connected(bench).into_iter().map(u16::from).collect();
    let starts = (0..658).step_by(64);
    words.extend(starts.flat_map(|start| bench.read(1, 4, start, (658 - start).min(64)).unwrap()));
    words
}

fn image(bench: &mut Bench) -> Saved {
    // The image goes through its text, as it does in a file.
    let text = serde_json::to_string(&bench.saved("")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn pfc_17_a_restart_of_the_program_logs_the_time_at_which_it_ended() {
    let plan = || Plan::of(MODEL, 2).clock("2017-04-26T13:50:14", 1.0);
    let mut bench = plan().start();
    bench.wait_ms(60_000);
    let saved = image(&mut bench);
    let mut bench = Plan::of(MODEL, 2).clock("2017-04-27T08:00:00", 1.0).start_with(&[Some(saved)]);
    let event = bench.read(2, 4, 578, 10).unwrap();
    assert_eq!(event, [7, 0, 0, 0, 26, 4, 17, 14, 51, 13]);
    assert_eq!(bench.get("event_2_kind"), 0);
}

#[test]
fn pfc_17_a_program_that_ended_in_the_dark_logs_when_the_supply_was_lost() {
    let mut bench = Plan::of(MODEL, 2).clock("2017-04-26T13:51:14", 1.0).start();
    bench.input("supply", 0.0);
    bench.wait_ms(3_600_000);
    let saved = image(&mut bench);
    let dark = Plan::of(MODEL, 2).clock("2017-04-27T08:00:00", 1.0).input("supply", 0.0);
    let mut bench = dark.start_with(&[Some(saved)]);
    bench.wait_ms(1000);
    let saved = image(&mut bench);
    let mut bench = Plan::of(MODEL, 2).clock("2017-04-28T08:00:00", 1.0).start_with(&[Some(saved)]);
    assert_eq!(bench.read(2, 4, 578, 10).unwrap(), [7, 0, 0, 0, 26, 4, 17, 14, 51, 13]);
    assert_eq!(bench.get("event_2_kind"), 0);
}

#[test]
fn pfc_20_memory_outlives_the_program() {
    let mut bench = Plan::of(MODEL, 1)
        .register("step_1_status", 1)
        .register("energy_reset_period", 3)
        .register("star_tcr_power_whole", 9)
        .register("star_tcr_status", 1)
        .start();
    assert_eq!(bench.write(1, 241, 4711), 0);
    bench.advance_s(10_000.0);
    bench.input("input_2", 1.0);
    // 60 kW for 10,000 s are 166.666 kWh; step 1, fixed at 1 kvar, is in for 2.777 h.
    let saved = image(&mut bench);
    let mut bench = Plan::of(MODEL, 1).start_with(&[Some(saved)]);
    assert_eq!(bench.get("password"), 4711);
    assert_eq!(bench.get("energy_reset_period"), 3);
    assert_eq!(bench.get("active_energy_total"), 166_666);
    assert_eq!(bench.get("step_1_hours_in"), 2777);
    assert_eq!(bench.get("step_1_switch_count"), 2);
    assert_eq!(bench.get("step_11_switch_count"), 1);
    assert_eq!(bench.get("event_1_kind"), 7);
    assert_eq!(bench.get("event_2_kind"), 6);
    // Nothing is lost below the last digit: 10,000 s and 0.08 s of 60 kW are 166.668 kWh exactly.
    bench.wait_ms(80);
    assert_eq!(bench.get("active_energy_total"), 166_668);
    // The gains are still there: 60 kvar fixed against 45 leave 6.
    assert_eq!(bench.write(1, 240, 0), 0);
    assert_eq!(bench.write(1, 3, 60), 0);
    assert_eq!(bench.get("reactive_power_total"), -6000);
}

#[test]
fn pfc_20_other_digits_after_a_restart_show_the_same_values() {
    let mut bench = Plan::of(MODEL, 1).start();
    bench.advance_s(10_000.0);
    let saved = image(&mut bench);
    let digits = OptionValue::Integer(1);
    let mut bench = Plan::of(MODEL, 1).option("decimal_digits.note3", digits).start_with(&[Some(saved)]);
    assert_eq!(bench.read(1, 4, 544, 2).unwrap(), [166, 6]);
}

#[test]
fn pfc_20_an_image_that_makes_no_sense_is_refused() {
    let saved = image(&mut Plan::of(MODEL, 1).start());
    let refusal = |change: fn(&mut Saved)| {
        let mut saved = saved.clone();
        change(&mut saved);
        let plan = Plan::of(MODEL, 1);
        let setup = plan.setups.into_iter().next().unwrap();
        let layout = Arc::new(Layout::new(setup.kind.map));
        Station::new(setup, layout, Some(&saved), &SimClock::new(plan.start, 1.0)).unwrap_err().join("; ")
    };
    assert!(refusal(|saved| saved.device = serde_json::Value::Null).contains("Kept"));
    assert!(refusal(|saved| saved.device["memory"]["meters"]["hours"] = serde_json::json!([])).contains("length"));
    let nine = |saved: &mut Saved| {
        let event = serde_json::json!({"kind": "power_loss", "reading": {"milli": 0, "phase": 0}, "time": "2017-04-26T13:51:14"});
        saved.device["memory"]["log"] = serde_json::Value::Array(vec![event; 9]);
    };
    assert!(refusal(nine).contains("8 events"));
}

#[test]
fn pfc_20_the_same_run_gives_the_same_bytes() {
    let run = || {
        let mut bench = Plan::of(MODEL, 1).start();
        for step in 0..200_i32 {
            bench.input("load_reactive_a", f64::from(step * 37 % 60));
            bench.advance_s(7.3);
        }
        all(&mut bench)
    };
    assert_eq!(run(), run());
}

#[test]
fn pfc_11_a_day_of_24_steps_and_a_load_that_moves_every_second() {
    let mut plan = Plan::of(MODEL, 1).register("undervoltage_action", 2);
    for step in 1..=24 {
        plan = plan
            .register(&format!("step_{step}_status"), 0)
            .register(&format!("step_{step}_power_whole"), step * 7 % 50 + 1)
            .register(&format!("step_{step}_power_decimals"), step * 13 % 100)
            .register(&format!("step_{step}_switch_in_delay"), 2)
            .register(&format!("step_{step}_switch_out_delay"), 1);
    }
    let mut bench = plan.start();
    // Two hours here: a day takes twelve times as long.
    for second in 0..7200_i32 {
        bench.input("load_reactive_a", f64::from(second * 7919 % 500) / 3.0);
        bench.advance_s(1.0);
    }
    let switchings: i64 = (1..=24).map(|step| bench.get(&format!("step_{step}_switch_count"))).sum();
    assert!(switchings > 100, "{switchings}");
    assert_eq!(bench.get("active_energy_total"), 120_000);
}

#[test]
fn pfc_20_full_meters_are_kept_whatever_the_digits() {
    let plan = |digits| Plan::of(MODEL, 1).option("decimal_digits.note3", OptionValue::Integer(digits));
    let mut bench = plan(4).register("compensation", 0).start();
    bench.force("active_energy_total", 655_359_999);
    let saved = image(&mut bench);
    let mut bench = plan(0).start_with(&[Some(saved)]);
    assert_eq!(bench.read(1, 4, 544, 2).unwrap(), [65_535, 0]);
    let saved = image(&mut bench);
    let mut bench = plan(4).start_with(&[Some(saved)]);
    assert_eq!(bench.read(1, 4, 544, 2).unwrap(), [65_535, 9_999]);
}
