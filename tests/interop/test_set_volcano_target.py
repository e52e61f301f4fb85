"""scripts/set_volcano_target.py: what it says of a target that is set, rounded or refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

from program import ROOT, Standin

SCRIPT = ROOT / "scripts" / "set_volcano_target.py"

CONFIG = """
[clock]
rate = 0

[[bus]]
name = "line1"
port = "pty:{dir}/line1"

[[bus.device]]
name = "heater"
model = "hmi-volcano-ec"
unit = 4
registers = { zone_mode = 1, zone_fan_speed = 60 }
"""


def run(bench: Standin, *args: str) -> tuple[int, str, str]:
    """Runs the script against a bench: exit status, stdout, stderr."""
    command = [sys.executable, str(SCRIPT), bench.path("line1"), *args]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stdout, done.stderr


def test_vol_10_what_is_set_and_what_is_rounded(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    room = "room 20.00 °C, always at work, heating, fan 6.00 V\n"
    assert run(bench, "21.5") == (0, f"target 21.50 °C\n{room}", "")
    rounded = "target 22.00 °C, 22.34 was asked for: it is rounded down to half a degree\n"
    assert run(bench, "22.34") == (0, rounded + room, "")
    assert run(bench, "15") == (0, "target 15.00 °C\nroom 20.00 °C, always at work, valves shut, fan 0.00 V\n", "")


def test_vol_10_what_is_refused(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("zone_mode = 1", "zone_mode = 1, zone_temperature_max = 3000"))
    told = "refused: 30.50 °C is no target, the device takes 5.00 to 30.00 °C (registers 26 and 27)\n"
    assert run(bench, "30.5") == (1, "", told)
    assert run(bench, "30")[0] == 0


def test_vol_30_in_fahrenheit(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("zone_mode = 1", "zone_mode = 1, temp_unit = 1"))
    assert run(bench, "70") == (0, "target 70.00 °F\nroom 68.00 °F, always at work, heating, fan 6.00 V\n", "")
    told = "refused: 22.00 °F is no target, the device takes 41.00 to 104.00 °F (registers 26 and 27)\n"
    assert run(bench, "22") == (1, "", told)


def test_vol_46_and_vol_48_why_nothing_happens(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG.replace("zone_mode = 1", "power_on_off = 0"))
    told = "target 25.00 °C\nroom 20.00 °C, switched off (coil 2), valves shut, fan 0.00 V\n"
    assert run(bench, "25") == (0, told, "")
    bench = standin(CONFIG + "inputs = { ntc_1_fault = true }\n")
    told = "target 25.00 °C\nits sensor is broken, always at work, valves shut, fan 0.00 V\n"
    assert run(bench, "25") == (0, told, "")


def test_bus_2_a_bad_number_and_a_silent_unit(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    status, _, said = run(bench, "700")
    assert status == 2 and "700 is not 0 to 655.35" in said
    status, _, said = run(bench, "21", "--unit", "5")
    assert status == 1 and "No response" in said
