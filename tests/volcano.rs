//! The Volcano beyond its transcripts: the manual's tables value by value, and what it remembers. Its laws over random
//! writes and weathers are in `volcano_laws.rs`.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod bench;

use bench::{Bench, Plan, exception};
use standin::station::Saved;

const MODEL: &str = "hmi-volcano-ec";

fn plan() -> Plan {
    Plan::of(MODEL, 1)
}

#[track_caller]
fn holding(bench: &mut Bench, addr: u16) -> u16 {
    bench.read(1, 3, addr, 1).unwrap()[0]
}

#[track_caller]
fn write_coil(bench: &mut Bench, addr: u16, on: bool) -> u8 {
    let [a, b] = addr.to_be_bytes();
    exception(&bench.ask(&[1, 5, a, b, if on { 0xFF } else { 0 }, 0]).expect("a reply"))
}

/// Least and most.
type Range = (i32, i32);

/// The manual's limits of the registers beside the line's, typed from it: address, least and most in °C, and in °F. The
/// target, its limits and the schedule are bent by their neighbours' factory values.
const LIMITS: [(u16, Range, Range); 37] = [
    (3, (-800, 800), (-1440, 1440)),
    (4, (0, 65535), (0, 65535)),
    (5, (0, 6), (0, 6)),
    (6, (0, 99), (0, 99)),
    (7, (1, 12), (1, 12)),
    (8, (1, 31), (1, 31)),
    (9, (0, 23), (0, 23)),
    (10, (0, 59), (0, 59)),
    (11, (0, 59), (0, 59)),
    (13, (0, 1000), (0, 1000)),
    (14, (0, 1000), (0, 1000)),
    (15, (0, 1000), (0, 1000)),
    (16, (0, 400), (0, 400)),
    (17, (0, 1), (0, 1)),
    (18, (1, 3), (1, 3)),
    (19, (0, 1), (0, 1)),
    (20, (0, 2), (0, 2)),
    (21, (0, 1), (0, 1)),
    (22, (0, 100), (0, 100)),
    (23, (500, 4000), (4100, 10_400)),
    (24, (200, 2200), (3600, 7200)),
    (25, (50, 200), (50, 200)),
    (26, (500, 3500), (4100, 9500)),
    (27, (1000, 4000), (5000, 10_400)),
    (28, (0, 779), (0, 779)),
    (29, (495, 1425), (495, 1425)),
    (30, (0, 1079), (0, 1079)),
    (31, (855, 1425), (855, 1425)),
    (32, (0, 779), (0, 779)),
    (33, (495, 1425), (495, 1425)),
    (34, (0, 1079), (0, 1079)),
    (35, (855, 1425), (855, 1425)),
    (36, (0, 779), (0, 779)),
    (37, (495, 1425), (495, 1425)),
    (38, (0, 1079), (0, 1079)),
    (39, (855, 1425), (855, 1425)),
    (40, (0, 1), (0, 1)),
];

#[test]
fn vol_1_each_register_takes_its_range_and_no_more_in_both_units() {
    for is_fahrenheit in [false, true] {
        for (addr, celsius, fahrenheit) in LIMITS {
            let (least, most) = if is_fahrenheit { fahrenheit } else { celsius };
            let mut bench = plan().register("temp_unit", i64::from(is_fahrenheit)).start();
            for value in [least - 1, most + 1, 0x7FFF, 0x8000].into_iter().filter(|_| most < 65535) {
                let before = bench.read(1, 3, 0, 41).unwrap();
                assert_eq!(bench.write(1, addr, value as u16), 3, "{value} to {addr}");
                assert_eq!(bench.write_many(1, addr, &[value as u16]), 3, "{value} to {addr}");
                assert_eq!(bench.read(1, 3, 0, 41).unwrap(), before, "{value} to {addr}");
            }
            for value in [least, most] {
                let mut bench = plan().register("temp_unit", i64::from(is_fahrenheit)).start();
                assert_eq!(bench.write(1, addr, value as u16), 0, "{value} to {addr}");
                let wanted = if (28..40).contains(&addr) { value / 15 * 15 } else { value };
                assert_eq!(holding(&mut bench, addr), wanted as u16);
                assert_eq!(bench.write_many(1, addr, &[value as u16]), 0, "{value} to {addr}");
            }
        }
    }
}

