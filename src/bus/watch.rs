//! Sees what changes on the devices of a bus between two looks, for whoever follows it live.

use std::collections::VecDeque;

use super::{Event, Output};
use crate::image::Image;
use crate::station::Station;
use crate::time::Moment;

/// The devices as they were at the last look.
#[derive(Clone, Debug)]
pub(super) struct Watch {
    seen: Vec<Seen>,
}

#[derive(Clone, Debug)]
struct Seen {
    regs: Image,
    is_powered: bool,
    boots: u32,
}

impl Watch {
    pub(super) fn new(stations: &[Station]) -> Self {
        let seen = |station: &Station| Seen {
            regs: station.regs().clone(),
            is_powered: station.is_powered(),
            boots: station.boots(),
        };
        Self { seen: stations.iter().map(seen).collect() }
    }

    /// What is different since the last look.
    pub(super) fn look(&mut self, at: Moment, stations: &[Station], outputs: &mut VecDeque<Output>) {
        for (index, (station, seen)) in stations.iter().zip(&mut self.seen).enumerate() {
            if seen.is_powered != station.is_powered() {
                seen.is_powered = station.is_powered();
                outputs.push_back(Output::Event(Event::Power { at, station: index, is_powered: seen.is_powered }));
            }
            if seen.boots != station.boots() {
                seen.boots = station.boots();
                outputs.push_back(Output::Event(Event::Boot { at, station: index, boots: seen.boots }));
            }
            if seen.regs == *station.regs() {
                continue;
            }
            for member in station.layout().members() {
                if seen.regs.words(member) != station.regs().words(member) {
                    let scale = station.scale(member);
                    let before = member.row.format.decode(seen.regs.words(member), scale);
                    let after = station.raw(member);
                    outputs.push_back(Output::Event(Event::Change {
                        at,
                        station: index,
                        member,
                        scale,
                        before,
                        after,
                    }));
                }
            }
            seen.regs.copy_from(station.regs());
        }
    }
}
