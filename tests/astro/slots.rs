//! The program store and its handshake against a plain list.

use proptest::prelude::*;

use crate::bench::Plan;

type Record = [u16; 6];

#[derive(Clone, Debug)]
enum Step {
    Order(u16),
    Record(Record),
    Process(u16),
    DeleteAll,
    AcknowledgeUpdate,
}

fn record() -> impl Strategy<Value = Record> {
    // One in a few is no program.
    let settings = prop_oneof![6 => 0..16u16, 1 => 16..=255u16];
    (settings, 0..24u16, 0..60u16, 0..60u16, -720..=720i16, 0..128u16)
        .prop_map(|(a, b, c, d, e, f)| [a, b, c, d, e as u16, f])
}

fn step(capacity: u16) -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1..=capacity).prop_map(Step::Order),
        3 => record().prop_map(Step::Record),
        12 => (0..=8u16).prop_map(Step::Process),
        6 => Just(Step::Process(4)),
        1 => Just(Step::DeleteAll),
        1 => Just(Step::AcknowledgeUpdate),
    ]
}

/// What the manual tells, word for word.
struct Model {
    slots: Vec<Option<Record>>,
    order: u16,
    record: Record,
    start: u16,
    configuration: u16,
    processed: u16,
    update: u16,
}

impl Model {
    fn new(capacity: usize) -> Self {
        let mut slots = vec![None; capacity];
        slots[..4].copy_from_slice(&[13u16, 7, 9, 0].map(|settings| Some([settings, 0, 0, 0, 0, 127])));
        Self { slots, order: 1, record: [0; 6], start: 0, configuration: 0, processed: 0, update: 0 }
    }

    fn process(&mut self, configuration: u16) {
        let slot = usize::from(self.order) - 1;
        let is_program = self.record[0] <= 15;
        let free = self.slots.iter().position(Option::is_none);
        let done = match configuration {
            1 if is_program && self.slots[slot].is_some() => {
                self.slots[slot] = Some(self.record);
                Some(slot)
            }
            2 if self.slots[slot].is_some() => {
                self.slots[slot] = None;
                Some(slot)
            }
            4 if is_program => free.inspect(|free| self.slots[*free] = Some(self.record)),
            8 => {
                self.record = self.slots[slot].unwrap_or([255, 0, 0, 0, 0, 0]);
                Some(slot)
            }
            _ => None,
        };
        self.configuration = configuration;
        match done {
            Some(slot) => {
                (self.start, self.processed) = (2, slot as u16 + 1);
                if configuration != 8 {
                    self.update = 1;
                }
            }
            None => {
                self.start = 6;
                self.configuration = configuration * 0x11;
            }
        }
    }

    fn block(&self) -> Vec<u16> {
        let count = self.slots.iter().flatten().count() as u16;
        let mut block = vec![self.slots.len() as u16, count, self.update, self.order];
        block.extend([self.start, self.configuration, self.processed]);
        block.extend(self.record);
        block.push(0);
        block
    }
}

fn check(model: &str, capacity: usize, steps: &[Step]) -> Result<(), TestCaseError> {
    let mut bench = Plan::of(model, 1).start();
    let mut list = Model::new(capacity);
    for step in steps {
        match step {
            Step::Order(order) => {
                prop_assert_eq!(bench.write(1, 0x83, *order), 0);
                list.order = *order;
            }
            Step::Record(record) => {
                prop_assert_eq!(bench.write_many(1, 0x87, record), 0);
                list.record = *record;
            }
            Step::Process(configuration) => {
                prop_assert_eq!(bench.write(1, 0x85, *configuration), 0);
                prop_assert_eq!(bench.write(1, 0x84, 1), 0);
                prop_assert_eq!(bench.read(1, 3, 0x84, 1).unwrap(), [0]);
                prop_assert_eq!(bench.write(1, 0x85, 1), 4);
                bench.wait_ms(50);
                list.process(*configuration);
            }
            Step::DeleteAll => {
                prop_assert_eq!(bench.write(1, 0x8D, 0x55AA), 0);
                list.slots.fill(None);
                list.update = 1;
            }
            Step::AcknowledgeUpdate => {
                prop_assert_eq!(bench.write(1, 0x82, 0), 0);
                list.update = 0;
            }
        }
        prop_assert_eq!(bench.read(1, 3, 0x80, 14).unwrap(), list.block(), "after {:?}", step);
        prop_assert_eq!(bench.read(1, 3, 0x74, 2).unwrap(), list.block()[..2].to_vec());
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn astro_61_to_69_the_store_is_a_list(steps in prop::collection::vec(step(24), 1..120)) {
        check("kael-astro-01", 24, &steps)?;
    }

    #[test]
    fn astro_61_to_69_the_large_store_is_a_longer_list(steps in prop::collection::vec(step(100), 1..60)) {
        check("kael-astro-03", 100, &steps)?;
    }
}

#[test]
fn astro_64_all_full_is_an_error_on_both_models() {
    for (model, capacity) in [("kael-astro-01", 24), ("kael-astro-03", 100)] {
        let mut steps = vec![Step::Record([12, 1, 2, 3, 0, 127])];
        steps.extend(vec![Step::Process(4); capacity - 3]);
        steps.extend([Step::Order(capacity as u16), Step::Process(8), Step::Process(2), Step::Process(4)]);
        check(model, capacity, &steps).unwrap();
    }
}
