//! A device's register memory, the staged write that may change it, and the rules that judge such a write. Knows no
//! device and no bus.

use std::collections::HashMap;

use crate::map::{Bank, Point, Row, Value};

/// Where every address of a model lies: the index of its tables, made once and shared by all devices of the model.
#[derive(Debug)]
pub struct Layout {
    rows: Vec<&'static Row>,
    slots: [Vec<Option<Slot>>; 4],
    names: HashMap<String, Member>,
}

/// What an address holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    row: u16,
    member: u16,
    /// Which word of the member, 0 first.
    pub word: u16,
}

/// One register: a row, or one member of a group.
#[derive(Clone, Copy, Debug)]
pub struct Member {
    /// The line of the table.
    pub row: &'static Row,
    /// Which member of the group, 0 first.
    pub index: u16,
}

impl Member {
    /// Address of its first word.
    pub fn addr(&self) -> u16 {
        self.row.addr_of(self.index)
    }

    /// Its name.
    pub fn name(&self) -> String {
        self.row.name_of(self.index)
    }
}

impl Layout {
    /// The layout of a model's tables.
    ///
    /// # Panics
    /// When two tables share an address or a name: a broken invariant of the model, found by its first test.
    pub fn new(tables: &[&'static [Row]]) -> Self {
        let mut layout = Self { rows: Vec::new(), slots: Default::default(), names: HashMap::new() };
        for row in tables.iter().copied().flatten() {
            let number = layout.rows.len() as u16;
            layout.rows.push(row);
            for member in 0..row.count {
                let slots = &mut layout.slots[row.bank as usize];
                for word in 0..row.words() {
                    let addr = usize::from(row.addr_of(member) + word);
                    if slots.len() <= addr {
                        slots.resize(addr + 1, None);
                    }
                    assert!(slots[addr].is_none(), "{} {addr} stands in two rows", row.bank.name());
                    slots[addr] = Some(Slot { row: number, member, word });
                }
                let twin = layout.names.insert(row.name_of(member), Member { row, index: member });
                assert!(twin.is_none(), "two rows are called {}", row.name_of(member));
            }
        }
        layout
    }

    /// What an address holds; `None` where the map does not have it.
    pub fn slot(&self, bank: Bank, addr: u16) -> Option<Slot> {
        self.slots[bank as usize].get(usize::from(addr)).copied().flatten()
    }

    /// The register that an address belongs to.
    pub fn member(&self, bank: Bank, addr: u16) -> Option<Member> {
        self.slot(bank, addr).map(|slot| self.member_at(slot))
    }

    /// The register that a slot belongs to.
    pub fn member_at(&self, slot: Slot) -> Member {
        Member { row: self.rows[usize::from(slot.row)], index: slot.member }
    }

    /// The register of that name.
    pub fn named(&self, name: &str) -> Option<Member> {
        self.names.get(name).copied()
    }

    /// All registers, bank by bank with addresses ascending.
    pub fn members(&self) -> impl Iterator<Item = Member> + '_ {
        Bank::ALL.into_iter().flat_map(|bank| {
            let first_words = self.slots[bank as usize].iter().flatten().filter(|slot| slot.word == 0);
            first_words.map(|slot| self.member_at(*slot))
        })
    }

    /// Whether every address of a span is in the map.
    pub fn covers(&self, bank: Bank, start: u16, quantity: u16) -> bool {
        let first = usize::from(start);
        let span = self.slots[bank as usize].get(first..first + usize::from(quantity));
        span.is_some_and(|slots| slots.iter().all(Option::is_some))
    }
}

/// The words of a device, bank by bank; bits are words of 0 or 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image {
    words: [Vec<u16>; 4],
}

impl Image {
    /// An image of factory values.
    pub fn factory(layout: &Layout) -> Self {
        let mut image = Self::default();
        for bank in Bank::ALL {
            image.words[bank as usize] = vec![0; layout.slots[bank as usize].len()];
        }
        for member in layout.members() {
            image.set_raw(member, member.row.default_of(member.index));
        }
        image
    }

    /// Takes over all words of an image of the same layout without a new allocation.
    pub fn copy_from(&mut self, other: &Self) {
        for (mine, theirs) in self.words.iter_mut().zip(&other.words) {
            mine.clone_from(theirs);
        }
    }

    /// The value at a point.
    pub fn get<T: Value>(&self, point: Point<T>) -> T {
        let start = usize::from(point.addr());
        T::from_words(&self.words[point.bank() as usize][start..start + usize::from(T::FORMAT.words())])
    }

    /// Stores the value at a point.
    pub fn set<T: Value>(&mut self, point: Point<T>, value: T) {
        let start = usize::from(point.addr());
        value.to_words(&mut self.words[point.bank() as usize][start..start + usize::from(T::FORMAT.words())]);
    }

