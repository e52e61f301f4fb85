//! What EEPROM and battery keep over a restart of the program (ASTRO-82, BUS-22).

use crate::bench::{Bench, Plan, time};
use crate::{add_programs, clock};
use serde_json::json;
use standin::station::Saved;

const START: &str = "2014-10-27T14:22:08";

/// Where the return to factory settings is asked for (ASTRO-81).
const FACTORY_RESET: u16 = 0x0091;

/// The program starts anew, by default with the same start.
fn again(saved: &Saved, start: &str) -> Bench {
    Plan::of("kael-astro-01", 1).clock(start, 1.0).start_with(&[Some(saved.clone())])
}

#[test]
fn astro_82_bus_22_the_clock_keeps_its_difference_to_the_simulation() {
    let mut bench = Plan::of("kael-astro-01", 1).clock(START, 1.0).start();
    bench.wait_ms(5000);
    assert_eq!(bench.write_many(1, 0x10, &[20, 2, 29, 23, 0, 0]), 0);
    bench.wait_ms(60_000);
    let saved = bench.saved("");
    // Set five seconds after the start: five seconds before that it would have shown 22:59:55.
    assert_eq!(clock(&mut again(&saved, START)).0, time("2020-02-29T22:59:55"));
    assert_eq!(clock(&mut again(&saved, "2014-10-28T14:22:08")).0, time("2020-03-01T22:59:55"));
}

#[test]
fn astro_82_bus_22_a_shift_of_the_season_is_kept_once_it_has_been() {
    let mut bench = Plan::of("kael-astro-01", 1).clock("2014-03-30T02:00:00", 1.0).start();
    bench.advance_s(2.0 * 3600.0);
    assert_eq!(clock(&mut bench).0, time("2014-03-30T05:00:00"));
    let saved = bench.saved("");
    // The same start again: the shift is still to come, and comes once.
    let mut same = again(&saved, "2014-03-30T02:00:00");
    assert_eq!(clock(&mut same).0, time("2014-03-30T02:00:00"));
    same.advance_s(2.0 * 3600.0);
    assert_eq!(clock(&mut same).0, time("2014-03-30T05:00:00"));
    // A later start: the clock has run on.
    let mut later = again(&saved, "2014-03-30T10:00:00");
    assert_eq!(clock(&mut later).0, time("2014-03-30T11:00:00"));
    assert_eq!(later.get("season"), 1);
}

#[test]
fn astro_82_what_eeprom_keeps() {
    let mut bench = Plan::of("kael-astro-01", 1).clock(START, 1.0).start();
    let writes: [(u16, &[u16]); 8] = [
        (0x06, &[0x1234, 0x5678]),
        (0x21, &[0, 33, 52, 0, 151, 12, 600]),
        (0x31, &[10, 1, 7, 2, 0, 4, 1, 7, 3, 0]),
        (0x40, &[1, 14, 10, 27, 14, 10, 28, 1, 14, 11, 1, 14, 11, 2]),
        (0x53, &[3, 5]),
        (0x50, &[1, 0, 1]),
        (0x62, &[1, 3]),
        (0xA0, &[0]),
    ];
    for (addr, words) in writes {
        assert_eq!(bench.write_many(1, addr, words), 0, "{addr:04X}");
    }
    add_programs(&mut bench, &[[12, 15, 22, 16, -3, 3]]);
    let mut later = again(&bench.saved(""), START);
    for (name, wanted) in [
        ("user_device_number_h", 0x1234),
        ("user_device_number_l", 0x5678),
        ("district", 0),
        ("latitude_hemisphere", 0),
        ("longitude_degrees", 151),
        ("utc_offset_minutes", 600),
        ("dst_mode", 2),
        ("summer_month", 10),
        ("winter_minute", 0),
        ("season", 1),
        ("holiday_a_status", 2),
        ("holiday_b_status", 1),
        ("holiday_b_end_day", 2),
        ("language", 1),
        ("lock_a", 0),
        ("lock_b", 1),
        ("manual_select_a", 3),
        ("manual_mode_a", 1),
        ("relay_a", 1),
        // Temporary manual mode is not kept, and a relay that is locked at power-up is off.
        ("manual_select_b", 0),
        ("manual_mode_b", 0),
        ("relay_b", 0),
        ("modbus_unit", 1),
        ("modbus_parity", 1),
        ("modbus_stop_bits", 3),
        ("infrared_enable", 0),
        ("program_count", 5),
        // Volatile registers start anew.
        ("program_update", 0),
        ("process_start", 0),
        ("process_configuration", 0),
        ("processed_order", 0),
        ("record_settings", 0),
        ("record_offset_minutes", 0),
    ] {
        assert_eq!(later.get(name), wanted, "{name}");
    }
    assert_eq!(later.write_many(1, 0x83, &[5, 1, 8]), 0);
    later.wait_ms(50);
    assert_eq!(later.read(1, 3, 0x86, 7).unwrap(), [5, 12, 15, 22, 16, -3i16 as u16, 3]);
}

