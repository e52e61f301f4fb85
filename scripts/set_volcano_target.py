#!/usr/bin/env python3
"""Sets the target of an HMI-VOLCANO EC over Modbus, and says what became of it.

    pip install pymodbus pyserial
    standin &
    scripts/set_volcano_target.py /tmp/standin/line1 --unit 4 21.7

The device answers a write with what was sent and keeps it rounded down to half a degree, so the script reads it back.
It refuses a target outside its limits with exception 03, so the script reads the limits. All temperatures are in the
unit that the device is set to.
"""

from __future__ import annotations

import argparse
import sys

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

# Holding registers, in hundredths of a degree.
TARGET = 23
LIMITS = 26  # the lowest target, and behind it the highest

# Coils.
HEATING, COOLING, POWER, FAHRENHEIT = 0, 1, 2, 5

ILLEGAL_DATA_VALUE = 3

PROGRAM_STATES = ["always at work", "at work, first period", "in a pause", "at work, second period", "at rest"]


def main() -> int:
    """Sets what the command line asks for."""
    args = arguments()
    with ModbusSerialClient(args.port, baudrate=9600, stopbits=2, timeout=1) as client:
        try:
            return set_target(client, args.unit, args.degrees)
        except (ModbusException, OSError) as error:
            print(error, file=sys.stderr)
            return 1


def set_target(client: ModbusSerialClient, unit: int, degrees: float) -> int:
    """Writes the target, reads it back, and tells the difference."""
    coils = checked(client.read_coils(0, count=7, device_id=unit)).bits
    sign = "°F" if coils[FAHRENHEIT] else "°C"
    reply = client.write_register(TARGET, round(degrees * 100), device_id=unit)
    if reply.isError() and reply.exception_code == ILLEGAL_DATA_VALUE:
        lowest, highest = checked(client.read_holding_registers(LIMITS, count=2, device_id=unit)).registers
        told = f"the device takes {lowest / 100:.2f} to {highest / 100:.2f} {sign}"
        print(f"refused: {degrees:.2f} {sign} is no target, {told} (registers 26 and 27)", file=sys.stderr)
        return 1
    checked(reply)
    target = checked(client.read_holding_registers(TARGET, count=1, device_id=unit)).registers[0] / 100
    note = "" if target == round(degrees, 2) else f", {degrees:.2f} was asked for: it is rounded down to half a degree"
    print(f"target {target:.2f} {sign}{note}")
    print(situation(client, unit, sign))
    return 0


def situation(client: ModbusSerialClient, unit: int, sign: str) -> str:
    """What the controller makes of it: its temperature, schedule, valves and fan."""
    coils = checked(client.read_coils(0, count=7, device_id=unit)).bits
    words = checked(client.read_input_registers(0, count=2, device_id=unit)).registers
    fan = checked(client.read_holding_registers(12, count=1, device_id=unit)).registers[0] / 100
    reading = client.convert_from_registers(words[:1], client.DATATYPE.INT16) / 100
    room = "its sensor is broken" if words[0] == 0x8000 else f"room {reading:.2f} {sign}"
    state = PROGRAM_STATES[words[1]] if coils[POWER] else "switched off (coil 2)"
    valves = [name for name, coil in (("heating", HEATING), ("cooling", COOLING)) if coils[coil]]
    return f"{room}, {state}, {' '.join(valves) or 'valves shut'}, fan {fan:.2f} V"


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="Sets the target of an HMI-VOLCANO EC and says what became of it.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/line1")
    parser.add_argument("degrees", type=degrees, help="the target, in the unit that the device is set to")
    parser.add_argument("--unit", type=int, default=4, help="unit number (default: 4)")
    return parser.parse_args()


def degrees(text: str) -> float:
    """A temperature that a register can carry."""
    number = float(text)
    if not 0 <= number <= 655.35:
        raise argparse.ArgumentTypeError(f"{text} is not 0 to 655.35, which is what the register can carry")
    return number


def checked(reply):
    """A reply that is no exception."""
    if reply.isError():
        raise ModbusException(f"the controller refuses: {reply}")
    return reply


if __name__ == "__main__":
    sys.exit(main())
