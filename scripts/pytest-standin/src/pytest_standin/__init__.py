"""A fresh bench of simulated Modbus field devices for every test: see docs/testing.md of standin."""

from .bench import Bench, Clock, Device, Fault
from .client import StandinError
from .plugin import StandinFactory

__all__ = ["Bench", "Clock", "Device", "Fault", "StandinError", "StandinFactory"]
