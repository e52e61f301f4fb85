//! HMI-VOLCANO EC: room controller of a fan heater. A thermostat with a weekly schedule measures a room, opens the
//! valves of heating and cooling and drives the fan.

mod clock;
pub mod map;
mod room;
mod rules;
mod schedule;
mod sensor;
mod thermostat;
mod units;

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use self::clock::{Clock, WeekTime};
use self::map::*;
use self::room::Room;
use self::schedule::program_state;
use self::sensor::Sensor;
use self::thermostat::{Outputs, Thermostat};
use self::units::{Memory, Unit};
use crate::device::{Cx, Device, Kind, Profile};
use crate::image::{Change, Image, Txn};
use crate::line::Address;
use crate::map::{Keep, Point};
use crate::options::Options;
use crate::time::{Moment, civil_plus_us};
use crate::wire::function;
use crate::world::World;

/// The model.
pub static KIND: Kind = Kind {
    name: "hmi-volcano-ec",
    title: "room controller of a fan heater",
    manual: "HMI-VOLCANO EC: Instrukcja integracji urządzenia na magistrali Modbus RTU",
    map: MAP,
    rules: rules::RULES,
    inputs: INPUTS,
    options: OPTIONS,
    profile: Profile::new(
        &[
            function::READ_COILS,
            function::READ_DISCRETE_INPUTS,
            function::READ_HOLDING_REGISTERS,
            function::READ_INPUT_REGISTERS,
            function::WRITE_SINGLE_COIL,
            function::WRITE_SINGLE_REGISTER,
            function::WRITE_MULTIPLE_COILS,
            function::WRITE_MULTIPLE_REGISTERS,
        ],
        OFFER,
    ),
    build: |options| Box::new(Volcano::new(options)),
};

/// A controller at work.
#[derive(Clone, Debug)]
struct Volcano {
    has_volatile_setpoints: bool,
    /// Unit and line as they were at the last start: written ones hold after the restart (VOL-3).
    address: Option<Address>,
    clock: Clock,
    memory: Memory,
    sensor: Sensor,
    thermostat: Thermostat,
    room: Room,
    /// The quarter of an hour that the schedule goes by: its periods start and stop at quarters.
    quarter: WeekTime,
    /// When the next quarter begins, in running microseconds.
    next_quarter_us: i64,
    status: Status,
}

/// What the controller shows of itself. It goes to the registers when it changes, so that what somebody forced there
/// stays until then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Status {
    /// The measured temperature; `None` while the sensor in use is broken.
    reading: Option<i16>,
    program_state: u16,
    outputs: Outputs,
}

impl Status {
    fn show(&self, regs: &mut Image) {
        regs.set(ZONE_TEMPERATURE_ACTUAL, self.reading.unwrap_or(BROKEN_SENSOR));
        regs.set(ZONE_ACTUAL_PROGRAM_STATE, self.program_state);
        regs.set(STATE_OUTPUT_1, self.outputs.heating);
        regs.set(STATE_OUTPUT_2, self.outputs.cooling);
        regs.set(FAN_ACTUAL_POWER_VOLT, self.outputs.fan);
    }
}

/// What the register shows while the sensor in use is broken (VOL-40).
const BROKEN_SENSOR: i16 = i16::MIN;

/// What EEPROM and the clock's battery keep beside registers.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    clock: Clock,
    memory: Memory,
}

impl Volcano {
    fn new(options: &Options) -> Self {
        Self {
            has_volatile_setpoints: options.flag(VOLATILE_SETPOINTS.name),
            address: None,
            clock: Clock::default(),
            memory: Memory::default(),
            sensor: Sensor::new(),
            thermostat: Thermostat::default(),
            room: Room::new(),
            quarter: WeekTime::default(),
            next_quarter_us: 0,
            status: Status::default(),
        }
    }

    /// Looks at the clock for the schedule, and finds out when to look again.
    fn look_at_clock(&mut self, at_us: i64, now: Moment) {
        self.quarter = self.clock.week_time(civil_plus_us(now.civil, at_us - now.running_us));
        self.next_quarter_us = at_us + self.quarter.quarter_ends_in_us;
    }

    /// What follows from what is measured and set now.
    fn judge(&mut self, world: &World, regs: &Image) -> Status {
        let reading = self.sensor.reading(world, regs);
        let program_state = program_state(regs, self.quarter);
        Status { reading, program_state, outputs: self.thermostat.judge(reading, program_state, regs) }
    }

    /// Drives outputs and registers by what is measured and set now. Doing it twice is doing it once.
    fn control(&mut self, cx: &mut Cx) {
        let status = self.judge(cx.world, cx.regs);
        if status != self.status {
            self.status = status;
            status.show(cx.regs);
        }
    }

