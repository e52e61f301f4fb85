#!/usr/bin/env python3
"""Gives an HMI-VOLCANO EC a weekly schedule and a target, and draws a day of the room.

    pip install pymodbus pyserial
    standin run scripts/volcano_day.toml &     # a cold Monday whose clock runs 3600 times as fast: a day is 24 s
    scripts/volcano_day.py /tmp/standin/heating --unit 4

Every line is half an hour of the controller's own clock: the room's temperature (o) and the target (|), how long the
valve was open, and the fan's voltage. With --png FILE matplotlib draws the same; it has to be installed for that.
"""

from __future__ import annotations

import argparse
import datetime
import statistics
import sys
import time
from typing import NamedTuple

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

# Holding registers; temperatures are hundredths of a degree, times minutes of the day.
WEEK_DAY = 5  # and behind it year, month, day, hour, minute, second
FAN_VOLT = 12
ZONE = 18  # available mode, program, protection, mode, fan speed, target, eco temperature
SCHEDULE = 28  # Monday to Friday, Saturday, Sunday: start and stop of the first and of the second period
FAN_MODE = 40

# Coils.
HEATING, POWER, FAHRENHEIT = 0, 2, 5

BOTH_MODES, BY_SCHEDULE, ECO, HEAT, AUTOMATIC = 3, 1, 2, 1, 1

WORKING_DAY = ["06:00", "09:00", "16:00", "22:00"]
WEEKEND_DAY = ["08:00", "12:00", "14:00", "23:00"]

#: The states of zone_actual_program_state.
STATES = ["always", "period 1", "pause", "period 2", "rest"]

SLOT_MINUTES = 30
GRAPH_WIDTH = 41


class Sample(NamedTuple):
    """The controller at a moment of its own clock: temperatures in °C, voltage in V."""

    at: datetime.datetime
    state: int
    room: float
    target: float
    is_open: bool
    fan: float


class Controller:
    """A Volcano on a serial port."""

    def __init__(self, client: ModbusSerialClient, unit: int) -> None:
        self.client = client
        self.unit = unit

    def prepare(self, target: float, eco: float) -> None:
        """On, in °C, heating by the schedule with an automatic fan, and held above the eco temperature outside it."""
        for coil, is_on in ((POWER, True), (FAHRENHEIT, False)):
            checked(self.client.write_coil(coil, is_on, device_id=self.unit))
        minutes = [minute(text) for text in WORKING_DAY + WEEKEND_DAY + WEEKEND_DAY]
        self.write(SCHEDULE, minutes)
        self.write(FAN_MODE, [AUTOMATIC])
        self.write(ZONE, [BOTH_MODES, BY_SCHEDULE, ECO, HEAT, 20, round(target * 100), round(eco * 100)])

    def write(self, address: int, values: list[int]) -> None:
        """Writes registers in one message, which the controller takes as a whole or not at all."""
        checked(self.client.write_registers(address, values, device_id=self.unit))

    def sample(self) -> Sample:
        """What the controller shows now."""
        words = checked(self.client.read_holding_registers(WEEK_DAY, count=19, device_id=self.unit)).registers
        measured = checked(self.client.read_input_registers(0, count=2, device_id=self.unit)).registers
        coils = checked(self.client.read_coils(HEATING, count=1, device_id=self.unit)).bits
        year, month, day, hour, minutes, second = words[1:7]
        room = self.client.convert_from_registers(measured[:1], self.client.DATATYPE.INT16)
        return Sample(
            datetime.datetime(2000 + year, month, day, hour, minutes, second),
            measured[1],
            room / 100,
            words[-1] / 100,
            coils[0],
            words[FAN_VOLT - WEEK_DAY] / 100,
        )


def main() -> int:
    """Draws the day that the command line asks for."""
    args = arguments()
    with ModbusSerialClient(args.port, baudrate=9600, stopbits=2, timeout=1) as client:
        controller = Controller(client, args.unit)
        try:
            controller.prepare(args.target, args.eco)
            samples = watch(controller, args.hours)
        except (ModbusException, OSError) as error:
            print(error, file=sys.stderr)
            return 1
    print(graph(samples))
    if args.png:
        return draw(samples, args.png)
    return 0


