//! HMI-VOLCANO EC: room controller of a fan heater.
