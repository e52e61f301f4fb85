"""What the devices show at their start and how they take writes, as the manuals and the register tables say.

Typed off the manuals, not off the program: line registers as the bus sets them (9600 baud, 8N2), everything else at
factory values, the clock standing still at the moment of the Astro manual's example.
"""

from __future__ import annotations

from dataclasses import dataclass

COIL, DISCRETE, INPUT, HOLDING = "coil", "discrete", "input", "holding"

ASTRO, PFC, HEATER, TRC = 1, 2, 3, 4

#: A unit that nobody has.
NOBODY = 77

FOUR_DEVICES = """
[clock]
start = "2014-10-27T14:22:08"
rate = 0

[[bus]]
name = "line1"
port = "pty:{dir}/line1"

[[bus.device]]
name = "yard"
model = "kael-astro-01"
unit = 1

[[bus.device]]
name = "panel"
model = "logiccon-pfc24s-tcr"
unit = 2

[[bus.device]]
name = "heater"
model = "hmi-volcano-ec"
unit = 3

[[bus.device]]
name = "charger"
model = "logiccon-trc"
unit = 4
"""


@dataclass(frozen=True)
class Run:
    """A run of neighbouring registers or bits and what they hold."""

    unit: int
    bank: str
    addr: int
    values: list[int]


#: ASTRO-1, ASTRO-3, ASTRO-70: at 14:22 both relays are off, by sunrise and by midnight.
ASTRO_START = [
    Run(ASTRO, HOLDING, 0x0000, [869, 7436, 88294 >> 16, 88294 & 0xFFFF, 6, 0x0100, 0, 0]),
    Run(ASTRO, HOLDING, 0x0010, [14, 10, 27, 14, 22, 8, 1]),
    Run(ASTRO, HOLDING, 0x0020, [72, 1, 41, 1, 0, 28, 57, 120]),
    Run(ASTRO, HOLDING, 0x0030, [1, 3, 5, 7, 3, 0, 10, 5, 7, 4, 0, 0]),
    Run(ASTRO, HOLDING, 0x0040, [0, 14, 1, 1, 14, 1, 1, 0, 14, 1, 1, 14, 1, 1]),
    Run(ASTRO, HOLDING, 0x0050, [0, 0, 0, 0, 0, 0, 0, 0, 0]),
    Run(ASTRO, HOLDING, 0x0060, [1, 1, 0, 3]),
    Run(ASTRO, HOLDING, 0x0074, [24, 4]),
    Run(ASTRO, HOLDING, 0x0080, [24, 4, 0, 1, 0, 0, 0]),
    Run(ASTRO, HOLDING, 0x00A0, [1]),
]

#: TRC-1: relay 3, the battery's contactor, is coil 2; 230 V mains, 2.0 A load.
TRC_START = [
    Run(TRC, HOLDING, 0, [4, 2, 1, 275, 20, 190, 250, 180, 285, 210, 40, 30]),
    Run(TRC, COIL, 0, [0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0]),
    Run(TRC, INPUT, 0, [0, 230]),
    Run(TRC, INPUT, 4, [0, 20]),
    Run(TRC, INPUT, 8, [0, 25]),
]

#: PFC-1, PFC-10: 230 V a phase are 398.37 V between two; 20 kW and 15 kvar a phase are 25 kVA and a factor of 0.8.
PFC_START = [
    Run(PFC, HOLDING, 1, [1, 0, 1, 0, 6, 10, 10, 1]),
    Run(PFC, HOLDING, 185, [1, 2, 0, 0, 6, 10, 10, 1, 1, 0, 0, 0, 95, 0]),
    Run(PFC, HOLDING, 220, [20, 0, 0, 260, 0, 0, 180, 0, 0, 1000, 0, 0, 60, 0, 0, 40, 30, 0]),
    Run(PFC, HOLDING, 240, [1, 0, 1, 2, 2, 3, 0, 0, 0, 0]),
    Run(PFC, INPUT, 0, [230, 0, 230, 0, 230, 0, 398, 37, 398, 37, 398, 37]),
    Run(PFC, INPUT, 22, [20, 0, 20, 0, 20, 0, 60, 0, 15, 0, 15, 0, 15, 0, 45, 0, 25, 0, 25, 0, 25, 0, 75, 0]),
    Run(PFC, INPUT, 46, [0, 800, 0, 800, 0, 800, 50, 0]),
    Run(PFC, INPUT, 58, [5, 0, 100, 0]),
    Run(PFC, COIL, 0, [0] * 28),
]

#: VOL-1: a monday, 'n' for the parity, and an off thermostat: 20 °C needs no cooling to 22 °C.
HEATER_START = [
    Run(HEATER, HOLDING, 0, [960, ord("n"), 3, 0, 10, 0, 14, 10, 27, 14, 22, 8, 0, 400, 700, 1000]),
    Run(HEATER, HOLDING, 16, [0, 1, 3, 0, 0, 0, 1, 2200, 1800, 50, 500, 4000]),
    Run(HEATER, HOLDING, 28, [480, 780, 840, 1080] * 3 + [0]),
    Run(HEATER, INPUT, 0, [2000, 0]),
    Run(HEATER, DISCRETE, 0, [1, 0]),
    Run(HEATER, COIL, 0, [0, 0, 1, 0, 0, 0, 0]),
]

START = ASTRO_START + TRC_START + PFC_START + HEATER_START
