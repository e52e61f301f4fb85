"""The control interface against its own description (CTL-3): schemathesis makes calls from it, right and wrong ones.

Bounded and seeded. `/api/events` never ends and is left out, and so is `PATCH /api/clock`, which would live through
centuries. That what is right is accepted is not asked where it depends on the devices: on their names, on the fields
of a fault's kind.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import pytest

from program import Standin

BENCH = """
[clock]
start = "2014-10-31T15:00:00"
[control]
listen = "127.0.0.1:0"
token = "correct-horse-battery-staple"
[[bus]]
name = "line1"
port = "tcp:127.0.0.1:0"
[[bus.device]]
name = "yard"
model = "kael-astro-01"
unit = 1
[[bus.device]]
name = "charger"
model = "logiccon-trc"
unit = 5
"""

LEFT_OUT = ["--exclude-path", "/api/events", "--exclude-operation-id", "change_clock"]

#: Calls whose bodies or paths depend on the devices.
DEPENDING = ["add_fault", "set_inputs", "write_registers", "keep_snapshot", "journal", "journal_count"]


def schemathesis(bench: Standin, *args: str) -> str:
    command = [
        sys.executable, "-m", "schemathesis.cli", "run", f"{bench.report['control']}/api/openapi.json",
        "--header", "Authorization: Bearer correct-horse-battery-staple", "--seed", "2014", "--max-examples", "10",
        "--request-timeout", "20", "--generation-database", "none", "--no-color", *LEFT_OUT, *args,
    ]  # fmt: skip
    result = subprocess.run(command, cwd=bench.dir, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.timeout(300)
def test_ctl_3_it_answers_as_it_is_described(standin: Callable[..., Standin]) -> None:
    said = schemathesis(standin(BENCH), "--checks", "all", "--exclude-checks", "positive_data_acceptance")
    assert " generated, " in said and " failed" not in said, said


@pytest.mark.timeout(300)
def test_ctl_3_it_takes_what_it_describes(standin: Callable[..., Standin]) -> None:
    excluded = [word for name in DEPENDING for word in ("--exclude-operation-id", name)]
    said = schemathesis(standin(BENCH), "--checks", "positive_data_acceptance,not_a_server_error", *excluded)
    assert " generated, " in said and " failed" not in said, said
