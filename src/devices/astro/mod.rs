//! KAEL Astro RS485: astronomical time switch with two relays.
