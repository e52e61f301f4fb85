//! The vocabulary of register tables: one line of a manual's table is one [`Row`] of plain data, and [`Point`] is its
//! typed handle. Knows no device, no bus and no memory.

mod value;

use std::marker::PhantomData;

pub use self::value::{Format, TenThousands, UnsignedWholeAndDecimals, Value, WholeAndDecimals};

/// The four kinds of Modbus data, each with addresses of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Bank {
    /// Bits that may be written (functions 01, 05, 15).
    Coil,
    /// Bits that are only read (function 02).
    Discrete,
    /// 16-bit registers that are only read (function 04).
    Input,
    /// 16-bit registers that may be written (functions 03, 06, 16).
    Holding,
}

impl Bank {
    /// All banks in the order in which maps are printed.
    pub const ALL: [Bank; 4] = [Bank::Coil, Bank::Discrete, Bank::Input, Bank::Holding];

    /// The bank's name as the exports and the control interface print it.
    pub const fn name(self) -> &'static str {
        match self {
            Bank::Coil => "coil",
            Bank::Discrete => "discrete",
            Bank::Input => "input",
            Bank::Holding => "holding",
        }
    }

    /// Whether the bank holds single bits.
    pub const fn is_bits(self) -> bool {
        matches!(self, Bank::Coil | Bank::Discrete)
    }
}

/// What the bus may do with a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read only.
    Read,
    /// Read and write.
    ReadWrite,
    /// A write acts and is not stored; a read gives 0.
    Command,
}

/// Whether a row survives a restart of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Starts anew at every restart.
    Ram,
    /// Kept in EEPROM.
    Eeprom,
    /// Kept in EEPROM, by what the device itself saves: the row only shows it.
    Device,
}

/// One line of a register table, or a group of `count` such lines `stride` addresses apart.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The constant's name; [`Row::name_of`] gives the register's.
    pub ident: &'static str,
    /// What it means, in a sentence.
    pub about: &'static str,
    /// The kind of data.
    pub bank: Bank,
    /// Address on the wire of the first member's first word.
    pub addr: u16,
    /// Addresses from one member to the next.
    pub stride: u16,
    /// How many members; 1 for a single row.
    pub count: u16,
    /// How its words make up the number.
    pub format: Format,
    /// Unit of measure; empty where it has none.
    pub unit: &'static str,
    /// Decimal digits: the number times 10^-scale is the value in `unit`.
    pub scale: u8,
    /// Smallest number that a write may carry.
    pub min: i64,
    /// Largest number that a write may carry.
    pub max: i64,
    /// A write must carry a multiple of this.
    pub step: i64,
    /// Where not empty: the only numbers that a write may carry.
    pub one_of: &'static [i64],
    /// Factory value.
    pub default: i64,
    /// Where not empty: the factory value of each member, the last one serving the rest.
    pub defaults: &'static [i64],
    /// What the bus may do with it.
    pub access: Access,
    /// Whether it survives a restart.
    pub keep: Keep,
    /// The clause that it comes from.
    pub cite: &'static str,
}

const fn row(access: Access) -> Row {
    Row {
        ident: "",
        about: "",
        bank: Bank::Holding,
        addr: 0,
        stride: 0,
        count: 1,
        format: Format::U16,
        unit: "",
        scale: 0,
        min: i64::MIN,
        max: i64::MAX,
        step: 1,
        one_of: &[],
        default: 0,
        defaults: &[],
        access,
        keep: Keep::Ram,
        cite: "",
    }
}

/// A row that is only read.
pub const fn ro() -> Row {
    row(Access::Read)
}

/// A row that is read and written.
pub const fn rw() -> Row {
    row(Access::ReadWrite)
}

/// A row whose write is a command: it acts, is not stored and reads 0.
pub const fn command() -> Row {
    row(Access::Command)
}

impl Row {
    /// Writes must lie within these numbers.
    pub const fn within(mut self, min: i64, max: i64) -> Self {
        self.min = min;
        self.max = max;
        self
    }

    /// Writes must carry one of these numbers.
    pub const fn one_of(mut self, numbers: &'static [i64]) -> Self {
        self.one_of = numbers;
        self
    }

    /// Writes must carry a multiple of `step`.
    pub const fn step(mut self, step: i64) -> Self {
        self.step = step;
        self
    }

