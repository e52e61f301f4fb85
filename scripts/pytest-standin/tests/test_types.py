"""The plugin is typed, and says so to those who use it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def mypy(*args: str, cwd: Path = PACKAGE) -> str:
    command = [sys.executable, "-m", "mypy", "--no-incremental", "--cache-dir=/dev/null", *args]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True).stdout


def test_the_plugin_has_no_type_errors() -> None:
    assert "Success" in mypy("--strict", "src")


def test_a_user_of_the_plugin_sees_its_types(tmp_path: Path) -> None:
    (tmp_path / "test_user.py").write_text(
        "from pytest_standin import Bench\n\n\n"
        "def test_it(standin: Bench) -> None:\n"
        "    reveal_type(standin.clock.now)\n"
        "    standin.port(1)\n"
    )
    said = mypy("--strict", "test_user.py", cwd=tmp_path)
    assert "datetime.datetime" in said
    assert 'incompatible type "int"' in said
