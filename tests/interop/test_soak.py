"""A short run of scripts/soak: 247 devices on a bus and 15 buses more, in random requests."""

from __future__ import annotations

import subprocess
import sys

import pytest

from program import ROOT, binary


@pytest.mark.timeout(180)
def test_bus_8_random_requests_on_sixteen_buses() -> None:
    command = [sys.executable, str(ROOT / "scripts" / "soak"), "--minutes", "0.1", "--standin", str(binary())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=170, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "every reply as the map says, none lost, both runs alike, memory flat"