#[test]
fn vol_1_every_line_register_value_is_taken_or_refused_as_listed() {
    let taken = [(0, vec![480, 960, 1920, 3840]), (1, vec![0x65, 0x6F, 0x6E]), (2, (1..=247).collect())];
    for (addr, allowed) in taken {
        for value in (0..=600).chain(900..=1000).chain([1919, 1920, 3840, 9600, 19_200, 0xFFFF]) {
            let mut bench = plan().start();
            let wanted = if allowed.contains(&value) { 0 } else { 3 };
            assert_eq!(bench.write(1, addr, value), wanted, "{value} to {addr}");
        }
    }
}

#[test]
fn vol_2_every_span_that_touches_0_to_3_carries_one_register_or_is_refused() {
    for start in 0..12_u16 {
        for quantity in 1..=(12 - start) {
            let mut bench = plan().start();
            let present = bench.read(1, 3, start, quantity).unwrap();
            let before = bench.read(1, 3, 0, 41).unwrap();
            let wanted = if start <= 3 && quantity > 1 { 3 } else { 0 };
            assert_eq!(bench.write_many(1, start, &present), wanted, "{quantity} from {start}");
            assert_eq!(bench.read(1, 3, 0, 41).unwrap(), before);
        }
    }
}

#[test]
fn vol_10_every_target_is_rounded_down_to_half_a_degree() {
    let mut bench = plan().start();
    for sent in 500..=4000_u16 {
        assert_eq!(bench.write(1, 23, sent), 0, "{sent}");
        assert_eq!(bench.get("zone_temperature_target"), i64::from(sent / 50) * 50);
    }
}

#[test]
fn vol_11_every_minute_is_rounded_down_to_a_quarter_of_an_hour() {
    let mut bench = plan().start();
    for sent in 855..=1425_u16 {
        assert_eq!(bench.write(1, 39, sent), 0, "{sent}");
        assert_eq!(bench.get("zone_schedule_sun_work_2_stop"), i64::from(sent / 15) * 15);
    }
}

#[test]
fn vol_20_the_last_day_of_every_month_of_every_year() {
    let mut bench = plan().start();
    for year in 0..100_u16 {
        for month in 1..=12_u16 {
            // 1900 is not in the device's century and 2000 is a leap year, so every fourth year is one.
            let last = match month {
                4 | 6 | 9 | 11 => 30,
                2 if year.is_multiple_of(4) => 29,
                2 => 28,
                _ => 31,
            };
            assert_eq!(bench.write_many(1, 6, &[year, month, last + 1]), 3, "{year}-{month}");
            assert_eq!(bench.write_many(1, 6, &[year, month, last]), 0, "{year}-{month}");
            assert_eq!(bench.read(1, 3, 6, 3).unwrap(), [year, month, last]);
        }
    }
}

#[test]
fn vol_22_a_week_passes_day_by_day() {
    let mut bench = plan().clock("2014-10-27T23:59:59", 1.0).start();
    for day in 0..15 {
        assert_eq!(bench.get("rtc_week_day"), day % 7);
        bench.advance_s(86_400.0);
    }
}

/// Every temperature that °C offers, with its limits and its nearest half degree in °F, worked out in 64-bit fractions.
#[test]
fn vol_30_every_half_degree_celsius_and_back() {
    let mut bench = plan().start();
    for celsius in (500..=4000_u16).step_by(50) {
        assert_eq!(bench.write(1, 23, celsius), 0);
        write_coil(&mut bench, 5, true);
        let exact = f64::from(celsius) * 1.8 + 3200.0;
        let shown = f64::from(holding(&mut bench, 23));
        assert!((shown - exact).abs() <= 25.0 && shown % 50.0 == 0.0, "{celsius} became {shown}");
        write_coil(&mut bench, 5, false);
        assert_eq!(holding(&mut bench, 23), celsius);
    }
}