def watch(controller: Controller, hours: float) -> list[Sample]:
    """Samples until the controller's clock has moved on by some hours, or somebody interrupts."""
    samples = [controller.sample()]
    end = samples[0].at + datetime.timedelta(hours=hours)
    started = time.monotonic()
    is_told = False
    try:
        while samples[-1].at < end:
            time.sleep(0.02)
            samples.append(controller.sample())
            if not is_told and time.monotonic() - started > 2:
                is_told = True
                rate = (samples[-1].at - samples[0].at).total_seconds() / (time.monotonic() - started)
                print(f"the clock runs {rate:.0f} times as fast: {hours:g} h take {duration(hours, rate)}", flush=True)
    except KeyboardInterrupt:
        print("interrupted: this is the day so far")
    return samples


def graph(samples: list[Sample]) -> str:
    """The day as text, a line for every half hour."""
    slots: dict[datetime.datetime, list[Sample]] = {}
    for sample in samples:
        at = sample.at.replace(minute=sample.at.minute // SLOT_MINUTES * SLOT_MINUTES, second=0)
        slots.setdefault(at, []).append(sample)
    temperatures = [value for sample in samples for value in (sample.room, sample.target)]
    low, high = int(min(temperatures)) - 1, int(max(temperatures)) + 2

    def column(celsius: float) -> int:
        return round((celsius - low) / (high - low) * (GRAPH_WIDTH - 1))

    scale = f"{low} °C".ljust(GRAPH_WIDTH - 5) + f"{high} °C"
    lines = [f"day time   room target  {scale}  valve    fan  schedule"]
    for at, slot in slots.items():
        room = statistics.fmean(sample.room for sample in slot)
        target = slot[-1].target
        row = ["."] * GRAPH_WIDTH
        row[column(target)] = "|"
        row[column(room)] = "o"
        is_open = statistics.fmean(sample.is_open for sample in slot)
        fan = statistics.fmean(sample.fan for sample in slot)
        state = statistics.mode(sample.state for sample in slot)
        head = f"{at:%a %H:%M} {room:6.2f} {target:6.2f}"
        lines.append(f"{head}  {''.join(row)} {is_open:5.0%} {fan:5.2f} V  {STATES[state]}")
    return "\n".join(lines)


def draw(samples: list[Sample], path: str) -> int:
    """The day as a picture."""
    try:
        from matplotlib import pyplot
    except ImportError:
        print("--png needs matplotlib: pip install matplotlib", file=sys.stderr)
        return 1
    times = [sample.at for sample in samples]
    figure, (temperature, output) = pyplot.subplots(2, sharex=True, figsize=(10, 6))
    temperature.plot(times, [sample.room for sample in samples], label="room")
    temperature.step(times, [sample.target for sample in samples], label="target")
    temperature.set_ylabel("°C")
    temperature.legend()
    output.step(times, [sample.fan for sample in samples], label="fan, V")
    output.step(times, [float(sample.is_open) for sample in samples], label="valve")
    output.legend()
    figure.autofmt_xdate()
    figure.savefig(path)
    return 0


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="Gives an HMI-VOLCANO EC a schedule and draws a day of its room.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/heating")
    parser.add_argument("--unit", type=int, default=4, help="unit number (default: 4)")
    parser.add_argument("--target", type=float, default=21, help="°C while the schedule says so (default: 21)")
    parser.add_argument("--eco", type=float, default=15, help="°C below which it always heats (default: 15)")
    parser.add_argument("--hours", type=float, default=24, help="hours of the controller's clock (default: 24)")
    parser.add_argument("--png", metavar="FILE", help="draw a picture too")
    return parser.parse_args()


def minute(text: str) -> int:
    """Minutes of the day of a time such as 06:30."""
    hours, minutes = text.split(":")
    return int(hours) * 60 + int(minutes)


def duration(hours: float, rate: float) -> str:
    """How long simulated hours take, in words."""
    seconds = hours * 3600 / max(rate, 1e-9)
    return f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 3600:.1f} h; start standin with a higher --rate"


def checked(reply):
    """A reply that is no exception."""
    if reply.isError():
        raise ModbusException(f"the controller refuses: {reply}")
    return reply


if __name__ == "__main__":
    sys.exit(main())