    /// The factory value.
    pub const fn default(mut self, number: i64) -> Self {
        self.default = number;
        self
    }

    /// The factory values of a group's members; the last one serves the rest.
    pub const fn defaults(mut self, numbers: &'static [i64]) -> Self {
        self.defaults = numbers;
        self
    }

    /// The unit of measure.
    pub const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// Decimal digits of the number.
    pub const fn scale(mut self, digits: u8) -> Self {
        self.scale = digits;
        self
    }

    /// Kept in EEPROM.
    pub const fn eeprom(mut self) -> Self {
        self.keep = Keep::Eeprom;
        self
    }

    /// Kept in EEPROM by what the device itself saves, for numbers whose digits an option changes or that a row cuts.
    pub const fn kept_by_device(mut self) -> Self {
        self.keep = Keep::Device;
        self
    }

    /// The clause that the row comes from.
    pub const fn cite(mut self, clause: &'static str) -> Self {
        self.cite = clause;
        self
    }

    /// Used by [`registers!`](crate::registers): puts the row where its block and offset say.
    pub const fn place(
        mut self,
        block: Block,
        offset: u16,
        format: Format,
        ident: &'static str,
        about: &'static str,
    ) -> Self {
        self.bank = block.bank;
        self.addr = block.addr + offset;
        self.stride = block.stride;
        self.count = block.count;
        self.format = format;
        self.ident = ident;
        self.about = about;
        self
    }

    /// The register's name in lower case; of a group's member `index` (0 first) with its number in place of `n`.
    pub fn name_of(&self, index: u16) -> String {
        let name = self.ident.to_lowercase();
        if self.count == 1 {
            return name;
        }
        let number = (index + 1).to_string();
        let parts: Vec<&str> = name.split('_').map(|part| if part == "n" { number.as_str() } else { part }).collect();
        parts.join("_")
    }

    /// Address of member `index` (0 first).
    pub const fn addr_of(&self, index: u16) -> u16 {
        self.addr + index * self.stride
    }

    /// Factory value of member `index` (0 first).
    pub const fn default_of(&self, index: u16) -> i64 {
        if self.defaults.is_empty() {
            return self.default;
        }
        let last = self.defaults.len() - 1;
        self.defaults[if (index as usize) < last { index as usize } else { last }]
    }

    /// Words that one member takes.
    pub const fn words(&self) -> u16 {
        self.format.words()
    }

    /// The numbers that a write may carry, as far as the row alone says.
    pub const fn limits(&self) -> (i64, i64) {
        let (least, most) = match self.format {
            Format::Bit => (0, 1),
            Format::U16 => (0, u16::MAX as i64),
            Format::S16 => (i16::MIN as i64, i16::MAX as i64),
            Format::U32 => (0, u32::MAX as i64),
            Format::S32 => (i32::MIN as i64, i32::MAX as i64),
            Format::WholeAndDecimals => (-32_768_000, 32_767_999),
            Format::UnsignedWholeAndDecimals => (0, 65_535_999),
            Format::TenThousands => (0, 655_359_999),
        };
        (if self.min < least { least } else { self.min }, if self.max > most { most } else { self.max })
    }

    /// Whether a write may carry `number`, as far as the row alone says.
    pub const fn admits(&self, number: i64) -> bool {
        if !self.one_of.is_empty() {
            let mut index = 0;
            while index < self.one_of.len() {
                if self.one_of[index] == number {
                    return true;
                }
                index += 1;
            }
            return false;
        }
        let (min, max) = self.limits();
        min <= number && number <= max && number % self.step == 0
    }

    /// What a write may carry, in words.
    pub fn allowed(&self) -> String {
        if !self.one_of.is_empty() {
            let numbers: Vec<String> = self.one_of.iter().map(i64::to_string).collect();
            return format!("one of {}", numbers.join(", "));
        }
        let (min, max) = self.limits();
        match (min == max, self.step) {
            (true, _) => format!("{min} only"),
            (false, 1) => format!("{min} to {max}"),
            (false, step) => format!("{min} to {max} in steps of {step}"),
        }
    }
}

/// Where a run of rows starts, and how often it is repeated.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    bank: Bank,
    addr: u16,
    stride: u16,
    count: u16,
}

