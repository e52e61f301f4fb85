//! KAEL Astro RS485: astronomical time switch with two relays, with room for 24 or for 100 programs.
//!
//! What happens by time happens at *stops*: a midnight, a change of season, a program that fires, an event that lies too far
//! back to count. Between two stops only the clock's registers move, so a simulated year costs no more than its stops.

mod agenda;
mod clock;
mod dst;
mod holidays;
pub mod map;
pub mod places;
mod process;
mod programs;
mod relays;
mod rules;
mod sun;

use chrono::{Datelike, NaiveDate, NaiveDateTime, NaiveTime, TimeDelta, Timelike};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use crate::device::{Cx, Device, Kind, Profile, Refusal};
use crate::image::{Change, Image, Member, Origin, Txn};
use crate::line::{Line, LineOffer, Parity};
use crate::map::{Keep, Row};
use crate::options::{BOOT_MS, OptionRange, OptionRow, Options};
use crate::time::{Instant, Moment};
use crate::wire::Exception;
use crate::world::World;
use agenda::{Agenda, Basis};
use clock::{Clock, Setting};
use dst::{Rules, Seasons};
use holidays::Holiday;
use map::*;
use programs::{Program, Slots};
use sun::{Place, Sun};

/// The model with room for 24 programs.
pub const ASTRO_01: Kind = Kind {
    name: "kael-astro-01",
    title: "astronomical time switch with two relays and 24 programs",
    manual: "KAEL Astro RS485, Modbus RTU",
    map: MAP_01,
    rules: rules::RULES,
    inputs: map::world::INPUTS,
    options: OPTIONS,
    profile: Profile::new(&[3, 6, 16], LINE_OFFER),
    build: |options| Box::new(Astro::new(CAPACITY_01, options)),
};

/// The model with room for 100 programs.
pub const ASTRO_03: Kind = Kind {
    name: "kael-astro-03",
    title: "astronomical time switch with two relays and 100 programs",
    map: MAP_03,
    build: |options| Box::new(Astro::new(CAPACITY_03, options)),
    ..ASTRO_01
};

const OPTIONS: &[OptionRow] = &[PROCESS_MS, BOOT_MS];

const PROCESS_MS: OptionRow = OptionRow {
    name: "process_ms",
    about: "time that the device works on a program",
    range: OptionRange::Integer(0, 600_000, 50),
    cite: "ASTRO-61",
};

const LINE_OFFER: LineOffer = LineOffer {
    unit: MODBUS_UNIT,
    units: (1, 255),
    baud: MODBUS_BAUD,
    bauds: &[(2400, 0), (9600, 1), (19200, 2), (38400, 3), (57600, 4), (115_200, 5)],
    // Half a stop bit and one and a half are taken for one and for two: no line here has such.
    formats: &[
        (Parity::None, 1, &[(MODBUS_PARITY, 0), (MODBUS_STOP_BITS, 1)]),
        (Parity::None, 2, &[(MODBUS_PARITY, 0), (MODBUS_STOP_BITS, 3)]),
        (Parity::Odd, 1, &[(MODBUS_PARITY, 1), (MODBUS_STOP_BITS, 1)]),
        (Parity::Odd, 2, &[(MODBUS_PARITY, 1), (MODBUS_STOP_BITS, 3)]),
        (Parity::Even, 1, &[(MODBUS_PARITY, 2), (MODBUS_STOP_BITS, 1)]),
        (Parity::Even, 2, &[(MODBUS_PARITY, 2), (MODBUS_STOP_BITS, 3)]),
        (Parity::None, 1, &[(MODBUS_PARITY, 0), (MODBUS_STOP_BITS, 0)]),
        (Parity::None, 2, &[(MODBUS_PARITY, 0), (MODBUS_STOP_BITS, 2)]),
        (Parity::Odd, 1, &[(MODBUS_PARITY, 1), (MODBUS_STOP_BITS, 0)]),
        (Parity::Odd, 2, &[(MODBUS_PARITY, 1), (MODBUS_STOP_BITS, 2)]),
        (Parity::Even, 1, &[(MODBUS_PARITY, 2), (MODBUS_STOP_BITS, 0)]),
        (Parity::Even, 2, &[(MODBUS_PARITY, 2), (MODBUS_STOP_BITS, 2)]),
    ],
    factory: Line { baud: 115_200, parity: Parity::None, stop_bits: 1 },
};

/// What sunrise and sunset read where there is none (ASTRO-34).
const NONE: u16 = 255;

