"""scripts/volcano_day.py: a schedule and a target over Modbus, and the day that follows from them."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

from pymodbus.client import ModbusSerialClient

from program import ROOT, Standin

SCRIPT = ROOT / "scripts" / "volcano_day.py"
CONFIG = (ROOT / "scripts" / "volcano_day.toml").read_text(encoding="utf-8").replace("/tmp/standin", "{dir}")

#: Simulated seconds a real one: a day takes twelve seconds.
RATE = 7200

LINE = re.compile(r"\w+ (\d\d):(\d\d) +([-\d.]+) +([\d.]+)  ([.o|]+) +(\d+)% +([\d.]+) V  (.*)")


class Line(NamedTuple):
    """A line of the script's graph; time in hours."""

    hour: float
    room: float
    target: float
    graph: str
    valve: int
    fan: float
    schedule: str


def run(bench: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Runs the script against a bench."""
    command = [sys.executable, str(SCRIPT), bench.path("heating"), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def lines(said: str) -> list[Line]:
    """The graph of what the script said."""
    found = [each for each in map(LINE.fullmatch, said.splitlines()) if each]
    return [
        Line(int(h) + int(m) / 60, float(room), float(target), graph, int(valve), float(fan), schedule)
        for h, m, room, target, graph, valve, fan, schedule in (each.groups() for each in found)
    ]


def test_vol_44_and_vol_49_a_day_by_the_schedule(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG, "--rate", str(RATE))
    done = run(bench, "--target", "21", "--eco", "15")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "times as fast" in done.stdout
    day = lines(done.stdout)
    assert 48 <= len(day) <= 50, done.stdout
    assert all(line.target == 21.0 for line in day)
    assert all(set(line.graph) <= {".", "o", "|"} and "o" in line.graph for line in day)

    # The script's Monday: 6 to 9 and 16 to 22; half an hour at either end may fall to both sides.
    for line in day:
        if 0.5 <= line.hour < 5.5 or line.hour >= 22.5:
            assert line.schedule == "rest", line
        if 6.5 <= line.hour < 8.5:
            assert line.schedule == "period 1", line
        if 9.5 <= line.hour < 15.5:
            assert line.schedule == "pause", line
        if 16.5 <= line.hour < 21.5:
            assert line.schedule == "period 2", line

    # At work the room is between target - delta and the target, once it is warm (VOL-41).
    warm = [line for line in day if 7.5 <= line.hour < 9 or 17.5 <= line.hour < 22]
    assert len(warm) == 12 and all(20.45 <= line.room <= 21.05 for line in warm), done.stdout
    # On the way there the valve is open all the time and the fan runs hard (VOL-43).
    dawn = next(line for line in day if line.hour == 6)
    assert dawn.valve >= 80 and dawn.fan > 2, dawn
    # Outside the schedule nothing heats above the eco temperature, and the protection holds that (VOL-45).
    evening = [line for line in day if line.hour >= 22.5]
    assert all(line.valve == 0 and line.fan == 0 for line in evening), done.stdout
    assert all(later.room < sooner.room for sooner, later in zip(evening, evening[1:]))
    assert all(14.9 <= line.room for line in day), done.stdout
    assert any(line.valve > 0 for line in day if 9.5 <= line.hour < 15.5), done.stdout


def test_vol_30_a_controller_in_fahrenheit_is_put_into_celsius(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("inputs", "registers = { temp_unit = 1 }\ninputs"))
    done = run(bench, "--hours", "0.5")
    assert done.returncode == 0, done.stderr
    with ModbusSerialClient(bench.path("heating"), baudrate=9600, stopbits=2) as client:
        assert client.read_holding_registers(23, count=1, device_id=4).registers == [2100]


def test_vol_14_a_target_that_is_refused_is_told(standin: Callable[..., Standin]) -> None:
    done = run(standin(CONFIG), "--target", "50")
    assert done.returncode == 1
    assert "the controller refuses" in done.stderr


def test_vol_49_a_picture_or_the_way_to_one(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    picture = bench.dir / "day.png"
    done = run(bench, "--hours", "0.5", "--png", str(picture))
    if importlib.util.find_spec("matplotlib") is None:
        assert (done.returncode, done.stderr) == (1, "--png needs matplotlib: pip install matplotlib\n")
    else:
        assert done.returncode == 0 and picture.read_bytes().startswith(b"\x89PNG")
