#!/usr/bin/env python3
"""Reads a whole LogiCCon PFC24S-TCR and prints it as a report: measurements, steps, harmonics, energies, events.

    pip install pymodbus pyserial
    standin registers logiccon-pfc24s-tcr --format json > pfc.json
    scripts/pfc_report.py /tmp/standin/line1 --unit 3 --map pfc.json

Nothing of the register map is known here but names: addresses, formats and digits come from the exported map. A relay
with the option `decimal_digits` needs a map whose `scale` says the same.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

PHASES = ("a", "b", "c")
STATUS = ("automatic", "fixed", "passive")
CONNECTION = ("A-N", "B-N", "C-N", "A-B", "B-C", "C-A", "3-phase")
EVENTS = (
    "none",
    "overvoltage",
    "undervoltage",
    "overcurrent",
    "harmonic distortion",
    "high temperature",
    "digital input",
    "power loss",
)
EVENT_UNITS = ("", "V", "V", "A", "%", "°C", "", "")
BAR_WIDTH = 16


class Relay:
    """A relay on a serial port, read by its exported map."""

    def __init__(self, client: ModbusSerialClient, unit: int, model: dict) -> None:
        self.client = client
        self.unit = unit
        self.model = model

    def read(self) -> dict[str, float]:
        """The value of every register and coil by its name."""
        values: dict[str, float] = {}
        for bank in ("coil", "holding", "input"):
            rows = [row for row in self.model["registers"] if row["bank"] == bank]
            limit = self.model["limits"]["read_bits" if bank == "coil" else "read_registers"]
            for block in blocks(rows, limit):
                start = block[0]["address"]
                words = self.words(bank, start, block[-1]["address"] + block[-1]["words"] - start)
                for row in block:
                    at = row["address"] - start
                    values[row["name"]] = decoded(row, words[at : at + row["words"]])
        return values

    def words(self, bank: str, start: int, count: int) -> list[int]:
        """What one request reads."""
        read = {
            "coil": self.client.read_coils,
            "holding": self.client.read_holding_registers,
            "input": self.client.read_input_registers,
        }[bank]
        reply = read(start, count=count, device_id=self.unit)
        if reply.isError():
            raise ModbusException(f"the relay refuses {bank} {start}: {reply}")
        return [int(bit) for bit in reply.bits] if bank == "coil" else reply.registers


def blocks(rows: list[dict], limit: int) -> Iterator[list[dict]]:
    """Neighbouring rows, in blocks that one request can read; a pair is never cut."""
    block: list[dict] = []
    for row in rows:
        end = row["address"] + row["words"]
        if block and (row["address"] != block[-1]["address"] + block[-1]["words"] or end - block[0]["address"] > limit):
            yield block
            block = []
        block.append(row)
    yield block


def decoded(row: dict, words: list[int]) -> float:
    """The value of a row's words in its unit."""
    match row["format"]:
        case "bit" | "u16":
            return words[0] / 10 ** row["scale"]
        case "unsigned whole+decimals":
            return words[0] + words[1] / 10 ** row["scale"]
        case "whole+decimals":
            return signed(words[0]) + signed(words[1]) / 10 ** row["scale"]
        case "10000s+rest":
            return words[0] * 10_000 + words[1]
    raise ValueError(f"{row['name']} has a format that this script does not know: {row['format']}")


def signed(word: int) -> int:
    """A word in two's complement."""
    return word - 0x10000 if word & 0x8000 else word


def report(title: str, get: dict[str, float]) -> Iterator[str]:
    """The lines of the report."""
    yield title
    yield from measurements(get)
    yield from steps(get)
    yield from harmonics("current", get)
    yield from harmonics("voltage", get)
    yield from energies(get)
    yield from events(get)


def heading(text: str) -> Iterator[str]:
    """A heading."""
    yield ""
    yield text
    yield "─" * len(text)


def measurements(get: dict[str, float]) -> Iterator[str]:
    """Voltages, currents and powers, phase by phase."""
    yield from heading("Measurements")
    yield f"{'':16}{'A':>14}{'B':>14}{'C':>14}{'total':>14}"

    def line(label: str, names: Iterable[str], unit: str, digits: int) -> str:
        return f"{label:16}" + "".join(f"{f'{get[name]:.{digits}f} {unit}':>14}" for name in names)

    yield line("voltage", (f"voltage_{phase}n" for phase in PHASES), "V", 2)
    yield line("to next phase", ("voltage_ab", "voltage_bc", "voltage_ca"), "V", 2)
    yield line("current", (f"current_{phase}" for phase in PHASES), "A", 2)
    for power, unit in (("active_power", "kW"), ("reactive_power", "kvar"), ("apparent_power", "kVA")):
        yield line(power.replace("_", " "), (f"{power}_{phase}" for phase in (*PHASES, "total")), unit, 3)
    yield line("power factor", (f"power_factor_{phase}" for phase in PHASES), "", 3)
    yield f"{get['frequency']:.3f} Hz, neutral {get['voltage_neutral']:.2f} V, earth {get['current_earth']:.2f} A"
    ports = ("output_1", "output_2", "input_1", "input_2")
    yield ", ".join(f"{port.replace('_', ' ')} {'on' if get[port] else 'off'}" for port in ports)