/// The device.
#[derive(Clone)]
struct Astro {
    clock: Clock,
    slots: Slots,
    holidays: [Holiday; 2],
    agenda: Agenda,
    /// From when on the events that hold the relays lie too far back.
    forgotten: [Option<NaiveDateTime>; 2],
    /// The simulation's clock at the next stop.
    next_stop: NaiveDateTime,
    process_ms: u64,
    /// When the process that works on the programs ends.
    process: Option<Instant>,
    /// It has returned to factory settings and not started since (ASTRO-69).
    is_fresh: bool,
    is_running: bool,
}

/// What EEPROM and battery keep beside registers (ASTRO-82).
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    clock: Setting,
    programs: Vec<Option<Program>>,
    holidays: [Holiday; 2],
    #[serde(default)]
    is_fresh: bool,
}

impl Astro {
    fn new(capacity: u16, options: &Options) -> Self {
        let basis = Basis { place: Place::default(), rules: Rules::default(), lived_skip: None };
        Self {
            clock: Clock::default(),
            slots: Slots::preset(capacity),
            holidays: Default::default(),
            agenda: Agenda::new(basis),
            forgotten: [None; 2],
            next_stop: NaiveDateTime::MAX,
            process_ms: options.integer("process_ms") as u64,
            process: None,
            is_fresh: false,
            is_running: false,
        }
    }

    /// Lives from stop to stop up to `civil`.
    fn live_to(&mut self, civil: NaiveDateTime, cx: &mut Cx) {
        while self.next_stop <= civil {
            self.stop(cx);
            self.settle(relays::locks(cx.regs), cx);
        }
        self.clock.run_to(civil);
        self.show_clock(cx.regs);
    }

    /// What happens at the next stop, but where it leaves the relays.
    fn stop(&mut self, cx: &mut Cx) {
        let before = self.clock.local();
        let at = before + (self.next_stop - self.clock.civil());
        self.clock.run_to(self.next_stop);
        let change = Rules::read(cx.regs).around(before.year()).next(before, self.clock.is_summer());
        if let Some(change) = change.filter(|change| change.at == at) {
            self.clock.change_season(change);
            cx.effects.save = true;
        }
        let local = self.clock.local();
        if local + TimeDelta::days(1) < before {
            for (holiday, side) in self.holidays.iter_mut().zip(&SIDES) {
                holiday.century_over(cx.regs, side, local);
            }
            cx.effects.save = true;
        }
        self.follow_holidays(cx);
        if self.clock.reached() == local {
            relays::end_temporary(cx.regs, self.agenda.fires(local, &self.slots));
        }
    }

    fn follow_holidays(&mut self, cx: &mut Cx) {
        let (date, reached) = (self.clock.local().date(), self.clock.reached());
        for (holiday, side) in self.holidays.iter_mut().zip(&SIDES) {
            cx.effects.save |= holiday.follow(cx.regs, side, date, reached);
        }
    }

    /// The clock was put where it is and nothing happened on the way.
    fn clock_put(&mut self, cx: &mut Cx) {
        let local = self.clock.local();
        for holiday in &mut self.holidays {
            holiday.clock_set(local);
        }
        self.follow_holidays(cx);
    }

    /// Goes on from where the simulation's clock stands, after a start or a jump.
    fn resume(&mut self, cx: &mut Cx) {
        let rules = Rules::read(cx.regs);
        cx.effects.save |= self.clock.resume(cx.now.civil, |local| rules.around(local.year()));
        self.clock_put(cx);
    }

    /// Puts relays that are not held where they belong, looks for the next stop and shows it all.
    fn settle(&mut self, held: [bool; 2], cx: &mut Cx) {
        let rules = Rules::read(cx.regs);
        let lived_skip = self.clock.lived_skip();
        self.agenda.rest_on(Basis { place: Place::read(cx.regs), rules, lived_skip });
        let (local, reached) = (self.clock.local(), self.clock.reached());
        for (index, side) in SIDES.iter().enumerate() {
            let holiday = &self.holidays[index];
            let event = self.agenda.last(index, reached, &self.slots, |at| holiday.spares(at));
            self.forgotten[index] = event.map(|event| event.forgotten_at());
            if !held[index] {
                relays::place(cx.regs, side, event.is_some_and(|event| event.is_on));
            }
        }
        let stop = self.next_stop_after(local, reached, &rules.around(local.year()));
        self.next_stop = self.clock.civil_at(stop);
        self.show_clock(cx.regs);
        cx.regs.set(SEASON, self.clock.is_summer().into());
        self.show_sun(local.date(), cx.regs);
    }

