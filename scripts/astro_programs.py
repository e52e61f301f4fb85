#!/usr/bin/env python3
"""Lists, adds, changes and deletes the programs of a KAEL Astro RS485, by the handshake of its manual.

    pip install pymodbus pyserial
    scripts/astro_programs.py /tmp/standin/line1 list
    scripts/astro_programs.py /tmp/standin/line1 add B on sunset-2:00 mon-sat     # 2 h before sunset, except Sundays
    scripts/astro_programs.py /tmp/standin/line1 change 5 B on sunset-1:30 daily
    scripts/astro_programs.py /tmp/standin/line1 delete 5
    scripts/astro_programs.py /tmp/standin/line1 tour                             # all of it, one after the other

A program is RELAY on|off WHEN DAYS: WHEN is 15:22:16, sunrise, sunset+0:15 …; DAYS is daily, mon-sat, mon,wed,fri …
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from typing import NamedTuple

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

PROGRAM_CAPACITY = 0x0080  # and then program_count
PROGRAM_UPDATE = 0x0082
PROGRAM_INPUT_ORDER = 0x0083
PROCESS_START = 0x0084  # and then process_configuration, processed_order
PROCESS_CONFIGURATION = 0x0085
RECORD = 0x0087  # settings, hour, minute, second, offset, active days

EDIT, CLEAR, NEW, READ = 1, 2, 4, 8
DONE, DONE_WITH_ERROR = 2, 6
FAILURES = {
    EDIT: "slot {} is empty, or the program is none",
    CLEAR: "slot {} is empty",
    NEW: "all slots are full, or the program is none",
    READ: "slot {} cannot be read",
}

ASTRO, SUNRISE, RELAY_A, ON = 1, 2, 4, 8
EMPTY = 0xFF
DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
BUSY = 4  # the exception while a process is working


class Program(NamedTuple):
    """A program in the words of the record registers; the offset is signed."""

    settings: int
    hour: int
    minute: int
    second: int
    offset_minutes: int
    active_days: int

    @classmethod
    def parse(cls, relay: str, position: str, when: str, days: str) -> Program:
        """A program from its words; ValueError tells what is wrong with them."""
        settings = {"A": RELAY_A, "B": 0}[relay] | {"on": ON, "off": 0}[position]
        if astro := re.fullmatch(r"(sunrise|sunset)(?:([+-])(\d\d?):(\d\d))?", when):
            event, sign, hours, minutes = astro.groups()
            offset = (int(hours or 0) * 60 + int(minutes or 0)) * (-1 if sign == "-" else 1)
            if abs(offset) > 720:
                raise ValueError(f"an offset is 12:00 at most, not {when}")
            return cls(settings | ASTRO | (SUNRISE if event == "sunrise" else 0), 0, 0, 0, offset, parse_days(days))
        if clock := re.fullmatch(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d))?", when):
            hour, minute, second = (int(part or 0) for part in clock.groups())
            return cls(settings, hour, minute, second, 0, parse_days(days))
        raise ValueError(f"{when} is no time: 15:22:16, sunrise, sunset-2:00")

    def __str__(self) -> str:
        relay = "A" if self.settings & RELAY_A else "B"
        position = "on" if self.settings & ON else "off"
        when = f"{self.hour:02}:{self.minute:02}:{self.second:02}"
        if self.settings & ASTRO:
            when = "sunrise" if self.settings & SUNRISE else "sunset"
            hours, minutes = divmod(abs(self.offset_minutes), 60)
            if self.offset_minutes:
                when += f"{'-' if self.offset_minutes < 0 else '+'}{hours}:{minutes:02}"
        days = [day for bit, day in enumerate(DAYS) if self.active_days >> bit & 1]
        return f"relay {relay} {position:3} at {when:13} {'daily' if len(days) == 7 else ','.join(days) or 'never'}"


class Astro:
    """The programs of an Astro on a serial port."""

    def __init__(self, client: ModbusSerialClient, unit: int) -> None:
        self.client = client
        self.unit = unit

    def capacity_and_count(self) -> tuple[int, int]:
        """How many programs there can be, and how many there are."""
        capacity, count = self._read(PROGRAM_CAPACITY, 2)
        return capacity, count

    def programs(self) -> dict[int, Program]:
        """All programs by slot."""
        # Taken down before reading: a change that someone makes meanwhile sets it again.
        self._write(PROGRAM_UPDATE, 0)
        capacity, count = self.capacity_and_count()
        programs = {}
        for slot in range(1, capacity + 1):
            if len(programs) == count:
                break
            if program := self.program(slot):
                programs[slot] = program
        return programs

    def program(self, slot: int) -> Program | None:
        """What a slot holds."""
        self._process(READ, slot)
        *record, offset, days = self._read(RECORD, 6)
        return None if record[0] == EMPTY else Program(*record, offset - 0x10000 * (offset >> 15), days)

    def add(self, program: Program) -> int:
        """Puts a program into the lowest empty slot, and tells which."""
        return self._process(NEW, None, program)

    def change(self, slot: int, program: Program) -> None:
        """Puts a program in the place of another."""
        self._process(EDIT, slot, program)

    def delete(self, slot: int) -> None:
        """Empties a slot."""
        self._process(CLEAR, slot)

    def _process(self, operation: int, slot: int | None, program: Program | None = None) -> int:
        """The handshake: say what and where, start, wait for the end, and see how it went. Gives the slot."""
        if slot is not None:
            self._write(PROGRAM_INPUT_ORDER, slot)
        if program is not None:
            self._write(RECORD, *(word & 0xFFFF for word in program))
        self._write(PROCESS_CONFIGURATION, operation)
        self._write(PROCESS_START, 1)
        end = time.monotonic() + 5
        while True:
            start, configuration, processed = self._read(PROCESS_START, 3)
            if start == DONE:
                return processed
            if start == DONE_WITH_ERROR:
                reason = FAILURES[operation].format(slot)
                raise ModbusException(f"{reason} (process_configuration 0x{configuration:02X})")
            if time.monotonic() > end:
                raise ModbusException("the device does not finish")
            time.sleep(0.02)

    def _read(self, address: int, count: int) -> list[int]:
        reply = self.client.read_holding_registers(address, count=count, device_id=self.unit)
        return checked(reply).registers

    def _write(self, address: int, *words: int) -> None:
        end = time.monotonic() + 5
        while True:
            reply = self.client.write_registers(address, list(words), device_id=self.unit)
            # A process that someone else has started keeps the device busy for a moment.
            if getattr(reply, "exception_code", None) != BUSY or time.monotonic() > end:
                checked(reply)
                return
            time.sleep(0.02)


def main() -> int:
    """Does what the command line asks for."""
    args = arguments()
    with ModbusSerialClient(args.port, baudrate=args.baud, stopbits=2, timeout=1) as client:
        astro = Astro(client, args.unit)
        try:
            args.run(astro, args)
        except (ModbusException, OSError, ValueError) as error:
            print(error, file=sys.stderr)
            return 1
    return 0


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="Lists, adds, changes and deletes the programs of a KAEL Astro RS485.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/line1")
    parser.add_argument("--unit", type=int, default=1, help="unit number (default: 1)")
    parser.add_argument("--baud", type=int, default=9600, help="speed of the line (default: 9600)")
    commands = parser.add_subparsers(required=True, metavar="list | add | change | delete | tour")

    def command(name: str, run, *, slot: bool = False, program: bool = False) -> None:
        sub = commands.add_parser(name, help=run.__doc__)
        sub.set_defaults(run=run)
        if slot:
            sub.add_argument("slot", type=int)
        if program:
            sub.add_argument("relay", choices=["A", "B"])
            sub.add_argument("position", choices=["on", "off"])
            sub.add_argument("when", help="15:22:16, sunrise, sunset-2:00")
            sub.add_argument("days", nargs="?", default="daily", help="daily (default), mon-sat, mon,wed,fri")

    command("list", list_programs)
    command("add", add, program=True)
    command("change", change, slot=True, program=True)
    command("delete", delete, slot=True)
    command("tour", tour)
    return parser.parse_args()


def wanted(args: argparse.Namespace) -> Program:
    """The program that the command line describes."""
    return Program.parse(args.relay, args.position, args.when, args.days)


def list_programs(astro: Astro, _args: argparse.Namespace | None = None) -> None:
    """list all programs"""
    for slot, program in astro.programs().items():
        print(f"{slot:3}: {program}")
    capacity, count = astro.capacity_and_count()
    print(f"{count} of {capacity} slots are taken")


def add(astro: Astro, args: argparse.Namespace) -> None:
    """put a program into the lowest empty slot"""
    print(f"added to slot {astro.add(wanted(args))}")


def change(astro: Astro, args: argparse.Namespace) -> None:
    """put a program in the place of another"""
    astro.change(args.slot, wanted(args))
    print(f"changed slot {args.slot}")


def delete(astro: Astro, args: argparse.Namespace) -> None:
    """empty a slot"""
    astro.delete(args.slot)
    print(f"deleted slot {args.slot}")


def tour(astro: Astro, _args: argparse.Namespace) -> None:
    """list, add, change and delete a program"""
    list_programs(astro)
    slot = astro.add(Program.parse("B", "on", "sunset-2:00", "mon-sat"))
    print(f"\nadded     {slot:3}: {astro.program(slot)}")
    astro.change(slot, Program.parse("B", "on", "sunset-1:30", "daily"))
    print(f"changed   {slot:3}: {astro.program(slot)}")
    astro.delete(slot)
    print(f"deleted   {slot:3}\n")
    list_programs(astro)


def parse_days(text: str) -> int:
    """The bits of some days of the week, Monday first."""
    if text == "daily":
        return 0x7F
    bits = 0
    for part in text.lower().split(","):
        first, _, last = part.partition("-")
        if first not in DAYS or (last or first) not in DAYS:
            raise ValueError(f"{part} is no day: {', '.join(DAYS)}, mon-sat, daily")
        begin, end = DAYS.index(first), DAYS.index(last or first)
        # From Friday to Monday goes over the end of the week.
        bits |= sum(1 << day % 7 for day in range(begin, end + 1 if end >= begin else end + 8))
    return bits


def checked(reply):
    """A reply that is no exception."""
    if reply.isError():
        raise ModbusException(f"the device refuses: {reply}")
    return reply


if __name__ == "__main__":
    sys.exit(main())
