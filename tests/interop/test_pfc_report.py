"""scripts/pfc_report.py: a whole PFC24S-TCR read by its exported map and printed as a report."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable

from program import ROOT, Standin, binary

SCRIPT = ROOT / "scripts" / "pfc_report.py"

#: Thirteen steps of the factory, two of them fixed, on a grid with an overvoltage on C.
CONFIG = """
[clock]
start = "2017-04-26T13:51:14"
rate = 1.0

[[bus]]
name = "line1"
port = "pty:{dir}/line1"

[[bus.device]]
name = "panel"
model = "logiccon-pfc24s-tcr"
unit = 3
inputs = { load_active_a = 15, load_reactive_a = -1.25, load_reactive_b = 20, voltage_c = 261.5, thd_current = 12.5 }
registers = { compensation = 0, step_3_status = 1, step_3_connection = 4, step_13_status = 1, step_13_type = 0, \
overvoltage_action = 2, overvoltage_output = 2 }
"""


def report(bench: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Exports the map and runs the script with it."""
    exported = bench.dir / "pfc.json"
    command = [str(binary()), "registers", "logiccon-pfc24s-tcr", "--format", "json"]
    exported.write_bytes(subprocess.run(command, capture_output=True, check=True).stdout)
    command = [sys.executable, str(SCRIPT), bench.path("line1"), "--map", str(exported), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_map_that_is_not_there_is_told() -> None:
    command = [sys.executable, str(SCRIPT), "/tmp/none", "--map", "none.json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "standin registers logiccon-pfc24s-tcr --format json > none.json" in done.stderr
    assert "Traceback" not in done.stderr


def section(said: str, heading: str) -> list[str]:
    """The lines under a heading."""
    lines = said.splitlines()
    start = lines.index(heading) + 2
    return lines[start : lines.index("", start) if "" in lines[start:] else None]


def numbers(line: str) -> list[float]:
    """The numbers with a point in a line."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+", line)]


def test_pfc_10_and_pfc_16_the_report_shows_what_the_panel_does(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG, "--rate", "60")
    said = ""
    for _ in range(20):
        done = report(bench)
        assert done.returncode == 0, done.stdout + done.stderr
        said = done.stdout
        if "overvoltage" in said:
            break
    assert said.startswith("LogiCCon PFC24S-TCR power-factor relay, unit 3\n")

    # 2 kvar between B and C at √(230² + 261.5² + 230 · 261.5) = 425.945 V are 2 · (425.945 / 398)² = 2.2907, half on each.
    measured = section(said, "Measurements")
    by_name = {line[:16].strip(): numbers(line[16:]) for line in measured}
    assert by_name["voltage"] == [230.0, 230.0, 261.5]
    assert by_name["to next phase"] == [398.37, 425.94, 425.94]
    assert by_name["active power"] == [15.0, 20.0, 20.0, 55.0]
    assert by_name["reactive power"] == [-1.25, 18.855, 13.855, 31.459]
    assert by_name["power factor"] == [-0.997, 0.728, 0.822]
    assert "output 1 off, output 2 on, input 1 off, input 2 off" in measured

    steps = section(said, "Steps")
    assert len(steps) == 15, "a heading, thirteen steps, those that are not used"
    assert re.match(r"   3 ■ in     2\.00 kvar  capacitive B-C        fixed              1 ", steps[3])
    assert re.match(r"   1 □ out    1\.00 kvar  capacitive 3-phase    automatic          0       0\.000", steps[1])
    assert re.match(r"  13 ■ in     0\.00 kvar  inductive  3-phase    fixed              1 ", steps[13])
    assert steps[14].startswith("not used: 14, 15, 16")

    currents = section(said, "Harmonics of the currents")
    assert numbers(currents[1]) == [12.5, 12.5, 12.5]
    assert currents[2].split()[0] == "3" and currents[2].count("█" * 16) == 3
    assert [line.count("█") for line in currents[2:]] == sorted((line.count("█") for line in currents[2:]), reverse=True)
    # The root of the squares of all orders is the distortion.
    squares = sum(numbers(line)[0] ** 2 for line in currents[2:])
    assert abs(squares**0.5 - 12.5) < 0.02
    assert len(section(said, "Harmonics of the voltages")) == 17

    active, inductive = (numbers(line)[0] for line in section(said, "Energies")[:2])
    assert active > 0 and abs(inductive / active - 31.459 / 55.0) < 0.01
    assert section(said, "Events") == ["2017-04-26 13:51:15  overvoltage              261.500 V  phase C"]


def test_pfc_17_a_quiet_panel_has_no_events(standin: Callable[..., Standin]) -> None:
    done = report(standin(CONFIG.replace("overvoltage_action = 2", "overvoltage_action = 0")))
    assert done.returncode == 0, done.stdout + done.stderr
    assert section(done.stdout, "Events") == ["none"]


def test_bus_2_a_relay_that_does_not_answer_is_told(standin: Callable[..., Standin]) -> None:
    done = report(standin(CONFIG), "--unit", "5")
    assert done.returncode == 1
    assert "No response" in done.stderr
