"""What the plugin's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]

#: A bus with a rectifier, a time switch and a room controller, while the clock stands still.
CONFIG = """
[clock]
start = "2014-10-31T15:00:00"
rate = 0.0

[[bus]]
name = "line1"
port = "pty:/tmp/standin-of-somebody/line1"

[[bus.device]]
name = "charger"
model = "logiccon-trc"
unit = 5

[[bus.device]]
name = "yard"
model = "kael-astro-01"
unit = 1

[[bus.device]]
name = "heater"
model = "hmi-volcano-ec"
unit = 7
"""


@pytest.fixture(scope="session")
def binary() -> str:
    """The program under test: STANDIN_BIN, or the debug build."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    path = Path(os.environ.get("STANDIN_BIN", target / "debug" / "standin")).absolute()
    if not path.exists():
        pytest.fail(f"{path} is not there: run cargo build, or set STANDIN_BIN")
    return str(path)


@pytest.fixture
def project(pytester: pytest.Pytester, binary: str, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A project that uses the plugin, with a devices.toml of its own."""
    monkeypatch.setenv("STANDIN_BIN", binary)
    pytester.makefile(".toml", devices=CONFIG)
    pytester.makeini("[pytest]\nstandin_config = devices.toml\n")
    pytester.makepyfile(
        modbus="""
        from pymodbus.client import ModbusSerialClient

        def connect(port):
            client = ModbusSerialClient(port, baudrate=9600, stopbits=2, timeout=1, retries=0)
            assert client.connect()
            return client
        """
    )
    return pytester


def passes(project: pytest.Pytester, source: str, *args: str, **outcomes: int) -> pytest.RunResult:
    """Tries a test in the project; it passes, or ends as the outcomes say."""
    project.makepyfile(source)
    result = project.runpytest_subprocess(*args)
    result.assert_outcomes(**(outcomes or {"passed": 1}))
    return result
