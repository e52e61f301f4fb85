//! The two relays: locks, manual modes and positions (ASTRO-50 … ASTRO-53). Knows the registers of a relay; what programs
//! and holidays want of it comes from outside.

use super::holidays;
use super::map::{SIDES, Side};
use crate::image::Image;

/// Manual mode that stays.
const PERMANENT: u16 = 1;
/// Manual mode that the next event ends.
const TEMPORARY: u16 = 2;

/// The bit of a manual selection that is the position.
const POSITION: u16 = 1;

fn mode(regs: &Image, side: &Side) -> u16 {
    regs.get(side.manual_select) >> 1
}

/// Which relays are locked.
pub fn locks(regs: &Image) -> [bool; 2] {
    SIDES.map(|side| regs.get(side.lock) == 1)
}

/// Shows the manual modes that are selected.
pub fn show_modes(regs: &mut Image) {
    for side in &SIDES {
        regs.set(side.manual_mode, mode(regs, side));
    }
}

/// Of the manual modes only the permanent one survives a restart (ASTRO-82).
pub fn power_on(regs: &mut Image) {
    for side in &SIDES {
        if mode(regs, side) != PERMANENT {
            regs.set(side.manual_select, 0);
        }
    }
    show_modes(regs);
}

/// Programs of these relays fire: a temporary mode ends, but under a lock or in a holiday (ASTRO-51).
pub fn end_temporary(regs: &mut Image, fires: [bool; 2]) {
    for (side, fires) in SIDES.iter().zip(fires) {
        let is_free = regs.get(side.lock) == 0 && regs.get(side.holiday) != holidays::ON;
        if fires && is_free && mode(regs, side) == TEMPORARY {
            regs.set(side.manual_select, 0);
            regs.set(side.manual_mode, 0);
        }
    }
}

/// Puts a relay where manual mode, its holiday or else its programs want it.
pub fn place(regs: &mut Image, side: &Side, programs_want_on: bool) {
    let position = match mode(regs, side) {
        0 => u16::from(programs_want_on && regs.get(side.holiday) != holidays::ON),
        _ => regs.get(side.manual_select) & POSITION,
    };
    regs.set(side.relay, position);
}

/// A relay that is locked at power-up is off (ASTRO-53).
pub fn drop_locked(regs: &mut Image) {
    for (side, is_locked) in SIDES.iter().zip(locks(regs)) {
        if is_locked {
            regs.set(side.relay, 0);
        }
    }
}
