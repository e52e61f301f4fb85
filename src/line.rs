//! Unit number, speed and character format: what a line has, and which registers of a model hold them (BUS-13, BUS-14).

use std::fmt;

use crate::image::Image;
use crate::map::Point;

/// Parity of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parity {
    /// No parity bit.
    None,
    /// Even parity.
    Even,
    /// Odd parity.
    Odd,
}

impl Parity {
    /// The letter between data bits and stop bits, as in 8N2.
    pub const fn letter(self) -> char {
        match self {
            Parity::None => 'N',
            Parity::Even => 'E',
            Parity::Odd => 'O',
        }
    }
}

impl fmt::Display for Parity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Parity::None => "none",
            Parity::Even => "even",
            Parity::Odd => "odd",
        })
    }
}

/// Speed and character format of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Line {
    /// Bits a second.
    pub baud: u32,
    /// Parity.
    pub parity: Parity,
    /// Stop bits, 1 or 2.
    pub stop_bits: u8,
}

impl Line {
    /// Bits that a character takes on the wire: 11 with parity or two stop bits, else 10 (BUS-17).
    pub fn character_bits(&self) -> u64 {
        if self.parity != Parity::None || self.stop_bits == 2 { 11 } else { 10 }
    }

    /// Microseconds that `halves` half characters take: silences are counted in them (3.5 characters are 7).
    pub fn half_characters_us(&self, halves: u64) -> u64 {
        (halves * self.character_bits() * 500_000).div_ceil(u64::from(self.baud.max(1)))
    }
}

impl fmt::Display for Line {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} 8{}{}", self.baud, self.parity.letter(), self.stop_bits)
    }
}

/// A device's line settings and unit number, as they hold now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// Unit number; 0 is reached by broadcasts only.
    pub unit: u8,
    /// Speed and character format.
    pub line: Line,
}

/// A character format on offer: parity, stop bits, and the registers and numbers that stand for it.
pub type CharacterFormat = (Parity, u8, &'static [(Point<u16>, u16)]);

/// The line registers of a model: which hold the settings, and by which numbers.
#[derive(Debug)]
pub struct LineOffer {
    /// The register of the unit number.
    pub unit: Point<u16>,
    /// The units that devices.toml may give.
    pub units: (u8, u8),
    /// The register of the speed.
    pub baud: Point<u16>,
    /// Speeds, and the number that stands for each.
    pub bauds: &'static [(u32, u16)],
    /// Character formats, and the registers and numbers that stand for each. Where several formats have the same parity
    /// and stop bits, the first is the one that devices.toml sets.
    pub formats: &'static [CharacterFormat],
    /// What the device sends where its registers stand for nothing on offer: its factory line.
    pub factory: Line,
}

impl LineOffer {
    /// The address that the registers stand for.
    pub fn read(&self, regs: &Image) -> Address {
        let baud = self.bauds.iter().find(|(_, number)| regs.get(self.baud) == *number);
        let format =
            self.formats.iter().find(|format| format.2.iter().all(|(point, number)| regs.get(*point) == *number));
        Address {
            unit: regs.get(self.unit) as u8,
            line: Line {
                baud: baud.map_or(self.factory.baud, |(baud, _)| *baud),
                parity: format.map_or(self.factory.parity, |format| format.0),
                stop_bits: format.map_or(self.factory.stop_bits, |format| format.1),
            },
        }
    }

    /// Puts a bus' settings into the registers; what is not on offer is left alone.
    pub fn lay(&self, address: Address, regs: &mut Image) {
        regs.set(self.unit, u16::from(address.unit));
        if let Some((_, number)) = self.bauds.iter().find(|(baud, _)| *baud == address.line.baud) {
            regs.set(self.baud, *number);
        }
        for (point, number) in self.format(address.line).map_or(&[][..], |format| format.2) {
            regs.set(*point, *number);
        }
    }

    /// What of a line's settings is not on offer, in words; empty where all of it is.
    pub fn missing(&self, line: Line) -> Vec<String> {
        let mut missing = Vec::new();
        if !self.bauds.iter().any(|(baud, _)| *baud == line.baud) {
            let offered: Vec<String> = self.bauds.iter().map(|(baud, _)| baud.to_string()).collect();
            missing.push(format!("baud {} (it offers {})", line.baud, offered.join(", ")));
        }
        if self.format(line).is_none() {
            let mut offered: Vec<String> = Vec::new();
            for (parity, stop_bits, _) in self.formats {
                let text = format!("{parity} with {stop_bits}");
                if !offered.contains(&text) {
                    offered.push(text);
                }
            }
            let (parity, stop_bits) = (line.parity, line.stop_bits);
            missing.push(format!("parity {parity} with {stop_bits} stop bits (it offers {})", offered.join(", ")));
        }
        missing
    }

    fn format(&self, line: Line) -> Option<&CharacterFormat> {
        self.formats.iter().find(|format| (format.0, format.1) == (line.parity, line.stop_bits))
    }
}