    fn next_stop_after(&mut self, local: NaiveDateTime, reached: NaiveDateTime, seasons: &Seasons) -> NaiveDateTime {
        let midnight = local.date().and_time(NaiveTime::MIN) + TimeDelta::days(1);
        let season = seasons.next(local, self.clock.is_summer()).map(|change| change.at);
        let program = self.agenda.next(local.date(), reached, &self.slots);
        let others = [season, program, self.forgotten[0], self.forgotten[1]];
        others.into_iter().flatten().fold(midnight, NaiveDateTime::min)
    }

    fn show_clock(&self, regs: &mut Image) {
        let local = self.clock.local();
        regs.set(RTC_YEAR, (local.year() - 2000) as u16);
        regs.set(RTC_MONTH, local.month() as u16);
        regs.set(RTC_DAY, local.day() as u16);
        regs.set(RTC_HOUR, local.hour() as u16);
        regs.set(RTC_MINUTE, local.minute() as u16);
        regs.set(RTC_SECOND, local.second() as u16);
        regs.set(RTC_WEEKDAY, local.weekday().number_from_monday() as u16);
    }

    fn show_sun(&mut self, date: NaiveDate, regs: &mut Image) {
        let Sun { rise, set } = self.agenda.sun(date);
        let part = |minutes: Option<i32>, of: fn(u16) -> u16| minutes.map_or(NONE, |minutes| of(minutes as u16));
        regs.set(SUNRISE_HOUR, part(rise, |minutes| minutes / 60));
        regs.set(SUNRISE_MINUTE, part(rise, |minutes| minutes % 60));
        regs.set(SUNSET_HOUR, part(set, |minutes| minutes / 60));
        regs.set(SUNSET_MINUTE, part(set, |minutes| minutes % 60));
    }

    fn show_world(&self, cx: &mut Cx) {
        cx.regs.set(CHARGING, cx.world.flag(map::world::CHARGING).into());
        cx.regs.set(INFRARED_TRANSFER, cx.world.flag(map::world::INFRARED_TRANSFER).into());
    }

    /// The clock takes what was written to its registers; the fraction of the second goes on unless the second was written
    /// (ASTRO-14).
    fn set_clock(&mut self, change: &Change, regs: &Image) {
        let [year, month, day, hour, minute, second] =
            [RTC_YEAR, RTC_MONTH, RTC_DAY, RTC_HOUR, RTC_MINUTE, RTC_SECOND].map(|point| u32::from(regs.get(point)));
        let nanosecond = if change.touches(RTC_SECOND) { 0 } else { self.clock.local().nanosecond() };
        let date = NaiveDate::from_ymd_opt(2000 + year as i32, month, day);
        let Some(local) = date.and_then(|date| date.and_hms_nano_opt(hour, minute, second, nanosecond)) else { return };
        self.clock.set(local, &Rules::read(regs).around(local.year()));
    }

    fn programs_changed(&mut self, cx: &mut Cx) {
        self.agenda.programs_changed();
        cx.effects.save = true;
    }
}

impl Device for Astro {
    fn clone_box(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }

    fn power_on(&mut self, cx: &mut Cx) {
        self.is_running = true;
        self.process = None;
        self.resume(cx);
        process::count(cx.regs, &self.slots);
        if std::mem::take(&mut self.is_fresh) {
            cx.regs.set(PROGRAM_UPDATE, 1);
            cx.effects.save = true;
        }
        relays::power_on(cx.regs);
        self.show_world(cx);
        self.settle(relays::locks(cx.regs), cx);
    }

    fn power_off(&mut self, _cx: &mut Cx) {
        self.is_running = false;
        self.process = None;
    }

    fn advance(&mut self, cx: &mut Cx) {
        self.live_to(cx.now.civil, cx);
        if self.process.is_some_and(|end| end <= cx.now.elapsed) {
            self.process = None;
            if process::finish(cx.regs, &mut self.slots) {
                self.programs_changed(cx);
                self.settle(relays::locks(cx.regs), cx);
            }
        }
    }

    fn deadline(&self) -> Option<Instant> {
        self.process
    }

    fn clock_jumped(&mut self, _by_us: i64, cx: &mut Cx) {
        if !self.is_running {
            return;
        }
        self.resume(cx);
        self.settle(relays::locks(cx.regs), cx);
    }

