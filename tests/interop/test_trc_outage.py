"""scripts/trc_outage.py: an outage of two simulated hours over Modbus alone, and the charge after it."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

from pymodbus.client import ModbusSerialClient

from program import ROOT, Standin

SCRIPT = ROOT / "scripts" / "trc_outage.py"
CONFIG = (ROOT / "scripts" / "trc_outage.toml").read_text(encoding="utf-8").replace("/tmp/standin", "{dir}")

#: Simulated seconds a real one: the outage and three hours after it take ten seconds.
RATE = 1800

LINE = re.compile(r" *(\d+):(\d\d) +(\d+) V +([\d.]+) V +([\d.]+) A +([-+][\d.]+) A +([-+][\d.]+) Ah  (.*)")


class Line(NamedTuple):
    """A line of the script's table."""

    hours: float
    mains_v: int
    output_v: float
    load_a: float
    battery_a: float
    charge_ah: float
    relays: list[str]


def run(bench: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Runs the script against a bench."""
    command = [sys.executable, str(SCRIPT), bench.path("outage"), "--rate", str(RATE), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def lines(said: str) -> list[Line]:
    """The table of what the script said."""
    found = [LINE.fullmatch(each) for each in said.splitlines()[3:]]
    assert all(found), said
    return [
        Line(int(h) + int(m) / 60, int(mains), float(out), float(load), float(battery), float(charge), relays.split(", "))
        for h, m, mains, out, load, battery, charge, relays in (each.groups() for each in found if each)
    ]


def test_trc_10_an_outage_of_two_hours_and_the_charge_after_it(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG, "--rate", str(RATE))
    done = run(bench, "--step", "10")
    assert done.returncode == 0, done.stdout + done.stderr
    table = lines(done.stdout)
    during = [each for each in table if "AC high" in each.relays]
    after = table[len(during) :]
    assert table[: len(during)] == during and len(during) >= 12 and len(after) >= 17

    # A full battery is at 26.0 V; 2 A over 0.1 ohm leave 25.8 V. After 2 h 4 of 7 Ah are gone: 26 - 6 * 4 / 7 - 0.2 V.
    assert all(each.battery_a == -each.load_a == -2.0 for each in during)
    assert all(each.relays == ["alarm", "battery", "AC high"] for each in during)
    assert abs(during[0].output_v - 25.8) < 0.15
    assert abs(during[-1].output_v - 22.4) < 0.15
    assert all(later.output_v <= sooner.output_v for sooner, later in zip(during, during[1:]))
    assert abs(during[-1].charge_ah + 4) < 0.1

    # Constant current for 1 h 40 min, up to a charge of 0.9037; then constant voltage, and 0.1 A or less after 3 h.
    assert all(each.relays == ["battery"] and each.load_a == 2.0 for each in after)
    constant_current = [each for each in after if each.hours < 3.5]
    assert len(constant_current) >= 7 and all(each.battery_a == 2.0 for each in constant_current)
    constant_voltage = [each for each in after if each.hours > 3.8]
    assert len(constant_voltage) >= 6 and all(each.output_v == 27.5 for each in constant_voltage)
    currents = [each.battery_a for each in constant_voltage]
    assert currents == sorted(currents, reverse=True) and 0 < currents[0] < 2.0 and currents[-1] <= 0.1
    assert abs(after[-1].charge_ah) < 0.2

    # The limit is as it was.
    with ModbusSerialClient(bench.path("outage"), baudrate=9600, stopbits=2) as client:
        assert client.read_holding_registers(6, count=1, device_id=4).registers == [250]


def test_trc_13_mains_within_every_limit_are_told(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("ac_voltage = 240", "ac_voltage = 230"))
    done = run(bench)
    assert done.returncode == 1
    assert "mains of 230 V are within every limit" in done.stderr


def test_bus_2_a_charger_that_does_not_answer_is_told(standin: Callable[..., Standin]) -> None:
    done = run(standin(CONFIG), "--unit", "5")
    assert done.returncode == 1
    assert "No response" in done.stderr
