"""scripts/astro_programs.py: the programs of an Astro, listed, added, changed and deleted by the handshake."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from pymodbus.client import ModbusSerialClient

from program import ROOT, Standin

SCRIPT = ROOT / "scripts" / "astro_programs.py"

CONFIG = """
[clock]
start = "2014-10-27T14:22:08"
rate = 0.0

[[bus]]
name = "line1"
port = "pty:{dir}/line1"

[[bus.device]]
name = "yard"
model = "MODEL"
unit = 3
"""

PRESETS = """\
  1: relay A on  at sunset        daily
  2: relay A off at sunrise       daily
  3: relay B on  at sunset        daily
  4: relay B off at 00:00:00      daily
"""


@pytest.fixture(params=[("kael-astro-01", 24), ("kael-astro-03", 100)])
def astro(request: pytest.FixtureRequest, standin: Callable[..., Standin]) -> tuple[Standin, int]:
    """Both models, with their capacity."""
    model, capacity = request.param
    return standin(CONFIG.replace("MODEL", model)), capacity


def run(bench: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Runs the script against a bench."""
    command = [sys.executable, str(SCRIPT), bench.path("line1"), "--unit", "3", *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def said(bench: Standin, *args: str) -> str:
    """What the script says when all goes well."""
    done = run(bench, *args)
    assert done.returncode == 0 and not done.stderr, done.stdout + done.stderr
    return done.stdout


def words(bench: Standin, address: int, count: int) -> list[int]:
    """Holding registers."""
    with ModbusSerialClient(bench.path("line1"), baudrate=9600, stopbits=2) as client:
        registers: list[int] = client.read_holding_registers(address, count=count, device_id=3).registers
        return registers


def write(bench: Standin, address: int, *values: int) -> Any:
    """Writes holding registers."""
    with ModbusSerialClient(bench.path("line1"), baudrate=9600, stopbits=2) as client:
        return client.write_registers(address, list(values), device_id=3)


def test_astro_61_to_70_a_program_is_listed_added_changed_and_deleted(astro: tuple[Standin, int]) -> None:
    bench, capacity = astro
    assert said(bench, "list") == f"{PRESETS}4 of {capacity} slots are taken\n"
    assert words(bench, 0x82, 1) == [0]

    assert said(bench, "add", "B", "on", "sunset-2:00", "mon-sat") == "added to slot 5\n"
    # The order is the last slot that was read. The manual's example 3, with ON for its OFF: settings 0b1001, offset -120, days 0b0011_1111.
    assert words(bench, 0x80, 14) == [capacity, 5, 1, 4, 2, 4, 5, 0b1001, 0, 0, 0, 0x10000 - 120, 0b0011_1111, 0]
    listed = said(bench, "list")
    assert "  5: relay B on  at sunset-2:00   mon,tue,wed,thu,fri,sat\n5 of" in listed

    assert said(bench, "change", "5", "A", "off", "15:22:16", "sat-mon") == "changed slot 5\n"
    assert words(bench, 0x83, 10) == [5, 2, 1, 5, 0b0100, 15, 22, 16, 0, 0b110_0001]
    assert "  5: relay A off at 15:22:16      mon,sat,sun\n" in said(bench, "list")

    # Read by hand with a slot in between that is empty.
    assert said(bench, "delete", "2") == "deleted slot 2\n"
    assert words(bench, 0x75, 1) == [4]
    assert said(bench, "add", "A", "off", "sunrise+0:15") == "added to slot 2\n"
    assert said(bench, "delete", "5") == "deleted slot 5\n"
    assert "  2: relay A off at sunrise+0:15  daily\n" in said(bench, "list")


def test_astro_61_to_64_the_tour_leaves_all_as_it_was(astro: tuple[Standin, int]) -> None:
    bench, capacity = astro
    listed = f"{PRESETS}4 of {capacity} slots are taken\n"
    assert said(bench, "tour") == (
        f"{listed}\n"
        "added       5: relay B on  at sunset-2:00   mon,tue,wed,thu,fri,sat\n"
        "changed     5: relay B on  at sunset-1:30   daily\n"
        "deleted     5\n\n"
        f"{listed}"
    )


def test_astro_62_64_failures_are_told(astro: tuple[Standin, int]) -> None:
    bench, capacity = astro
    done = run(bench, "change", "9", "A", "on", "12:00")
    assert done.returncode == 1
    assert done.stderr.endswith("slot 9 is empty, or the program is none (process_configuration 0x11)\n")
    done = run(bench, "delete", "9")
    assert done.returncode == 1
    assert done.stderr.endswith("slot 9 is empty (process_configuration 0x22)\n")
    for _ in range(capacity - 4):
        write(bench, 0x84, 1, 4)
        while words(bench, 0x84, 1) == [0]:
            pass
    done = run(bench, "add", "A", "on", "12:00")
    assert done.returncode == 1
    assert done.stderr.endswith("all slots are full, or the program is none (process_configuration 0x44)\n")
    done = run(bench, "delete", str(capacity + 1))
    assert done.returncode == 1
    assert "the device refuses" in done.stderr


def test_astro_67_a_process_of_someone_else_is_waited_for(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("MODEL", "kael-astro-01") + "options = { process_ms = 1000 }\n")
    assert not write(bench, 0x83, 2, 1, 8).isError()
    assert write(bench, 0x83, 1).exception_code == 4
    assert said(bench, "delete", "4") == "deleted slot 4\n"


@pytest.mark.parametrize(
    "words", [("A", "on", "25:00"), ("A", "on", "sunset-12:01"), ("A", "on", "noon"), ("A", "on", "12:00", "mon-day")]
)
def test_astro_60_what_is_no_program_is_told(words: tuple[str, ...], standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("MODEL", "kael-astro-01"))
    done = run(bench, "add", *words)
    assert done.returncode == 1
    assert words[-1].split("-")[-1] in done.stderr
    assert "4 of 24 slots" in said(bench, "list")