    /// The words of a span; empty where it leaves the image.
    pub fn span(&self, bank: Bank, start: u16, quantity: u16) -> &[u16] {
        let first = usize::from(start);
        self.words[bank as usize].get(first..first + usize::from(quantity)).unwrap_or(&[])
    }

    /// One word; 0 where the image has none.
    pub fn word(&self, bank: Bank, addr: u16) -> u16 {
        self.span(bank, addr, 1).first().copied().unwrap_or(0)
    }

    /// Stores one word; nothing where the image has none.
    pub fn set_word(&mut self, bank: Bank, addr: u16, word: u16) {
        if let Some(place) = self.words[bank as usize].get_mut(usize::from(addr)) {
            *place = word;
        }
    }

    /// The words of a register.
    pub fn words(&self, member: Member) -> &[u16] {
        self.span(member.row.bank, member.addr(), member.row.words())
    }

    /// The raw number of a register.
    pub fn raw(&self, member: Member) -> i64 {
        member.row.format.decode(self.words(member), member.row.scale)
    }

    /// Stores a raw number; `false`, and nothing done, where it does not fit the register's format.
    pub fn set_raw(&mut self, member: Member, raw: i64) -> bool {
        let Some(words) = member.row.format.encode(raw, member.row.scale) else { return false };
        for offset in 0..member.row.words() {
            self.set_word(member.row.bank, member.addr() + offset, words[usize::from(offset)]);
        }
        true
    }
}

/// One word of a write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    /// The kind of data: coil or holding register.
    pub bank: Bank,
    /// Address on the wire.
    pub addr: u16,
    /// The word as it was sent; 0 or 1 for a coil.
    pub word: u16,
}

/// Where a write comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A request on the bus.
    Bus,
    /// The start values of devices.toml.
    Start,
    /// The control interface, as from the front panel.
    Panel,
}

/// A write in the making: everything is judged on it before anything is stored (BUS-10).
#[derive(Debug)]
pub struct Txn<'a> {
    /// The registers before the write.
    pub before: &'a Image,
    /// The registers as they would be after it.
    pub after: &'a mut Image,
    /// What was sent, in the order of the addresses for a request of the bus.
    pub writes: &'a [Write],
    /// Where it comes from.
    pub origin: Origin,
}

impl Txn<'_> {
    /// The value after the write.
    pub fn get<T: Value>(&self, point: Point<T>) -> T {
        self.after.get(point)
    }

    /// The value before the write.
    pub fn was<T: Value>(&self, point: Point<T>) -> T {
        self.before.get(point)
    }

    /// Changes what the write would leave.
    pub fn set<T: Value>(&mut self, point: Point<T>, value: T) {
        self.after.set(point, value);
    }

    /// The one-word value that was sent to a point; `None` where the write does not carry it.
    pub fn sent<T: Value>(&self, point: Point<T>) -> Option<T> {
        sent(self.writes, point)
    }

    /// Whether the write carries the point.
    pub fn touches<T: Value>(&self, point: Point<T>) -> bool {
        touches(self.writes, point)
    }
}

/// An accepted write: what the registers were and what was sent. The registers as they are now are in the context.
#[derive(Clone, Copy, Debug)]
pub struct Change<'a> {
    /// The registers before the write.
    pub before: &'a Image,
    /// What was sent.
    pub writes: &'a [Write],
    /// Where it came from.
    pub origin: Origin,
}

impl Change<'_> {
    /// The value before the write.
    pub fn was<T: Value>(&self, point: Point<T>) -> T {
        self.before.get(point)
    }

    /// The one-word value that was sent to a point.
    pub fn sent<T: Value>(&self, point: Point<T>) -> Option<T> {
        sent(self.writes, point)
    }

    /// Whether the write carried the point.
    pub fn touches<T: Value>(&self, point: Point<T>) -> bool {
        touches(self.writes, point)
    }
}

fn sent<T: Value>(writes: &[Write], point: Point<T>) -> Option<T> {
    let write = writes.iter().rev().find(|write| write.bank == point.bank() && write.addr == point.addr())?;
    (T::FORMAT.words() == 1).then(|| T::from_words(&[write.word]))
}

fn touches<T: Value>(writes: &[Write], point: Point<T>) -> bool {
    let span = point.addr()..point.addr() + T::FORMAT.words();
    writes.iter().any(|write| write.bank == point.bank() && span.contains(&write.addr))
}

/// A rule that ties registers together, judged on what the registers would be after the whole write.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// What holds, in words that finish "refused, because …".
    pub says: &'static str,
    /// The clause that it comes from.
    pub cite: &'static str,
    /// Whether it holds for a write.
    pub holds: fn(&Txn) -> bool,
}
