//! The room behind the controller (VOL-49): one temperature that heating raises, cooling lowers and the outside draws
//! to itself. Steps of one second on the running clock, so it is the same at every rate and however often it is looked
//! at.

use super::map::*;
use super::thermostat::Outputs;
use crate::time::SECOND_US;
use crate::world::World;

/// What the outside draws, a share of the difference per hour.
const LOSS_PER_HOUR: f64 = 0.1;

/// What an open valve gives of the difference to its water per hour, without a fan.
const STILL_PER_HOUR: f64 = 0.05;

/// What the fan at 10 V adds to that.
const FAN_PER_HOUR: f64 = 0.45;

const STEPS_PER_HOUR: f64 = 3600.0;

/// When the room moves; its temperature is the world's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// When the next step is due, in running microseconds: whole seconds.
    pub next_us: i64,
    /// The temperature as the last step left it, to tell whether somebody has set it since.
    left: f64,
}

impl Room {
    /// A room that has not been looked at yet.
    pub fn new() -> Self {
        Self { next_us: 0, left: f64::NAN }
    }

    /// One second passes.
    pub fn step(&mut self, outputs: Outputs, world: &mut World) {
        let room = world.number(ROOM_TEMPERATURE);
        let exchange = STILL_PER_HOUR + FAN_PER_HOUR * f64::from(outputs.fan) / 1000.0;
        let mut per_hour = LOSS_PER_HOUR * (world.number(OUTSIDE_TEMPERATURE) - room);
        if outputs.heating {
            per_hour += exchange * (world.number(WATER_TEMPERATURE) - room).max(0.0);
        }
        if outputs.cooling {
            per_hour += exchange * (world.number(CHILLED_WATER_TEMPERATURE) - room).min(0.0);
        }
        self.left = room + per_hour / STEPS_PER_HOUR;
        self.next_us += SECOND_US;
        world.set_number(ROOM_TEMPERATURE, self.left);
    }

    /// The device wakes at `now_us`: meanwhile the room went on with both valves shut, unless somebody set its
    /// temperature, which then holds now.
    pub fn wake(&mut self, now_us: i64, world: &mut World) {
        let is_untouched = world.number(ROOM_TEMPERATURE) == self.left;
        while is_untouched && self.next_us <= now_us {
            self.step(Outputs::default(), world);
        }
        self.left = world.number(ROOM_TEMPERATURE);
        self.next_us = (now_us.div_euclid(SECOND_US) + 1) * SECOND_US;
    }
}
