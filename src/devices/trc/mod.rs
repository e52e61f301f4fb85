//! LogiCCon TRC: rectifier and battery charger.
