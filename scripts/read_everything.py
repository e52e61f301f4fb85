#!/usr/bin/env python3
"""Reads every register and bit of every device of a running devices.toml, by name, and prints them as a table.

    pip install pymodbus pyserial
    cargo run --release &                      # the devices
    scripts/read_everything.py                 # all of ./devices.toml
    scripts/read_everything.py --device charger --bank input

The names, formats and units come from `standin registers MODEL --format json`: nothing here knows a device.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

ROOT = Path(__file__).resolve().parent.parent

PARITY = {"none": "N", "even": "E", "odd": "O"}


def main() -> int:
    """Reads what the command line asks for; 1 where a device does not answer."""
    args = arguments()
    program = args.standin or find_program()
    try:
        config = tomllib.loads(args.config.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        sys.exit(f"{args.config}: {error}")
    failed = False
    for bus in config["bus"]:
        devices = [each for each in bus.get("device", []) if args.device in (None, each["name"])]
        if not devices or args.bus not in (None, bus["name"]):
            continue
        with open_port(bus, args.port) as client:
            for device in devices:
                model = register_map(program, device["model"])
                print(f"{device['name']}: {model['title']} ({device['model']}), unit {device['unit']} on {bus['name']}")
                try:
                    for line in table(client, device["unit"], model, args.bank):
                        print(f"  {line}")
                except (ModbusException, OSError) as error:
                    print(f"  {error}", file=sys.stderr)
                    failed = True
                print()
    return 1 if failed else 0


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="Reads everything of every device, by name.")
    parser.add_argument("config", type=Path, nargs="?", default=Path("devices.toml"), help="default: devices.toml")
    parser.add_argument("--bus", help="only this bus")
    parser.add_argument("--device", help="only this device")
    parser.add_argument("--bank", choices=["coil", "discrete", "input", "holding"], help="only this kind of data")
    parser.add_argument("--port", help="the serial port, where it is not the pty of the configuration")
    parser.add_argument("--standin", help="the program, where it is not on the PATH or freshly built")
    return parser.parse_args()


def find_program() -> str:
    """The program on the PATH, or the last build."""
    built = [ROOT / "target" / profile / "standin" for profile in ("release", "debug")]
    found = shutil.which("standin") or next((str(path) for path in built if path.exists()), None)
    return found or sys.exit("standin is neither on the PATH nor built: cargo build")


def register_map(program: str, model: str) -> dict[str, Any]:
    """The register map of a model."""
    command = [program, "registers", model, "--format", "json"]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: dict[str, Any] = json.loads(said)
    return found


def open_port(bus: dict[str, Any], port: str | None) -> ModbusSerialClient:
    """A client on a bus' serial port, with the bus' line settings."""
    doors = [bus["port"]] if "port" in bus else bus["ports"]
    serial = [door.partition(":")[2] for door in doors if door.startswith(("pty:", "serial:"))]
    path = port or next(iter(serial), None) or sys.exit(f"{bus['name']} has no serial port: give one with --port")
    is_pty = any(door.startswith("pty:") for door in doors)
    return ModbusSerialClient(
        path,
        baudrate=bus.get("baud", 9600),
        # A pty keeps no parity, and the system refuses to set it twice.
        parity="N" if is_pty else PARITY[bus.get("parity", "none")],
        stopbits=bus.get("stop_bits", 2),
        timeout=1,
    )


def table(client: ModbusSerialClient, unit: int, model: dict[str, Any], bank: str | None) -> Iterator[str]:
    """A line for every register: bank, address, name, value with its unit, and the words it comes from."""
    registers = [each for each in model["registers"] if bank in (None, each["bank"])]
    width = max((len(each["name"]) for each in registers), default=0)
    for run in runs(registers, model["limits"]):
        words = read(client, unit, run)
        start = run[0]["address"]
        for register in run:
            at = register["address"] - start
            own = words[at : at + register["words"]]
            address, name = register["address"], register["name"]
            raw = " ".join(f"{word:04X}" for word in own)
            yield f"{register['bank']:8} {address:4} {address:04X}  {name:{width}}  {value(register, own):>16}  {raw}"


def runs(registers: list[dict[str, Any]], limits: dict[str, int]) -> Iterator[list[dict[str, Any]]]:
    """Neighbours that one request can read."""
    run: list[dict[str, Any]] = []
    for register in registers:
        if run:
            last, first = run[-1], run[0]
            most = limits["read_bits" if register["bank"] in ("coil", "discrete") else "read_registers"]
            end = register["address"] + register["words"]
            is_next = register["bank"] == last["bank"] and register["address"] == last["address"] + last["words"]
            if not is_next or end - first["address"] > most:
                yield run
                run = []
        run.append(register)
    if run:
        yield run


def read(client: ModbusSerialClient, unit: int, run: list[dict[str, Any]]) -> list[int]:
    """The words or bits of a run."""
    bank, start = run[0]["bank"], run[0]["address"]
    count = run[-1]["address"] + run[-1]["words"] - start
    call = {
        "coil": client.read_coils,
        "discrete": client.read_discrete_inputs,
        "input": client.read_input_registers,
        "holding": client.read_holding_registers,
    }[bank]
    reply = call(start, count=count, device_id=unit)
    if reply.isError():
        raise ModbusException(f"{bank} {start} to {start + count - 1}: exception {reply.exception_code:02}")
    return [int(bit) for bit in reply.bits[:count]] if bank in ("coil", "discrete") else list(reply.registers)


def value(register: dict[str, Any], words: list[int]) -> str:
    """The number that words stand for, with its decimals and unit."""
    scale = register["scale"]
    digits = f"{number(register['format'], words, scale) / 10**scale:.{scale}f}"
    return f"{digits} {register['unit']}".rstrip()


def number(form: str, words: list[int], scale: int) -> int:
    """The whole number that words stand for; `scale` of its digits are decimals."""
    signed = [word - 0x10000 if word & 0x8000 else word for word in words]
    match form:
        case "s16":
            return signed[0]
        case "u32":
            return words[0] << 16 | words[1]
        case "s32":
            return signed[0] << 16 | words[1]
        case "whole+decimals":
            return signed[0] * int(10**scale) + signed[1]
        case "unsigned whole+decimals":
            return words[0] * int(10**scale) + words[1]
        case "10000s+rest":
            return words[0] * 10_000 + words[1]
        case "bit" | "u16":
            return words[0]
        case _:
            raise ValueError(f"{form} is a format that this script does not know")


if __name__ == "__main__":
    sys.exit(main())