#[test]
fn vol_30_every_half_degree_fahrenheit_and_back() {
    let mut bench = plan().start();
    write_coil(&mut bench, 5, true);
    for fahrenheit in (4100..=10_400_u16).step_by(50) {
        assert_eq!(bench.write(1, 23, fahrenheit), 0);
        write_coil(&mut bench, 5, false);
        let exact = (f64::from(fahrenheit) - 3200.0) / 1.8;
        let shown = f64::from(holding(&mut bench, 23));
        assert!((shown - exact).abs() <= 25.0 && shown % 50.0 == 0.0, "{fahrenheit} became {shown}");
        write_coil(&mut bench, 5, true);
        assert_eq!(holding(&mut bench, 23), fahrenheit);
    }
}

#[test]
fn vol_30_every_correction_there_and_back() {
    let mut bench = plan().start();
    for hundredths in (-800..=800_i16).step_by(7) {
        assert_eq!(bench.write(1, 3, hundredths as u16), 0);
        write_coil(&mut bench, 5, true);
        let shown = holding(&mut bench, 3) as i16;
        assert!((f64::from(shown) - f64::from(hundredths) * 1.8).abs() <= 0.5, "{hundredths} became {shown}");
        write_coil(&mut bench, 5, false);
        assert_eq!(holding(&mut bench, 3) as i16, hundredths);
    }
}

#[test]
fn vol_3_every_unit_speed_and_parity_is_reached_and_left() {
    let mut bench = plan().start();
    let mut unit = 1;
    for next in (1..=247).rev() {
        assert_eq!(bench.ask(&[unit, 6, 0, 2, 0, next]), Some(vec![unit, 6, 0, 2, 0, next]));
        let expect_restart = unit != next;
        assert_eq!(bench.ask(&[next, 3, 0, 2, 0, 1]).is_none(), expect_restart);
        bench.wait_ms(500);
        assert_eq!(bench.ask(&[next, 3, 0, 2, 0, 1]), Some(vec![next, 3, 2, 0, next]));
        unit = next;
    }
}

#[test]
fn vol_3_the_line_changes_when_the_restart_is_over_and_not_before() {
    let mut bench = plan().start();
    assert_eq!(bench.write(1, 0, 3840), 0);
    assert_eq!(bench.bus.stations()[0].address().line.baud, 9600);
    bench.wait_ms(499);
    assert_eq!(bench.bus.stations()[0].address().line.baud, 9600);
    bench.wait_ms(1);
    assert_eq!(bench.bus.stations()[0].address().line.to_string(), "38400 8N2");
    for (parity, shown) in [(0x65, "38400 8E1"), (0x6F, "38400 8O1"), (0x6E, "38400 8N2")] {
        assert_eq!(bench.write(1, 1, parity), 0);
        bench.wait_ms(500);
        assert_eq!(bench.bus.stations()[0].address().line.to_string(), shown);
    }
    assert_eq!(bench.bus.stations()[0].boots(), 5);
}

/// Starts again with the image of a bench, as a restart of the program does.
fn again(plan: Plan, image: &Saved) -> Bench {
    plan.start_with(&[Some(image.clone())])
}

#[test]
fn vol_50_a_restart_of_the_program_keeps_what_eeprom_keeps() {
    let mut bench = plan().start();
    assert_eq!(bench.write(1, 3, 120), 0);
    assert_eq!(bench.write_many(1, 13, &[1, 2, 3, 40, 0, 2, 1, 1, 1, 77, 2550, 1450, 150, 1050, 3500]), 0);
    assert_eq!(bench.write(1, 40, 1), 0);
    write_coil(&mut bench, 4, true);
    write_coil(&mut bench, 6, true);
    let image = bench.saved("");
    let mut bench = again(plan(), &image);
    assert_eq!(bench.read(1, 3, 13, 15).unwrap(), [400, 700, 1000, 40, 0, 2, 1, 1, 1, 77, 2550, 1450, 150, 1050, 3500]);
    assert_eq!((holding(&mut bench, 3), holding(&mut bench, 40)), (120, 1));
    assert_eq!(bench.ask(&[1, 1, 0, 2, 0, 5]), Some(vec![1, 1, 1, 0b10101]));
    // A start value comes before the first image only (BUS-22).
    let mut bench = again(plan().register("zone_temperature_target", 2000), &image);
    assert_eq!(holding(&mut bench, 23), 2550);
}

