//! The models: the one place that names them all.

pub mod astro;
pub mod pfc;
pub mod trc;
pub mod volcano;

use crate::device::Kind;

/// Every model, in the order in which they are listed.
pub const KINDS: &[&Kind] = &[&astro::ASTRO_01, &astro::ASTRO_03, &trc::KIND, &pfc::KIND, &volcano::KIND];

/// The model of that name.
pub fn kind(name: &str) -> Option<&'static Kind> {
    KINDS.iter().copied().find(|kind| kind.name == name)
}
