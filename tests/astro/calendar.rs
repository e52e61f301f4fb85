//! The clock against chrono, and against a model that counts every second.

use chrono::{Datelike, NaiveDate, NaiveDateTime, TimeDelta};
use proptest::prelude::*;

use crate::bench::{Bench, Plan, time};
use crate::{clock, set_clock};

fn without_seasons(start: &str, rate: f64) -> Bench {
    Plan::of("kael-astro-01", 1).clock(start, rate).register("dst_mode", 0).start()
}

#[test]
fn astro_10_every_minute_around_every_midnight_of_leap_and_common_years() {
    for year in [2000, 2015, 2016, 2099] {
        let mut bench = without_seasons(&format!("{year}-01-01T00:00:00"), 1.0);
        let days = if year % 4 == 0 { 366 } else { 365 };
        for day in 0..days {
            let midnight = time(&format!("{year}-01-01T00:00:00")) + TimeDelta::days(day);
            for minute in -2..=2 {
                let Some(wanted) = Some(midnight + TimeDelta::minutes(minute)).filter(|time| time.year() == year)
                else {
                    continue;
                };
                let now = bench.bus.moment(bench.now).civil;
                bench.advance_s((wanted - now).num_seconds() as f64);
                assert_eq!(clock(&mut bench), (wanted, wanted.weekday().number_from_monday()));
            }
        }
    }
}

#[test]
fn astro_11_every_day_of_the_century_can_be_set_and_no_other() {
    let mut bench = without_seasons("2014-10-27T14:22:08", 0.0);
    for year in [0, 1, 4, 50, 96, 97, 98, 99] {
        for month in 1..=12 {
            for day in 1..=31 {
                let date = NaiveDate::from_ymd_opt(2000 + year, month, day);
                let code = bench.write_many(1, 0x10, &[year as u16, month as u16, day as u16]);
                assert_eq!(code, if date.is_some() { 0 } else { 3 }, "{year} {month} {day}");
                let Some(date) = date else { continue };
                let (shown, weekday) = clock(&mut bench);
                assert_eq!((shown.date(), weekday), (date, date.weekday().number_from_monday()));
            }
        }
    }
}

/// A clock that is looked at once a second, and a calendar that is counted out day by day.
pub struct Model {
    pub local: NaiveDateTime,
    is_summer: bool,
    /// Seconds of an hour that is shown for the second time.
    pub repeat_left: i64,
    /// Month, week, weekday, hour, minute.
    rules: Option<[[u32; 5]; 2]>,
    /// Summer and winter instants of the years around one.
    instants: [Vec<NaiveDateTime>; 2],
    instants_of: Option<i32>,
}

fn instant(year: i32, [month, week, weekday, hour, minute]: [u32; 5]) -> NaiveDateTime {
    let days = (1..=31).filter_map(|day| NaiveDate::from_ymd_opt(year, month, day));
    let such: Vec<_> = days.filter(|date| date.weekday().number_from_monday() == weekday).collect();
    let date = if week == 5 { *such.last().unwrap() } else { such[week as usize - 1] };
    date.and_hms_opt(hour, minute, 0).unwrap()
}

impl Model {
    pub fn new(local: NaiveDateTime, rules: Option<[[u32; 5]; 2]>) -> Self {
        let instants = Default::default();
        let mut model = Self { local, is_summer: false, repeat_left: 0, rules, instants, instants_of: None };
        model.judge();
        model
    }

    fn rule(&mut self, rules: Option<[[u32; 5]; 2]>) {
        self.rules = rules;
        self.instants_of = None;
        self.judge();
    }

    fn look_up(&mut self) {
        let year = self.local.year();
        if self.instants_of != Some(year) {
            self.instants_of = Some(year);
            self.instants = [0, 1].map(|side| {
                let rules = self.rules.map(|rules| rules[side]);
                rules.map_or(Vec::new(), |rule| (-1..=1).map(|by| instant(year + by, rule)).collect())
            });
        }
    }

    pub fn set(&mut self, local: NaiveDateTime) {
        self.local = local;
        self.repeat_left = 0;
        self.judge();
    }

    fn judge(&mut self) {
        self.look_up();
        let [summers, winters] = &self.instants;
        let last = |instants: &[NaiveDateTime]| instants.iter().copied().filter(|at| *at <= self.local).max();
        let repeats = |at: &NaiveDateTime| *at - TimeDelta::hours(1) <= self.local && self.local < *at;
        let goes_back_here = winters.iter().any(repeats);
        self.is_summer = match (last(summers), last(winters)) {
            (Some(_), Some(_)) if self.repeat_left > 0 && goes_back_here => false,
            (Some(summer), Some(winter)) => summer > winter,
            _ => false,
        };
    }

