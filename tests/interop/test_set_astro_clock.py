"""scripts/set_astro_clock.py: the clock of an Astro, set with one write."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timedelta

from program import ROOT, Standin

SCRIPT = ROOT / "scripts" / "set_astro_clock.py"

# On 31 October, so that single writes in any order could be refused.
CONFIG = """
[clock]
start = "2014-10-31T23:59:00"
rate = 0.0

[[bus]]
name = "line1"
port = "pty:{dir}/line1"

[[bus.device]]
name = "yard"
model = "kael-astro-01"
unit = 1
"""


def run(bench: Standin, *args: str) -> subprocess.CompletedProcess[str]:
    """Runs the script against a bench."""
    command = [sys.executable, str(SCRIPT), bench.path("line1"), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_astro_13_a_date_that_single_writes_could_not_reach(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    done = run(bench, "--to", "2016-02-29T01:02:03")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "before: 2014-10-31 23:59:00 Friday\nafter:  2016-02-29 01:02:03 Monday\n"


def test_astro_10_this_computers_time(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    began = datetime.now().replace(microsecond=0)
    done = run(bench)
    assert done.returncode == 0, done.stderr
    after = re.search(r"after:  (.{19}) (\w+)\n", done.stdout)
    assert after
    shown = datetime.fromisoformat(after[1])
    # The device's clock stands still, so it shows what was written.
    assert began <= shown <= datetime.now() + timedelta(seconds=1)
    assert after[2] == shown.strftime("%A")


def test_astro_11_what_is_refused_is_told(standin: Callable[..., Standin]) -> None:
    bench = standin(CONFIG)
    done = run(bench, "--to", "2100-01-01T00:00:00")
    assert done.returncode == 1
    assert "2000 to 2099" in done.stderr
    done = run(bench, "--unit", "2")
    assert done.returncode == 1
    assert "No response" in done.stderr
