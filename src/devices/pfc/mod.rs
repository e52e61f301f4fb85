//! LogiCCon PFC24S-TCR: power-factor relay with 24 steps.
