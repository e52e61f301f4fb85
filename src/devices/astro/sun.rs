//! Sunrise and sunset at a place (ASTRO-33, ASTRO-34). Knows standard time only, no seasons and no programs.

use chrono::{NaiveDate, NaiveDateTime, TimeDelta};
use solar_positioning::{Horizon, Location, SolarEvents, delta_t};

use super::map::{
    DISTRICT, LATITUDE_DEGREES, LATITUDE_HEMISPHERE, LATITUDE_MINUTES, LONGITUDE_DEGREES, LONGITUDE_HEMISPHERE,
    LONGITUDE_MINUTES, UTC_OFFSET_MINUTES,
};
use super::places;
use crate::image::{Image, Txn};
use crate::map::Point;

/// Elevation of the sun's centre when its upper limb touches the horizon, with standard refraction, in degrees.
const HORIZON: Horizon = Horizon::Custom(-0.833);

/// Istanbul's and the country's winter time (ASTRO-30).
const DISTRICT_UTC_OFFSET_MINUTES: i16 = 120;

const NORTH: u16 = 1;
const WEST: u16 = 1;

const MINUTES_A_DAY: f64 = 1440.0;

/// The registers of a place but its offset to UTC.
const COORDINATES: [Point<u16>; 6] = [
    LATITUDE_HEMISPHERE,
    LATITUDE_DEGREES,
    LATITUDE_MINUTES,
    LONGITUDE_HEMISPHERE,
    LONGITUDE_DEGREES,
    LONGITUDE_MINUTES,
];

/// District and coordinates follow each other, as if the registers were written one by one (ASTRO-30, ASTRO-31).
pub fn stage(txn: &mut Txn) {
    if let Some(district) = txn.sent(DISTRICT).and_then(places::district) {
        let (latitude, longitude) = (district.latitude, district.longitude);
        let values = [NORTH, latitude.0, latitude.1, 0, longitude.0, longitude.1];
        for (point, value) in COORDINATES.into_iter().zip(values) {
            if !txn.touches(point) {
                txn.set(point, value);
            }
        }
        if !txn.touches(UTC_OFFSET_MINUTES) {
            txn.set(UTC_OFFSET_MINUTES, DISTRICT_UTC_OFFSET_MINUTES);
        }
    }
    if COORDINATES.iter().any(|point| txn.touches(*point)) || txn.touches(UTC_OFFSET_MINUTES) {
        txn.set(DISTRICT, 0);
    }
}

/// A place on earth and its offset to UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Minutes of arc, positive north.
    latitude: i32,
    /// Minutes of arc, positive east.
    longitude: i32,
    /// Minutes that standard time is ahead of UTC.
    utc_offset: i32,
}

/// When the sun rises and sets on a date, in whole minutes of standard time from the start of that date, rounded down.
/// May lie outside the date where a place keeps an offset to UTC that is not its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sun {
    /// Sunrise; `None` where there is none.
    pub rise: Option<i32>,
    /// Sunset; `None` where there is none.
    pub set: Option<i32>,
}

impl Place {
    /// The place in the registers.
    pub fn read(regs: &Image) -> Self {
        let [north, latitude, latitude_minutes, west, longitude, longitude_minutes] =
            COORDINATES.map(|point| i32::from(regs.get(point)));
        let sign = |is_positive: bool| if is_positive { 1 } else { -1 };
        Self {
            latitude: sign(north == i32::from(NORTH)) * (latitude * 60 + latitude_minutes),
            longitude: sign(west != i32::from(WEST)) * (longitude * 60 + longitude_minutes),
            utc_offset: i32::from(regs.get(UTC_OFFSET_MINUTES)),
        }
    }

    /// Sunrise and sunset on a date: those nearest its solar noon.
    pub fn sun(self, date: NaiveDate) -> Sun {
        let Ok(delta_t) = delta_t::estimate_from_date_like(&date) else { return Sun::default() };
        let longitude = f64::from(self.longitude) / 60.0;
        let location = Location { latitude: f64::from(self.latitude) / 60.0, longitude };
        let midnight = julian_midnight(date) - f64::from(self.utc_offset) / MINUTES_A_DAY;
        // Four minutes a degree; taken into the date, so that every date has one noon.
        let mean_noon = (MINUTES_A_DAY / 2.0 - 4.0 * longitude + f64::from(self.utc_offset)).rem_euclid(MINUTES_A_DAY);
        let mean_noon = midnight + mean_noon / MINUTES_A_DAY;
        let events = SolarEvents::new();
        // The true noon is never half an hour from the mean one.
        let hour = 1.0 / 24.0;
        let Ok(Some(noon)) = events.next_transit_from_julian(mean_noon - hour, mean_noon + hour, longitude, delta_t)
        else {
            return Sun::default();
        };
        let Ok(day) = events.for_interval_from_julian(noon - 0.5, noon + 0.5, location, delta_t, HORIZON) else {
            return Sun::default();
        };
        let nearest = |times: &[f64]| {
            let nearest = times.iter().copied().min_by(|a, b| (a - noon).abs().total_cmp(&(b - noon).abs()));
            nearest.map(|time| ((time - midnight) * MINUTES_A_DAY).floor() as i32)
        };
        Sun { rise: nearest(&day.rises), set: nearest(&day.sets) }
    }
}

/// Julian date of a date's start.
fn julian_midnight(date: NaiveDate) -> f64 {
    let year_2000 = NaiveDate::from_ymd_opt(2000, 1, 1).unwrap_or_default();
    2_451_544.5 + (date - year_2000).num_days() as f64
}

/// The moment of standard time that is `minutes` after the start of a date.
pub fn standard(date: NaiveDate, minutes: i32) -> NaiveDateTime {
    date.and_time(chrono::NaiveTime::MIN) + TimeDelta::minutes(i64::from(minutes))
}
