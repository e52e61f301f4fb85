"""scripts/read_everything.py reads every register of every device, by the names of the exported map."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from clients import open_client
from program import ROOT, Standin, binary
from tables import HEATER, HOLDING, TRC

SCRIPT = ROOT / "scripts" / "read_everything.py"

#: How many registers and bits the manuals' tables have, by the heading that the script prints.
#: Astro: 8 at 0000 less the second word of the product code, 7 at 0010, 8 at 0020, 12 at 0030, 14 at 0040, 9 at 0050,
#: 4 at 0060, 7 at 0070, 14 at 0080, 2 at 0090, 2 at 00A0.
COUNTS = {"yard": 7 + 7 + 8 + 12 + 14 + 9 + 4 + 7 + 14 + 2 + 2, "charger": 11 + 12 + 5, "heater": 41 + 2 + 2 + 7}


def run(four: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Runs the script on the bench's own devices.toml."""
    command = [sys.executable, str(SCRIPT), str(four.dir / "devices.toml"), "--standin", str(binary()), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def blocks(text: str) -> dict[str, dict[str, str]]:
    """What the script printed: by device, by register name, the value."""
    found: dict[str, dict[str, str]] = {}
    for block in text.strip().split("\n\n"):
        head, *lines = block.splitlines()
        values = (re.fullmatch(r"\s*(\w+)\s+(\d+) ([0-9A-F]{4})\s+(\S+)\s+(.+?)  ([0-9A-F ]+)", line) for line in lines)
        rows = [each for each in values if each]
        assert len(rows) == len(lines), block
        assert all(int(each[2]) == int(each[3], 16) for each in rows)
        found[head.split(":")[0]] = {each[4]: each[5] for each in rows}
    return found


def test_bus_11_every_register_is_read_by_name(four: Standin) -> None:
    done = run(four)
    assert done.returncode == 0, done.stdout + done.stderr
    found = blocks(done.stdout)
    assert list(found) == ["yard", "panel", "heater", "charger"]
    for name, count in COUNTS.items():
        assert len(found[name]) == count, name
    assert found["yard"]["product_code"] == "88294"
    assert found["yard"]["rtc_year"] == "14"
    assert found["yard"]["utc_offset_minutes"] == "120 min"
    assert found["charger"]["ac_voltage"] == "230 V"
    assert found["charger"]["charge_voltage_limit"] == "27.5 V"
    assert found["charger"]["relay3_battery_contactor"] == "1"
    assert found["heater"]["zone_temperature_actual"].startswith("20.00 ")
    assert found["panel"]["voltage_ab"] == "398.37 V"
    assert found["panel"]["power_factor_a"] == "0.800"
    assert found["panel"]["step_1_type"] == "1"


def test_pfc_4_negative_values_are_decoded(four: Standin) -> None:
    client = open_client("pymodbus", four.path("line1"))
    client.write(HEATER, HOLDING, 3, 0x10000 - 250)
    client.write(TRC, HOLDING, 10, 55)
    client.close()
    done = run(four, "--bank", "holding")
    found = blocks(done.stdout)
    assert found["heater"]["ntc_1_correct"].startswith("-2.50")
    assert found["charger"]["fan_on_temperature"] == "55 °C"


def test_bus_2_a_device_that_does_not_answer_is_told(four: Standin) -> None:
    config = four.dir / "devices.toml"
    config.write_text(config.read_text().replace("unit = 4", "unit = 44"))
    done = run(four, "--device", "charger")
    assert done.returncode == 1
    assert "No response" in done.stderr
    assert Path(four.path("line1")).exists()


def test_a_file_that_is_not_there_is_told() -> None:
    command = [sys.executable, str(SCRIPT), "none.toml", "--standin", str(binary())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.startswith("none.toml: ")) == (1, True)