def steps(get: dict[str, float]) -> Iterator[str]:
    """The steps that are of any use, with state, counts and hours."""
    yield from heading("Steps")
    yield f"{'':>4} {'':5} {'power':>12}  {'type':10} {'connection':10} {'control':10} {'switched':>9} {'hours in':>11}"
    unused = []
    for step in range(1, 25):
        name = f"step_{step}"
        power = get[f"{name}_power_whole"] + get[f"{name}_power_decimals"]
        switched = int(get[f"{name}_switch_count"])
        if power == switched == 0:
            unused.append(str(step))
            continue
        state = "■ in" if get[name] else "□ out"
        kind = "capacitive" if get[f"{name}_type"] else "inductive"
        connection = CONNECTION[int(get[f"{name}_connection"])]
        status = STATUS[int(get[f"{name}_status"])]
        hours = get[f"{name}_hours_in"]
        yield f"{step:>4} {state:5} {power:>7.2f} kvar  {kind:10} {connection:10} {status:10} {switched:>9} {hours:>11.3f}"
    if unused:
        yield f"not used: {', '.join(unused)}"


def harmonics(quantity: str, get: dict[str, float]) -> Iterator[str]:
    """The harmonics of three phases as bars, the greatest as wide as a bar may be."""
    yield from heading(f"Harmonics of the {quantity}s")
    orders = [order for order in range(2, 32) if any(get[f"{quantity}_{p}_harmonic_{order}"] for p in PHASES)]
    greatest = max((get[f"{quantity}_{p}_harmonic_{order}"] for p in PHASES for order in orders), default=0)

    def cell(percent: float, bar: str) -> str:
        return f"{percent:8.2f} % {bar:{BAR_WIDTH}}"

    yield "".join((f"{'':4}", *(f"{p.upper():>9}{'':{BAR_WIDTH + 2}}" for p in PHASES))).rstrip()
    yield "".join(("THD ", *(cell(get[f"{quantity}_{p}_thd"], "") for p in PHASES))).rstrip()
    for order in orders:
        percents = [get[f"{quantity}_{p}_harmonic_{order}"] for p in PHASES]
        cells = [cell(percent, "█" * round(percent / greatest * BAR_WIDTH)) for percent in percents]
        yield f"{order:>3} {''.join(cells)}".rstrip()


def energies(get: dict[str, float]) -> Iterator[str]:
    """Energies and ratios."""
    yield from heading("Energies")
    yield f"active     {get['active_energy_total']:>13.3f} kWh"
    for kind in ("inductive", "capacitive"):
        ratio = get[f"{kind}_energy_ratio"]
        yield f"{kind:10} {get[f'{kind}_energy_total']:>13.3f} kvarh {ratio:>10.3f} % of the active energy"


def events(get: dict[str, float]) -> Iterator[str]:
    """The event log, the newest first."""
    yield from heading("Events")
    kinds = [int(get[f"event_{event}_kind"]) for event in range(1, 9)]
    if not any(kinds):
        yield "none"
    for event, kind in enumerate(kinds, start=1):
        if kind == 0:
            continue
        name = f"event_{event}"
        time = [int(get[f"{name}_{part}"]) for part in ("year", "month", "day", "hour", "minute", "second")]
        when = "20{:02}-{:02}-{:02} {:02}:{:02}:{:02}".format(*time)
        value = f"{get[f'{name}_value']:.3f} {EVENT_UNITS[kind]}" if EVENT_UNITS[kind] else ""
        number = int(get[f"{name}_phase"])
        phase = f"phase {'-ABC'[number]}" if number else ""
        yield f"{when}  {EVENTS[kind]:20} {value:>13}  {phase}".rstrip()


def main() -> int:
    """Prints the report of the relay that the command line names."""
    parser = argparse.ArgumentParser(description="Prints a report of a LogiCCon PFC24S-TCR.")
    parser.add_argument("port", help="serial port, such as /tmp/standin/line1")
    parser.add_argument("--unit", type=int, default=3, help="unit number (default: 3)")
    parser.add_argument("--baud", type=int, default=9600, help="speed of the line, with 8N2 (default: 9600)")
    parser.add_argument("--map", default="pfc.json", help="the exported register map (default: pfc.json)")
    args = parser.parse_args()
    try:
        with open(args.map, encoding="utf-8") as file:
            model = json.load(file)
    except (OSError, ValueError) as error:
        command = f"standin registers logiccon-pfc24s-tcr --format json > {args.map}"
        print(f"no map in {args.map} ({error}): {command}", file=sys.stderr)
        return 1
    with ModbusSerialClient(args.port, baudrate=args.baud, stopbits=2, timeout=1) as client:
        try:
            values = Relay(client, args.unit, model).read()
        except (ModbusException, OSError) as error:
            print(error, file=sys.stderr)
            return 1
    print("\n".join(report(f"{model['title']}, unit {args.unit}", values)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
