//! The handshake by which programs are read and changed (ASTRO-61 … ASTRO-67). Knows the slots and its registers, no clock
//! but the delay that it is told.

use super::map::{
    DELETE_ALL_PROGRAMS, PROCESS_CONFIGURATION, PROCESS_START, PROCESSED_ORDER, PROGRAM_COUNT, PROGRAM_COUNT_AGAIN,
    PROGRAM_INPUT_ORDER, PROGRAM_UPDATE, RECORD_ACTIVE_DAYS, RECORD_HOUR, RECORD_MINUTE, RECORD_OFFSET_MINUTES,
    RECORD_SECOND, RECORD_SETTINGS,
};
use super::programs::{Failed, Program, Slots};
use crate::device::Refusal;
use crate::image::{Image, Txn};
use crate::wire::Exception;

const EDIT: u16 = 1;
const CLEAR: u16 = 2;
const NEW: u16 = 4;
const READ: u16 = 8;

/// The bits that select; those that tell of errors are as many bits higher.
const SELECTION: u16 = EDIT | CLEAR | NEW | READ;
const ERROR_SHIFT: u32 = 4;

const DONE: u16 = 2;
const DONE_WITH_ERROR: u16 = 6;

/// Refuses a write that a working process does not bear (ASTRO-67).
///
/// # Errors
/// Which register it is.
pub fn judge(txn: &Txn) -> Result<(), Refusal> {
    let busy = [
        PROGRAM_INPUT_ORDER,
        PROCESS_START,
        PROCESS_CONFIGURATION,
        RECORD_SETTINGS,
        RECORD_HOUR,
        RECORD_MINUTE,
        RECORD_SECOND,
        RECORD_ACTIVE_DAYS,
        DELETE_ALL_PROGRAMS,
    ];
    if busy.iter().any(|point| txn.touches(*point)) || txn.touches(RECORD_OFFSET_MINUTES) {
        let reason = "a process is working on the programs";
        return Err(Refusal::new(Exception::DeviceFailure, reason, "ASTRO-67"));
    }
    Ok(())
}

/// The process starts: errors that an earlier one left are forgotten (ASTRO-61, ASTRO-66).
pub fn start(regs: &mut Image) {
    regs.set(PROCESS_START, 0);
    regs.set(PROCESS_CONFIGURATION, regs.get(PROCESS_CONFIGURATION) & SELECTION);
}

/// The process ends; tells whether it has changed a program.
pub fn finish(regs: &mut Image, slots: &mut Slots) -> bool {
    let selected = regs.get(PROCESS_CONFIGURATION) & SELECTION;
    let order = regs.get(PROGRAM_INPUT_ORDER);
    let processed = match selected {
        EDIT => slots.edit(order, Program::read(regs)),
        CLEAR => slots.clear(order),
        NEW => slots.add(Program::read(regs)),
        READ => {
            Program::show(slots.get(order), regs);
            Ok(order)
        }
        // No operation, or several at once (ASTRO-66).
        _ => Err(Failed),
    };
    match processed {
        Ok(slot) => {
            regs.set(PROCESSED_ORDER, slot);
            regs.set(PROCESS_START, DONE);
            if selected != READ {
                announce(regs, slots);
            }
        }
        Err(Failed) => {
            regs.set(PROCESS_CONFIGURATION, selected | selected << ERROR_SHIFT);
            regs.set(PROCESS_START, DONE_WITH_ERROR);
        }
    }
    processed.is_ok() && selected != READ
}

/// Shows how many programs there are.
pub fn count(regs: &mut Image, slots: &Slots) {
    regs.set(PROGRAM_COUNT, slots.count());
    regs.set(PROGRAM_COUNT_AGAIN, slots.count());
}

/// Tells that programs have changed (ASTRO-69).
pub fn announce(regs: &mut Image, slots: &Slots) {
    regs.set(PROGRAM_UPDATE, 1);
    count(regs, slots);
}
