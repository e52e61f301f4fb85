//! The physical world that devices measure: inputs are declared like registers and set by name in engineering units
//! (BUS-21), never through Modbus.

use std::marker::PhantomData;

/// A quantity of the world that a device measures (BUS-21).
#[derive(Clone, Copy, Debug)]
pub struct Input {
    /// The constant's name.
    pub ident: &'static str,
    /// What it means.
    pub about: &'static str,
    /// Unit of measure; empty where it has none.
    pub unit: &'static str,
    /// What it may be.
    pub range: InputRange,
    /// The clause that it comes from.
    pub cite: &'static str,
}

/// What an input may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InputRange {
    /// True or false.
    Flag {
        /// Until something else is said.
        default: bool,
    },
    /// A number, both ends included.
    Number {
        /// Least.
        min: f64,
        /// Most.
        max: f64,
        /// Until something else is said.
        default: f64,
    },
}

impl Input {
    /// A true-or-false input.
    pub const fn flag(default: bool) -> Self {
        Self { ident: "", about: "", unit: "", range: InputRange::Flag { default }, cite: "" }
    }

    /// A number from `min` to `max`.
    pub const fn number(min: f64, max: f64, default: f64) -> Self {
        assert!(min <= default && default <= max, "an input's default is out of its range");
        Self { ident: "", about: "", unit: "", range: InputRange::Number { min, max, default }, cite: "" }
    }

    /// Its unit of measure.
    pub const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// The clause that it comes from.
    pub const fn cite(mut self, clause: &'static str) -> Self {
        self.cite = clause;
        self
    }

    /// Used by [`inputs!`](crate::inputs).
    pub const fn named(mut self, ident: &'static str, about: &'static str) -> Self {
        assert!(!self.cite.is_empty(), "an input names no clause");
        self.ident = ident;
        self.about = about;
        self
    }

    /// Its name in devices.toml.
    pub fn name(&self) -> String {
        self.ident.to_lowercase()
    }

    /// Whether it is true or false rather than a number.
    pub fn is_flag(&self) -> bool {
        matches!(self.range, InputRange::Flag { .. })
    }

    /// Its value until something else is said; flags are 0 and 1.
    pub fn default(&self) -> f64 {
        match self.range {
            InputRange::Flag { default } => f64::from(u8::from(default)),
            InputRange::Number { default, .. } => default,
        }
    }

    /// Whether it may have this value.
    pub fn admits(&self, value: f64) -> bool {
        match self.range {
            InputRange::Flag { .. } => value == 0.0 || value == 1.0,
            InputRange::Number { min, max, .. } => (min..=max).contains(&value),
        }
    }

    /// What it may be, in words.
    pub fn allowed(&self) -> String {
        match self.range {
            InputRange::Flag { .. } => "true or false".into(),
            InputRange::Number { min, max, .. } => format!("{min} to {max} {}", self.unit).trim_end().into(),
        }
    }
}

/// The typed handle of an input: `f64` or `bool`.
#[derive(Debug)]
pub struct InputPoint<T> {
    index: usize,
    value: PhantomData<fn() -> T>,
}

impl<T> Clone for InputPoint<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for InputPoint<T> {}

impl<T> InputPoint<T> {
    /// Used by [`inputs!`](crate::inputs).
    pub const fn new(index: usize) -> Self {
        Self { index, value: PhantomData }
    }

    /// Its number in the model's list of inputs.
    pub const fn index(self) -> usize {
        self.index
    }
}

/// Declares the inputs of a model: a typed [`InputPoint`] each, and the table `INPUTS` of all.
#[macro_export]
macro_rules! inputs {
    ($( $(#[doc = $about:literal])+ $NAME:ident : $Type:ty = $input:expr; )*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum InputOrder { $($NAME),* }
        $( $(#[doc = $about])+ pub const $NAME: $crate::world::InputPoint<$Type> =
            $crate::world::InputPoint::new(InputOrder::$NAME as usize); )*
        /// The world that the model measures, in the order of the handles.
        pub const INPUTS: &[$crate::world::Input] =
            &[$( $input.named(stringify!($NAME), concat!($($about),+)), )*];
    };
}

/// The values of a device's inputs. Physics that moves an input (a charge, a room's temperature) moves it here.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    values: Vec<f64>,
}

impl World {
    /// The world as its inputs' defaults say.
    pub fn new(inputs: &[Input]) -> Self {
        Self { values: inputs.iter().map(Input::default).collect() }
    }

    /// A number of the world.
    pub fn number(&self, input: InputPoint<f64>) -> f64 {
        self.values[input.index]
    }

    /// A yes or no of the world.
    pub fn flag(&self, input: InputPoint<bool>) -> bool {
        self.values[input.index] != 0.0
    }

    /// Moves a number of the world.
    pub fn set_number(&mut self, input: InputPoint<f64>, value: f64) {
        self.values[input.index] = value;
    }

    /// A value by the number of its input; flags are 0 and 1.
    pub fn value(&self, index: usize) -> f64 {
        self.values[index]
    }

    /// Sets a value by the number of its input; the caller has asked [`Input::admits`].
    pub fn set_value(&mut self, index: usize, value: f64) {
        self.values[index] = value;
    }
}