    fn input_changed(&mut self, cx: &mut Cx) {
        self.show_world(cx);
    }

    fn holds(&self, row: &Row, number: i64) -> bool {
        let own = [(DISTRICT, 0), (HOLIDAY_A_STATUS, 2), (HOLIDAY_B_STATUS, 2)];
        row.admits(number) || own.iter().any(|(point, own)| point.addr() == row.addr && *own == number)
    }

    fn stage(&self, txn: &mut Txn) {
        sun::stage(txn);
        dst::stage(txn);
    }

    fn judge(&self, txn: &Txn) -> Result<(), Refusal> {
        if let Some(side) = SIDES.iter().find(|side| txn.touches(side.manual_select) && txn.was(side.lock) == 1) {
            let name = if side.lock.addr() == LOCK_A.addr() { "A" } else { "B" };
            return Err(Refusal::new(Exception::DeviceFailure, format!("relay {name} is locked"), "ASTRO-53"));
        }
        if self.process.is_some() { process::judge(txn) } else { Ok(()) }
    }

    fn committed(&mut self, change: &Change, cx: &mut Cx) {
        if [RTC_YEAR, RTC_MONTH, RTC_DAY, RTC_HOUR, RTC_MINUTE, RTC_SECOND].iter().any(|point| change.touches(*point)) {
            self.set_clock(change, cx.regs);
            self.clock_put(cx);
            cx.effects.save = true;
        } else if dst::is_touched(|point| change.touches(point)) {
            self.clock.judge_season(&Rules::read(cx.regs).around(self.clock.local().year()));
        }
        let reached = self.clock.reached();
        for (holiday, side) in self.holidays.iter_mut().zip(&SIDES) {
            if holidays::is_touched(side, |point| change.touches(point)) {
                holiday.written(change.before, side, reached);
                cx.effects.save = true;
            }
        }
        self.follow_holidays(cx);
        if change.sent(DELETE_ALL_PROGRAMS).is_some() {
            self.slots.clear_all();
            process::announce(cx.regs, &self.slots);
            self.programs_changed(cx);
        }
        if change.sent(PROCESS_START).is_some() {
            process::start(cx.regs);
            self.process = Some(cx.now.elapsed.plus_ms(self.process_ms));
        }
        relays::show_modes(cx.regs);
        // A manual write moves a relay that the same write locks: it is judged by the lock as it was (ASTRO-53).
        let locks = relays::locks(cx.regs);
        let held = [0, 1].map(|side| locks[side] && !change.touches(SIDES[side].manual_select));
        self.settle(held, cx);
        if change.origin == Origin::Start {
            // Start values are what the device finds when it is powered up.
            relays::drop_locked(cx.regs);
        }
        if change.sent(FACTORY_RESET).is_some() {
            self.factory_reset(cx);
        } else if change.sent(REMOTE_RESET).is_some() {
            self.process = None;
            cx.effects.restart = true;
        }
    }

    fn factory_reset(&mut self, cx: &mut Cx) {
        let number = [USER_DEVICE_NUMBER_H.addr(), USER_DEVICE_NUMBER_L.addr()];
        let kept = MAP_01.iter().copied().flatten().filter(|row| row.keep == Keep::Eeprom);
        for row in kept.filter(|row| !number.contains(&row.addr)) {
            cx.regs.set_raw(Member { row, index: 0 }, row.default);
        }
        self.slots = Slots::preset(self.slots.capacity());
        self.agenda.programs_changed();
        self.holidays = Default::default();
        self.process = None;
        self.is_fresh = true;
        process::announce(cx.regs, &self.slots);
        cx.effects.save = true;
        cx.effects.restart = true;
    }

    fn save(&self, _world: &World, _now: Moment) -> Json {
        let kept = Kept {
            clock: self.clock.setting().clone(),
            programs: self.slots.all().to_vec(),
            holidays: self.holidays.clone(),
            is_fresh: self.is_fresh,
        };
        serde_json::to_value(kept).unwrap_or_default()
    }

    fn load(&mut self, saved: &Json, _world: &mut World) -> Result<(), String> {
        let kept = Kept::deserialize(saved).map_err(|error| error.to_string())?;
        let capacity = self.slots.capacity();
        self.slots = Slots::kept(kept.programs, capacity)
            .ok_or_else(|| format!("it does not keep {capacity} sound programs"))?;
        self.clock = Clock::kept(kept.clock);
        self.holidays = kept.holidays;
        self.is_fresh = kept.is_fresh;
        Ok(())
    }
}