#[test]
fn astro_69_programs_are_told_of_once_though_the_program_ends_before_the_device_has_restarted() {
    let mut bench = Plan::of("kael-astro-01", 1).clock(START, 1.0).start();
    assert_eq!(bench.write(1, FACTORY_RESET, 0x55AA), 0);
    let mut later = again(&bench.saved(""), START);
    assert_eq!(later.get("program_update"), 1);
    let mut last = again(&later.saved(""), START);
    assert_eq!(last.get("program_update"), 0);
}

#[test]
fn astro_42_82_what_a_holiday_has_undone_stays_undone() {
    // Relay A comes on at sunset, 17:06, but for the holiday.
    let mut bench = Plan::of("kael-astro-01", 1).clock("2014-10-27T16:00:00", 1.0).start();
    assert_eq!(bench.write_many(1, 0x40, &[1, 14, 10, 27, 14, 10, 27]), 0);
    bench.advance_s(2.0 * 3600.0);
    assert_eq!(bench.write(1, 0x40, 0), 0);
    assert_eq!(bench.get("relay_a"), 0);
    let saved = bench.saved("");
    assert_eq!(again(&saved, "2014-10-27T20:00:00").get("relay_a"), 0);
    assert_eq!(again(&saved, "2014-10-28T20:00:00").get("relay_a"), 1);
}

#[test]
fn astro_82_an_image_that_makes_no_sense_is_refused() {
    let saved = Plan::of("kael-astro-01", 1).clock(START, 1.0).start().saved("");
    let refused = |change: &dyn Fn(&mut Saved)| {
        let mut spoilt = saved.clone();
        change(&mut spoilt);
        std::panic::catch_unwind(move || again(&spoilt, START)).is_err()
    };
    assert!(!refused(&|_| {}));
    assert!(refused(&|saved| saved.device["programs"][0]["settings"] = json!(16)));
    assert!(refused(&|saved| saved.device["programs"][0]["hour"] = json!(24)));
    assert!(refused(&|saved| saved.device["programs"] = json!([null, null])));
    assert!(refused(&|saved| saved.device["clock"]["difference_us"] = json!("soon")));
    assert!(refused(&|saved| saved.device["clock"]["more"] = json!(1)));
    assert!(refused(&|saved| saved.device = json!(null)));
    assert!(refused(&|saved| {
        saved.registers.insert("district".into(), 136);
    }));
    assert!(refused(&|saved| {
        saved.registers.insert("rtc_year".into(), 14);
    }));
}

#[test]
fn bus_22_start_values_set_the_clock_and_programs_as_any_write_would() {
    let plan = Plan::of("kael-astro-01", 1).clock(START, 1.0);
    let mut bench = plan.register("rtc_year", 16).register("rtc_month", 2).register("rtc_day", 29).start();
    assert_eq!(clock(&mut bench), (time("2016-02-29T14:22:08"), 1));
}