    /// Puts everything that the manual's table 27 names to its factory value: all that EEPROM keeps (VOL-47).
    fn go_to_default(&mut self, cx: &mut Cx) {
        for row in MAP.iter().copied().flatten().filter(|row| row.keep == Keep::Eeprom) {
            cx.regs.set_word(row.bank, row.addr, row.default as u16);
        }
        self.memory = Memory::default();
        cx.effects.save = true;
        cx.effects.restart = true;
    }
}

/// What the table says that a register leaves the factory with.
fn factory_value(point: Point<u16>) -> u16 {
    let row = ZONE.iter().find(|row| row.addr == point.addr());
    row.map_or(0, |row| row.default as u16)
}

/// The line registers, whose change restarts the device.
fn line_registers(regs: &Image) -> [u16; 3] {
    [BAUDRATE, PARITY_MODE, SLAVE_ADDR].map(|point| regs.get(point))
}

impl Device for Volcano {
    fn clone_box(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }

    fn power_on(&mut self, cx: &mut Cx) {
        self.address = Some(OFFER.read(cx.regs));
        if self.has_volatile_setpoints {
            let factory = |point| Unit::of(cx.regs).setting(factory_value(point));
            let (target, eco) = (factory(ZONE_TEMPERATURE_TARGET), factory(ZONE_TEMPERATURE_ECO));
            cx.regs.set(ZONE_TEMPERATURE_TARGET, rules::within_limits(cx.regs, target));
            cx.regs.set(ZONE_TEMPERATURE_ECO, eco);
        }
        let now_us = cx.now.running_us;
        self.room.wake(now_us, cx.world);
        self.sensor = Sensor::new();
        self.sensor.measure(cx.world);
        self.sensor.schedule(now_us, cx.regs);
        self.thermostat = Thermostat::default();
        self.look_at_clock(now_us, cx.now);
        self.status = self.judge(cx.world, cx.regs);
        self.status.show(cx.regs);
        sensor::show(cx.world, cx.regs);
        self.clock.show(cx.now.civil, cx.regs);
    }

    fn power_off(&mut self, cx: &mut Cx) {
        self.status.outputs = Outputs::default();
        self.status.show(cx.regs);
    }

    fn advance(&mut self, cx: &mut Cx) {
        // Registers may have been forced since the last call, which was at that very moment.
        self.control(cx);
        loop {
            let at_us = self.room.next_us.min(self.sensor.next_us).min(self.next_quarter_us);
            if at_us > cx.now.running_us {
                break;
            }
            if at_us == self.room.next_us {
                self.room.step(self.status.outputs, cx.world);
            }
            if at_us == self.sensor.next_us {
                self.sensor.measure(cx.world);
                self.sensor.schedule(at_us, cx.regs);
            }
            let is_quarter = at_us == self.next_quarter_us;
            if is_quarter {
                self.look_at_clock(at_us, cx.now);
            }
            if is_quarter || self.sensor.reading(cx.world, cx.regs) != self.status.reading {
                self.control(cx);
            }
        }
        self.clock.show(cx.now.civil, cx.regs);
    }

    fn clock_jumped(&mut self, _by_us: i64, cx: &mut Cx) {
        self.look_at_clock(cx.now.running_us, cx.now);
    }

    fn input_changed(&mut self, cx: &mut Cx) {
        sensor::show(cx.world, cx.regs);
        self.control(cx);
    }

    fn stage(&self, txn: &mut Txn) {
        self.memory.convert(txn);
        rules::shape(txn);
    }

    fn committed(&mut self, change: &Change, cx: &mut Cx) {
        cx.effects.restart |= line_registers(change.before) != line_registers(cx.regs);
        cx.effects.save |= self.memory.remember(change, cx.regs);
        cx.effects.save |= self.clock.take(change, cx.now.civil, cx.regs);
        if change.was(NTC_PERIOD) != cx.regs.get(NTC_PERIOD) {
            self.sensor.schedule(cx.now.running_us, cx.regs);
        }
        if change.sent(GO_TO_DEFAULT) == Some(true) {
            return self.go_to_default(cx);
        }
        self.look_at_clock(cx.now.running_us, cx.now);
        self.control(cx);
        self.clock.show(cx.now.civil, cx.regs);
    }

    fn address(&self, _regs: &Image) -> Option<Address> {
        self.address
    }

    fn factory_reset(&mut self, cx: &mut Cx) {
        self.go_to_default(cx);
    }

    fn save(&self, _world: &World, _now: Moment) -> Json {
        serde_json::to_value(Kept { clock: self.clock, memory: self.memory }).unwrap_or(Json::Null)
    }

    fn load(&mut self, saved: &Json, _world: &mut World) -> Result<(), String> {
        let kept = Kept::deserialize(saved).map_err(|error| error.to_string())?;
        (self.clock, self.memory) = (kept.clock, kept.memory);
        Ok(())
    }
}