#[test]
fn vol_50_bus_22_the_clock_is_kept_as_a_difference() {
    let mut bench = plan().clock("2014-10-27T12:00:00", 1.0).start();
    assert_eq!(bench.write_many(1, 5, &[6, 30, 6, 15, 13, 0, 0]), 0);
    bench.advance_s(3600.0);
    let image = bench.saved("");
    // Started at the same time it shows the same; started a day and an hour later it has moved on by that.
    let mut same = again(plan().clock("2014-10-27T12:00:00", 1.0), &image);
    assert_eq!(same.read(1, 3, 5, 7).unwrap(), [6, 30, 6, 15, 13, 0, 0]);
    let mut later = again(plan().clock("2014-10-28T13:00:00", 1.0), &image);
    assert_eq!(later.read(1, 3, 5, 7).unwrap(), [0, 30, 6, 16, 14, 0, 0]);
}

#[test]
fn vol_50_a_clock_that_nobody_set_is_the_simulations() {
    let mut bench = plan().clock("2014-10-27T12:00:00", 1.0).start();
    let image = bench.saved("");
    let mut later = again(plan().clock("2016-02-29T08:30:15", 1.0), &image);
    assert_eq!(later.read(1, 3, 5, 7).unwrap(), [0, 16, 2, 29, 8, 30, 15]);
}

#[test]
fn vol_30_the_temperatures_of_the_other_unit_are_kept_with_the_image() {
    let mut bench = plan().register("temp_unit", 1).start();
    assert_eq!(bench.write_many(1, 23, &[7100, 5550]), 0);
    write_coil(&mut bench, 5, false);
    let image = bench.saved("");
    let mut bench = again(plan(), &image);
    // 71 °F are 21.67 °C and 55.5 °F 13.06 °C.
    assert_eq!(bench.read(1, 3, 23, 2).unwrap(), [2150, 1300]);
    write_coil(&mut bench, 5, true);
    assert_eq!(bench.read(1, 3, 23, 2).unwrap(), [7100, 5550]);
}

#[test]
fn vol_3_the_image_has_the_new_unit_before_the_restart_is_over() {
    let mut bench = plan().start();
    assert_eq!(bench.write(1, 2, 9), 0);
    let image = bench.saved("");
    let mut bench = again(plan(), &image);
    assert_eq!(bench.ask(&[9, 3, 0, 2, 0, 1]), Some(vec![9, 3, 2, 0, 9]));
}

#[test]
fn vol_41_a_forced_register_is_followed_and_a_forced_output_stays_until_something_changes() {
    let still = plan().input("outside_temperature", 20.0).input("water_temperature", 0.0).register("zone_mode", 1);
    let mut bench = still.start();
    assert_eq!(bench.get("state_output_1"), 1);
    bench.force("zone_temperature_target", 1500);
    assert_eq!(bench.get("state_output_1"), 0);
    bench.force("zone_temperature_actual", 3333);
    bench.wait_ms(10_000);
    assert_eq!(bench.get("zone_temperature_actual"), 3333);
    bench.input("room_temperature", 21.0);
    bench.wait_ms(1000);
    assert_eq!(bench.get("zone_temperature_actual"), 2100);
}

#[test]
fn vol_50_an_image_with_something_foreign_is_refused() {
    let mut bench = plan().start();
    let mut image = bench.saved("");
    image.device["colour"] = "red".into();
    let started = std::panic::catch_unwind(|| again(plan(), &image));
    assert!(started.is_err());
}