    pub fn tick(&mut self) {
        self.local += TimeDelta::seconds(1);
        self.repeat_left = (self.repeat_left - 1).max(0);
        self.look_up();
        if !self.is_summer && self.instants[0].contains(&self.local) {
            self.local += TimeDelta::hours(1);
            self.is_summer = true;
        } else if self.is_summer && self.instants[1].contains(&self.local) {
            self.local -= TimeDelta::hours(1);
            self.is_summer = false;
            self.repeat_left = 3600;
        }
    }

    fn assert_is(&self, bench: &mut Bench) {
        assert_eq!(clock(bench), (self.local, self.local.weekday().number_from_monday()));
        assert_eq!(bench.get("season") == 1, self.is_summer, "season at {}", self.local);
    }
}

#[derive(Clone, Debug)]
enum Step {
    Pass(i64),
    SetAround(usize, i64),
    Rules([u32; 10]),
    Mode(u16),
    PowerCut(i64),
}

/// Months of both halves of the year, so that neither summer nor winter is shorter than a month.
fn rules() -> impl Strategy<Value = [u32; 10]> {
    let half = |months: std::ops::RangeInclusive<u32>| (months, 1..=5u32, 1..=7u32, 0..=23u32, 0..=59u32);
    (half(2..=5), half(8..=11), any::<bool>()).prop_map(|(one, other, is_southern)| {
        let (one, other) = ([one.0, one.1, one.2, one.3, one.4], [other.0, other.1, other.2, other.3, other.4]);
        let (summer, winter) = if is_southern { (other, one) } else { (one, other) };
        let mut all = [0; 10];
        all[..5].copy_from_slice(&summer);
        all[5..].copy_from_slice(&winter);
        all
    })
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1..9000i64).prop_map(Step::Pass),
        3 => (0..2usize, -5000..5000i64).prop_map(|(side, by)| Step::SetAround(side, by)),
        1 => rules().prop_map(Step::Rules),
        1 => (0..=2u16).prop_map(Step::Mode),
        1 => (1..9000i64).prop_map(Step::PowerCut),
    ]
}

pub const AUTOMATIC: [[u32; 5]; 2] = [[3, 5, 7, 3, 0], [10, 5, 7, 4, 0]];

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn astro_20_23_the_clock_does_what_a_clock_does_that_is_looked_at_every_second(
        first in rules(), year in 2001..2098i32, steps in prop::collection::vec(step(), 1..12)
    ) {
        let mut bench = Plan::of("kael-astro-01", 1).clock("2014-07-01T12:00:00", 1.0).start();
        let halves = |all: [u32; 10]| [[0; 5], [5; 5]].map(|at| {
            std::array::from_fn(|index| all[at[0] as usize + index])
        });
        let mut model = Model::new(time("2014-07-01T12:00:00"), Some(AUTOMATIC));
        let mut stored = AUTOMATIC;
        let around = std::iter::once(Step::Rules(first)).chain(steps);
        for step in around {
            match step {
                Step::Pass(seconds) => {
                    bench.advance_s(seconds as f64);
                    (0..seconds).for_each(|_| model.tick());
                }
                Step::SetAround(side, by) => {
                    let to = instant(year, stored[side]) + TimeDelta::seconds(by);
                    set_clock(&mut bench, to);
                    model.set(to);
                }
                Step::Rules(all) => {
                    prop_assert_eq!(bench.write_many(1, 0x31, &all.map(|word| word as u16)), 0);
                    stored = halves(all);
                    model.rule(Some(stored));
                }
                Step::Mode(mode) => {
                    prop_assert_eq!(bench.write(1, 0x30, mode), 0);
                    if mode == 1 {
                        stored = AUTOMATIC;
                    }
                    model.rule((mode != 0).then_some(stored));
                }
                Step::PowerCut(seconds) => {
                    bench.power("", false);
                    bench.advance_s(seconds as f64);
                    bench.power("", true);
                    model.local += TimeDelta::seconds(seconds);
                    model.repeat_left = (model.repeat_left - seconds).max(0);
                    model.judge();
                }
            }
            model.assert_is(&mut bench);
        }
    }

    #[test]
    fn astro_10_how_often_it_is_asked_changes_nothing(
        start in 0..365i64, rate in 0.0..86_400.0f64, steps in prop::collection::vec(1..400_000u64, 1..40)
    ) {
        let start = (time("2014-01-01T02:30:00") + TimeDelta::days(start)).to_string().replace(' ', "T");
        let mut often = Plan::of("kael-astro-01", 1).clock(&start, rate).start();
        let mut once = Plan::of("kael-astro-01", 1).clock(&start, rate).start();
        for us in &steps {
            often.wait_us(*us);
            often.get("rtc_second");
        }
        once.wait_us(steps.iter().sum());
        prop_assert_eq!(often.bus.stations()[0].regs(), once.bus.stations()[0].regs());
    }
}
