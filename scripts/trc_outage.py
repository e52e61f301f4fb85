#!/usr/bin/env python3
"""Takes the mains from a LogiCCon TRC over Modbus, watches its battery run down and charge again, and prints a table.

    pip install pymodbus pyserial
    standin run scripts/trc_outage.toml &      # a charger whose clock runs 600 times as fast
    scripts/trc_outage.py /tmp/standin/outage --unit 4 --rate 600

Modbus cannot pull a plug. But the charger leaves mains alone that are out of its limits, so the script moves a limit past
them and back again. That needs mains above 230 V or below 210 V, where the limits end: `inputs = { ac_voltage = 240 }`.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

RELAYS = ["alarm", "fan", "battery", "short", "overload", "leak-", "leak+", "AC high", "AC low", "DC high", "DC low"]

#: Register, name and the end of its range, for mains that are above or below it.
AC_HIGH_LIMIT = (6, "ac_high_limit", 230)
AC_LOW_LIMIT = (7, "ac_low_limit", 210)

HEADING = f"{'time':>6} {'mains':>7} {'output':>8} {'load':>8} {'battery':>9} {'charge':>9}  relays"


class Reading(NamedTuple):
    """What the charger measures, in V, A and °C, and the names of the relays that are on."""

    mains_v: int
    output_v: float
    load_a: float
    battery_a: float
    temperature_c: int
    relays: list[str]


class Charger:
    """A TRC on a serial port."""

    def __init__(self, client: ModbusSerialClient, unit: int) -> None:
        self.client = client
        self.unit = unit

    def read(self) -> Reading:
        """All measurements (32 bit, signed, high word first) and all relays."""
        words = checked(self.client.read_input_registers(0, count=10, device_id=self.unit)).registers
        mains, output, load, battery, temperature = (
            self.client.convert_from_registers(words[at : at + 2], self.client.DATATYPE.INT32)
            for at in range(0, 10, 2)
        )
        bits = checked(self.client.read_coils(0, count=len(RELAYS), device_id=self.unit)).bits
        relays = [name for name, is_on in zip(RELAYS, bits) if is_on]
        return Reading(mains, output / 10, load / 10, battery / 10, temperature, relays)

    def get(self, address: int) -> int:
        """A holding register."""
        return checked(self.client.read_holding_registers(address, count=1, device_id=self.unit)).registers[0]

    def set(self, address: int, value: int) -> None:
        """Writes a holding register; it holds at once."""
        checked(self.client.write_register(address, value, device_id=self.unit))


class Watch:
    """Prints the charger's readings by simulated time, and counts the charge that its battery takes and gives."""

    def __init__(self, charger: Charger, rate: float, step_s: float) -> None:
        self.charger = charger
        self.rate = rate
        self.step_s = step_s
        self.start = time.monotonic()
        self.charge_ah = 0.0
        self.last = (0.0, 0.0)

    def run(self, until_s: float) -> None:
        """Prints a line every step until a simulated time."""
        while True:
            now_s = (time.monotonic() - self.start) * self.rate
            reading = self.charger.read()
            last_s, last_a = self.last
            self.charge_ah += (reading.battery_a + last_a) / 2 * (now_s - last_s) / 3600
            self.last = (now_s, reading.battery_a)
            print(line(now_s, reading, self.charge_ah), flush=True)
            if now_s >= until_s:
                return
            next_s = min((now_s // self.step_s + 1) * self.step_s, until_s)
            time.sleep(max(0.0, self.start + next_s / self.rate - time.monotonic()))


def main() -> int:
    """Makes the outage that the command line asks for."""
    args = arguments()
    with ModbusSerialClient(args.port, baudrate=9600, stopbits=2, timeout=1) as client:
        try:
            return outage(Charger(client, args.unit), args)
        except (ModbusException, OSError) as error:
            print(error, file=sys.stderr)
            return 1


def outage(charger: Charger, args: argparse.Namespace) -> int:
    """Takes the mains away for a while and gives them back."""
    mains_v = charger.read().mains_v
    if AC_LOW_LIMIT[2] <= mains_v <= AC_HIGH_LIMIT[2]:
        print(f"mains of {mains_v} V are within every limit: see the head of this script", file=sys.stderr)
        return 1
    address, name, end = AC_HIGH_LIMIT if mains_v > AC_HIGH_LIMIT[2] else AC_LOW_LIMIT
    limit = charger.get(address)
    print(f"{name} {limit} -> {end}: {args.hours:g} h without mains, then {args.after:g} h with mains\n\n{HEADING}")
    watch = Watch(charger, args.rate, args.step * 60)
    charger.set(address, end)
    try:
        watch.run(args.hours * 3600)
    finally:
        charger.set(address, limit)
    watch.run((args.hours + args.after) * 3600)
    return 0


def arguments() -> argparse.Namespace:
    """What the command line says; all times are simulated times."""
    parser = argparse.ArgumentParser(description="Makes an outage at a LogiCCon TRC and prints what it does.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/outage")
    parser.add_argument("--unit", type=int, default=4, help="unit number (default: 4)")
    parser.add_argument("--rate", type=float, default=600, help="the simulation's clock rate (default: 600)")
    parser.add_argument("--hours", type=float, default=2, help="length of the outage (default: 2)")
    parser.add_argument("--after", type=float, default=3, help="hours to watch after it (default: 3)")
    parser.add_argument("--step", type=float, default=10, help="minutes between two lines (default: 10)")
    return parser.parse_args()


def checked(reply):
    """A reply that is no exception."""
    if reply.isError():
        raise ModbusException(f"the charger refuses: {reply}")
    return reply


def line(now_s: float, reading: Reading, charge_ah: float) -> str:
    """One line of the table."""
    hours, minutes = divmod(round(now_s / 60), 60)
    return (
        f"{hours:3}:{minutes:02} {reading.mains_v:5} V {reading.output_v:6.1f} V {reading.load_a:6.1f} A"
        f" {reading.battery_a:+7.1f} A {charge_ah:+6.2f} Ah  {', '.join(reading.relays)}"
    )


if __name__ == "__main__":
    sys.exit(main())
