//! Where the weekly schedule stands (VOL-44).

use super::clock::WeekTime;
use super::map::*;
use crate::image::Image;

/// Saturday as the weekday register counts.
const SATURDAY: u16 = 5;

/// The number of `zone_actual_program_state` at a moment of the week.
pub fn program_state(regs: &Image, at: WeekTime) -> u16 {
    if regs.get(ZONE_PROGRAM) == 0 {
        return 0;
    }
    let kind_of_day = usize::from(at.weekday.saturating_sub(SATURDAY - 1));
    let [first, second] = PERIODS[kind_of_day.min(PERIODS.len() - 1)];
    let holds = |(start, stop): Period| (regs.get(start)..regs.get(stop)).contains(&at.minute);
    let is_between = (regs.get(first.1)..regs.get(second.0)).contains(&at.minute);
    match () {
        () if holds(first) => 1,
        () if holds(second) => 3,
        () if is_between => 2,
        () => 4,
    }
}

/// Whether the thermostat works in a state of the program.
pub fn is_working(program_state: u16) -> bool {
    matches!(program_state, 0 | 1 | 3)
}