impl Block {
    /// `count` members, `stride` addresses apart.
    pub const fn repeat(mut self, count: u16, stride: u16) -> Self {
        self.count = count;
        self.stride = stride;
        self
    }
}

const fn block(bank: Bank, addr: u16) -> Block {
    Block { bank, addr, stride: 0, count: 1 }
}

/// A run of coils from `addr`.
pub const fn coil(addr: u16) -> Block {
    block(Bank::Coil, addr)
}

/// A run of discrete inputs from `addr`.
pub const fn discrete(addr: u16) -> Block {
    block(Bank::Discrete, addr)
}

/// A run of input registers from `addr`.
pub const fn input(addr: u16) -> Block {
    block(Bank::Input, addr)
}

/// A run of holding registers from `addr`.
pub const fn holding(addr: u16) -> Block {
    block(Bank::Holding, addr)
}

/// The typed handle of a row: what behaviour reads and writes.
#[derive(Debug)]
pub struct Point<T> {
    bank: Bank,
    addr: u16,
    stride: u16,
    count: u16,
    value: PhantomData<fn() -> T>,
}

impl<T> Clone for Point<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Point<T> {}

impl<T: Value> Point<T> {
    /// Used by [`registers!`](crate::registers).
    pub const fn new(block: Block, offset: u16) -> Self {
        Self {
            bank: block.bank,
            addr: block.addr + offset,
            stride: block.stride,
            count: block.count,
            value: PhantomData,
        }
    }

    /// Member `index` of a group, 0 first.
    ///
    /// # Panics
    /// When the group has no such member: a broken invariant of the caller.
    pub const fn nth(self, index: usize) -> Self {
        assert!(index < self.count as usize, "a group's member number is beyond its count");
        Self { addr: self.addr + self.stride * index as u16, count: 1, ..self }
    }

    /// How many members its group has.
    pub const fn count(self) -> usize {
        self.count as usize
    }

    /// Its kind of data.
    pub const fn bank(self) -> Bank {
        self.bank
    }

    /// Its first word's address.
    pub const fn addr(self) -> u16 {
        self.addr
    }
}

/// Checks a table at compile time: addresses ascend without overlap, a group's members stay clear of each other,
/// factory values lie within their ranges, and every row names the clause that it comes from.
///
/// Groups of one block interleave; their rows ascend within the stride.
pub const fn check(table: &[Row]) {
    let mut index = 0;
    while index < table.len() {
        let row = &table[index];
        assert!(!row.cite.is_empty(), "a row names no clause");
        assert!(!row.about.is_empty(), "a row says nothing about itself");
        assert!(matches!(row.format, Format::Bit) == row.bank.is_bits(), "bits live in coils and discrete inputs");
        assert!(row.count == 1 || row.stride >= row.words(), "a group's members overlap");
        let mut member = 0;
        while member < row.count {
            assert!(
                matches!(row.access, Access::Command) || row.admits(row.default_of(member)),
                "a factory value is out of its row's range"
            );
            member += 1;
        }
        if index > 0 {
            let last = &table[index - 1];
            assert!(last.addr + last.words() <= row.addr, "rows overlap or do not ascend");
            assert!(last.stride == row.stride && last.count == row.count, "the rows of a block repeat alike");
            let first = &table[0];
            assert!(
                first.count == 1 || row.addr + row.words() <= first.addr + first.stride,
                "a group's member reaches into the next"
            );
        }
        index += 1;
    }
}

/// Declares a run of rows: a typed [`Point`] each and the table of all. The doc comment becomes `about`.
#[macro_export]
macro_rules! registers {
    ($TABLE:ident at $block:expr; $( $(#[doc = $about:literal])+ + $offset:literal $NAME:ident : $Type:ty = $row:expr; )+) => {
        $( $(#[doc = $about])+ pub const $NAME: $crate::map::Point<$Type> = $crate::map::Point::new($block, $offset); )+
        #[doc = concat!("The rows of `", stringify!($TABLE), "`, ascending.")]
        pub const $TABLE: &[$crate::map::Row] = &[
            $( $row.place($block, $offset, <$Type as $crate::map::Value>::FORMAT, stringify!($NAME), concat!($($about),+)), )+
        ];
        const _: () = $crate::map::check($TABLE);
    };
}
