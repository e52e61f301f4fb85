//! Sunrise and sunset against tables that other programs have worked out.

use crate::bench::{Bench, Plan};
use crate::set_clock;
use standin::devices::astro::places::{self, DISTRICTS};

/// Seconds of the day, `None` for none.
fn seconds(text: &str) -> Option<i32> {
    (text != "none").then(|| {
        let parts: Vec<i32> = text.split(':').map(|part| part.parse().unwrap()).collect();
        parts[0] * 3600 + parts[1] * 60 + parts[2]
    })
}

fn rows(csv: &str) -> impl Iterator<Item = Vec<&str>> {
    csv.lines().skip(1).map(|line| line.split(',').collect())
}

fn bench() -> Bench {
    Plan::of("kael-astro-01", 1).register("dst_mode", 0).register("delete_all_programs", 0x55AA).start()
}

/// Minutes of the day that the registers show, `None` where they read 255.
fn shown(bench: &mut Bench) -> [Option<i32>; 2] {
    let words = bench.read(1, 3, 0x70, 4).unwrap();
    [0, 2].map(|at| (words[at] != 255).then(|| i32::from(words[at]) * 60 + i32::from(words[at + 1])))
}

/// Whether a shown minute is the wanted second's, rounded down, if that may be wrong by `slack` seconds.
fn agrees(shown: Option<i32>, wanted: Option<i32>, slack: i32) -> bool {
    match (shown, wanted) {
        (Some(minute), Some(second)) => {
            (-slack..=slack).any(|error| (second + error).rem_euclid(86_400) / 60 == minute)
        }
        (shown, wanted) => shown.is_none() && wanted.is_none(),
    }
}

#[test]
fn astro_33_the_reference_is_met_to_the_minute_it_lies_in() {
    let mut bench = bench();
    let mut count = 0;
    for row in rows(include_str!("data/sun_reference.csv")) {
        assert_eq!(bench.write(1, 0x20, row[0].parse().unwrap()), 0);
        set_clock(&mut bench, format!("{}T12:00:00", row[3]).parse().unwrap());
        let [rise, set] = shown(&mut bench);
        // The reference is within 0.5 s of others and the crate within 1.5 s of it.
        assert!(agrees(rise, seconds(row[4]), 2), "{row:?}: sunrise {rise:?}");
        assert!(agrees(set, seconds(row[5]), 2), "{row:?}: sunset {set:?}");
        count += 1;
    }
    assert_eq!(count, 24);
}

#[test]
fn astro_33_34_every_district_every_offset_and_places_all_over_the_world() {
    let mut bench = bench();
    let (mut without, mut count) = (0, 0);
    for row in rows(include_str!("data/sun_elsewhere.csv")) {
        let [latitude, longitude, offset] = [0, 1, 2].map(|at| row[at].parse::<i32>().unwrap());
        let arc = |minutes: i32| [minutes.unsigned_abs() as u16 / 60, minutes.unsigned_abs() as u16 % 60];
        let ([north, north_minutes], [east, east_minutes]) = (arc(latitude), arc(longitude));
        let (is_north, is_west) = (u16::from(latitude >= 0), u16::from(longitude < 0));
        let words = [is_north, north, north_minutes, is_west, east, east_minutes, offset as u16];
        assert_eq!(bench.write_many(1, 0x21, &words), 0, "{row:?}");
        set_clock(&mut bench, format!("{}T12:00:00", row[3]).parse().unwrap());
        // The sun grazes the horizon beyond the polar circles: a hair's breadth is long there.
        let slack = if latitude.abs() < 65 * 60 { 3 } else { 60 };
        let [rise, set] = shown(&mut bench);
        assert!(agrees(rise, seconds(row[4]), slack), "{row:?}: sunrise {rise:?}");
        assert!(agrees(set, seconds(row[5]), slack), "{row:?}: sunset {set:?}");
        without += u32::from(rise.is_none());
        count += 1;
    }
    assert_eq!(count, 444);
    assert!(without >= 20, "the table has polar days and nights");
}

#[test]
fn astro_30_every_district_has_the_coordinates_of_the_table() {
    let mut bench = bench();
    let table: Vec<_> = rows(include_str!("data/locations.csv")).collect();
    assert_eq!(table.len(), 135);
    for row in table {
        let number: u16 = row[0].parse().unwrap();
        let district = places::district(number).unwrap();
        assert_eq!((district.province, district.name), (row[1], row[2]));
        assert_eq!(bench.write(1, 0x20, number), 0);
        let [a, b, c, d] = [3, 4, 5, 6].map(|at| row[at].parse::<u16>().unwrap());
        assert_eq!(bench.read(1, 3, 0x20, 8).unwrap(), [number, 1, a, b, 0, c, d, 120]);
    }
    assert_eq!(DISTRICTS.len(), 135);
    assert_eq!((places::district(0), places::district(136)), (None, None));
}
