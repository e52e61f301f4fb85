"""The fixtures: `standin`, and `standin_factory` for tests that bring their own configuration."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import pytest

from .bench import Bench
from .config import ConfigError
from .process import Process, StartError

#: What runs now, for the report of a test that fails.
_RUNNING = pytest.StashKey[list[Process]]()

#: Requests that the report of a failed test shows.
_SHOWN = 20


class StandinFactory(Protocol):
    """Starts a bench; it ends with the test, and that of a wider factory with its module or the session."""

    def __call__(self, config: str | Path | None = None, *options: str) -> Bench:
        """Starts the configuration: TOML text, the path of a file, or nothing for the project's own.

        `options` are options of `standin run`, such as `"--rate", "0"` or `"--state", str(tmp_path)`.
        """
        ...


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("standin", "simulated Modbus field devices")
    group.addoption("--standin-config", metavar="FILE", help="devices.toml of the fixture standin")
    group.addoption("--standin-binary", metavar="FILE", help="the program; else STANDIN_BIN, else standin on the PATH")
    about = "devices.toml of the fixture standin, relative to the ini file"
    parser.addini("standin_config", about, type="string", default="")
    about = "the program: a name on the PATH, or a path relative to the ini file"
    parser.addini("standin_binary", about, type="string", default="")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_RUNNING] = []


def _setting(config: pytest.Config, name: str) -> tuple[str, Path] | None:
    """An option, else the ini key of that name, and the folder that a path in it is relative to."""
    option = config.getoption(name)
    if option:
        return str(option), config.invocation_params.dir
    ini = str(config.getini(name))
    if not ini:
        return None
    return ini, config.inipath.parent if config.inipath else config.rootpath


def _binary(config: pytest.Config) -> str:
    """A name that the PATH is searched for, or an absolute path: the program starts in the configuration's folder."""
    of_environment = os.environ.get("STANDIN_BIN")
    fallback = (of_environment or "standin", config.invocation_params.dir)
    name, folder = _setting(config, "standin_binary") or fallback
    return str(folder / name) if os.sep in name else name


def _configuration(given: str | Path | None, config: pytest.Config) -> tuple[str, str, Path]:
    """Name, text and folder of what is to be run."""
    if isinstance(given, str) and ("\n" in given or "[" in given):
        return "the TOML text of the test", given, config.rootpath
    setting = (str(given), Path()) if given else _setting(config, "standin_config")
    if setting is None:
        raise StartError("no configuration: give standin_factory one, or set standin_config in the ini file")
    name, folder = setting
    path = folder / name
    try:
        return name, path.read_text(encoding="utf-8"), path.resolve().parent
    except UnicodeDecodeError:
        raise StartError(f"{name}: not UTF-8") from None
    except OSError as error:
        raise StartError(f"{name}: {error.strerror}") from None


def _started(config: str | Path | None, options: tuple[str, ...], settings: pytest.Config) -> Process | str:
    """The program at work, or why it is not."""
    try:
        name, text, folder = _configuration(config, settings)
        return Process(_binary(settings), name, text, folder, list(options))
    except (StartError, ConfigError) as error:
        return str(error)


@contextmanager
def _factory(settings: pytest.Config) -> Iterator[StandinFactory]:
    """A factory whose benches end with the block."""
    running: list[Process] = []

    def start(config: str | Path | None = None, *options: str) -> Bench:
        __tracebackhide__ = True
        process = _started(config, options, settings)
        if isinstance(process, str):
            pytest.fail(process, pytrace=False)
        running.append(process)
        settings.stash[_RUNNING].append(process)
        return process.bench

    try:
        yield start
    finally:
        for process in reversed(running):
            settings.stash[_RUNNING].remove(process)
            process.stop()


@pytest.fixture
def standin_factory(pytestconfig: pytest.Config) -> Iterator[StandinFactory]:
    """Starts benches for the test: `standin_factory(toml_text)`."""
    with _factory(pytestconfig) as start:
        yield start


@pytest.fixture(scope="module")
def standin_module_factory(pytestconfig: pytest.Config) -> Iterator[StandinFactory]:
    """Starts benches for a module, in a module's fixture of your own; call their `reset()` between tests."""
    with _factory(pytestconfig) as start:
        yield start


@pytest.fixture(scope="session")
def standin_session_factory(pytestconfig: pytest.Config) -> Iterator[StandinFactory]:
    """Starts benches for all tests, in a session's fixture of your own; call their `reset()` between tests."""
    with _factory(pytestconfig) as start:
        yield start


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
    if report.when in ("setup", "call") and report.failed:
        for process in item.config.stash[_RUNNING]:
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
