#!/usr/bin/env python3
"""Sets the clock of a KAEL Astro RS485, in one write, and prints what it showed before and what it shows after.

    pip install pymodbus pyserial
    scripts/set_astro_clock.py /tmp/standin/line1 --unit 1                       # to this computer's local time
    scripts/set_astro_clock.py /tmp/standin/line1 --to 2014-10-27T14:22:08

One write for all six registers: written one by one, a date on the way might not exist and be refused (31 October, month 2),
and midnight might pass in between. The clock's registers are local time; its weekday follows from the date by itself.
"""

from __future__ import annotations

import argparse
import sys
import time
from datetime import datetime

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

#: rtc_year, _month, _day, _hour, _minute, _second, _weekday; the weekday is only read.
RTC = 0x0010

WEEKDAYS = ["Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday"]


def main() -> int:
    """Does what the command line asks for."""
    args = arguments()
    with ModbusSerialClient(args.port, baudrate=args.baud, stopbits=2, timeout=1) as client:
        try:
            print(f"before: {read(client, args.unit)}")
            write(client, args.unit, args.to or next_second())
            print(f"after:  {read(client, args.unit)}")
        except (ModbusException, OSError, ValueError) as error:
            print(error, file=sys.stderr)
            return 1
    return 0


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="Sets the clock of a KAEL Astro RS485.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/line1")
    parser.add_argument("--unit", type=int, default=1, help="unit number (default: 1)")
    parser.add_argument("--baud", type=int, default=9600, help="speed of the line (default: 9600)")
    parser.add_argument("--to", type=datetime.fromisoformat, metavar="DATE-TIME", help="default: this computer's time")
    return parser.parse_args()


def next_second() -> datetime:
    """This computer's local time, at the moment a second begins: a write of the seconds starts one on the device."""
    time.sleep(1 - datetime.now().microsecond / 1e6)
    return datetime.now()


def read(client: ModbusSerialClient, unit: int) -> str:
    """What the clock shows."""
    year, month, day, hour, minute, second, weekday = checked(
        client.read_holding_registers(RTC, count=7, device_id=unit)
    ).registers
    return f"{datetime(2000 + year, month, day, hour, minute, second)} {WEEKDAYS[weekday - 1]}"


def write(client: ModbusSerialClient, unit: int, to: datetime) -> None:
    """Sets the clock."""
    if not 2000 <= to.year <= 2099:
        raise ValueError(f"the clock knows the years 2000 to 2099, not {to.year}")
    words = [to.year - 2000, to.month, to.day, to.hour, to.minute, to.second]
    checked(client.write_registers(RTC, words, device_id=unit))


def checked(reply):
    """A reply that is no exception."""
    if reply.isError():
        raise ModbusException(f"the device refuses: {reply}")
    return reply


if __name__ == "__main__":
    sys.exit(main())
