"""The fixtures: `standin`, and `standin_factory` for tests that bring their own configuration."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Protocol

import pytest

from .bench import Bench
from .config import ConfigError
from .process import Process, StartError

_PROCESSES = pytest.StashKey[list[Process]]()

#: Requests that the report of a failed test shows.
_SHOWN = 20


class StandinFactory(Protocol):
    """Starts a bench for the test; it ends with the test."""

    def __call__(self, config: str | Path | None = None, *options: str) -> Bench:
        """Starts the configuration: TOML text, the path of a file, or nothing for the project's own.

        `options` are options of `standin run`, such as `"--rate", "0"` or `"--state", str(tmp_path)`.
        """
        ...


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("standin", "simulated Modbus field devices")
    group.addoption("--standin-config", metavar="FILE", help="devices.toml of the fixture standin")
    group.addoption("--standin-binary", metavar="FILE", help="the program; else STANDIN_BIN, else standin on the PATH")
    parser.addini("standin_config", "devices.toml of the fixture standin, relative to the ini file", type="string")
    parser.addini("standin_binary", "the program", type="string")


def _setting(config: pytest.Config, name: str) -> str | None:
    """An option, else the ini key of that name with paths relative to the ini file."""
    option = config.getoption(name)
    if option:
        return str(option)
    ini = str(config.getini(name))
    if not ini:
        return None
    base = config.inipath.parent if config.inipath else config.rootpath
    return str(base / ini)


def _binary(config: pytest.Config) -> str:
    return _setting(config, "standin_binary") or os.environ.get("STANDIN_BIN") or "standin"


def _configuration(given: str | Path | None, config: pytest.Config) -> tuple[str, str, Path]:
    """Name, text and folder of what is to be run."""
    if isinstance(given, str) and ("\n" in given or "[" in given):
        return "the TOML text of the test", given, config.rootpath
    path = given or _setting(config, "standin_config")
    if path is None:
        raise StartError("no configuration: give standin_factory one, or set standin_config in the ini file")
    try:
        return str(path), Path(path).read_text(encoding="utf-8"), Path(path).resolve().parent
    except OSError as error:
        raise StartError(f"{path}: {error.strerror}") from None


@pytest.fixture
def standin_factory(request: pytest.FixtureRequest) -> Iterator[StandinFactory]:
    """Starts benches for the test: `standin_factory(toml_text)`."""
    running: list[Process] = []
    request.node.stash[_PROCESSES] = running
    settings = request.config

    def start(config: str | Path | None = None, *options: str) -> Bench:
        __tracebackhide__ = True
        try:
            name, text, folder = _configuration(config, settings)
            running.append(Process(_binary(settings), name, text, folder, list(options)))
        except (StartError, ConfigError) as error:
            pytest.fail(str(error), pytrace=False)
        return running[-1].bench

    yield start
    for process in reversed(running):
        process.stop()


@pytest.fixture
def standin(standin_factory: StandinFactory) -> Bench:
    """A fresh bench of the project's devices.toml, for this test alone."""
    return standin_factory()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Shows with a failed test what it asked the devices last, and what they said."""
    report = yield
    if report.when == "call" and report.failed:
        for process in item.stash.get(_PROCESSES, []):
            report.sections.append(("standin journal", _journal(process.bench)))
            log = process.log()
            if log:
                report.sections.append(("standin log", log))
    return report


def _journal(bench: Bench) -> str:
    try:
        entries = bench.journal(limit=_SHOWN)
    except Exception as error:  # The program may be what has failed.
        return f"cannot be read: {error}"
    if not entries:
        return "nothing was asked"
    lines = []
    for entry in entries:
        span = "" if entry["address"] is None else f" {entry['address']}+{entry['quantity']}"
        code = f" {entry['code']:02}" if entry["code"] else ""
        who = entry["device"] or f"unit {entry['unit']}"
        lines.append(f"{entry['now']} {who}: {entry['function_name']}{span}: {entry['outcome']}{code}")
        notes = [entry["reason"], entry["hint"] and f"hint: {entry['hint']}"]
        notes += [f"fault {fault['id']}: {fault['kind']}" for fault in entry["faults"]]
        lines.extend(f"    {note}" for note in notes if note)
    return "\n".join(lines)
