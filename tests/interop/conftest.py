"""The fixtures of the interop tests: the program on a bench of its own, and the clients that talk to it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import tools
from clients import CLIENTS, Client, open_client
from program import Standin, binary
from tables import FOUR_DEVICES


@pytest.fixture
def standin() -> Iterator[Callable[..., Standin]]:
    """Starts the program: `standin(toml_text, *extra_args)`, with `{dir}` standing for a fresh folder."""
    if not binary().exists():
        pytest.fail(f"{binary()} is not there: run cargo build, or set STANDIN_BIN")
    running: list[Standin] = []
    folders: list[Path] = []

    def start(toml: str, *args: str) -> Standin:
        folder = Path(tempfile.mkdtemp(prefix="standin-"))
        folders.append(folder)
        bench = Standin(toml, folder, *args)
        running.append(bench)
        return bench

    yield start
    try:
        codes = [bench.stop() for bench in running]
        assert not any(codes), f"exit status {codes}; stderr:\n" + "\n".join(bench.stderr() for bench in running)
    finally:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def four(standin: Callable[..., Standin]) -> Standin:
    """The four devices on one bus, `line1`, while their clock stands still."""
    return standin(FOUR_DEVICES)


@pytest.fixture(params=CLIENTS)
def client(request: pytest.FixtureRequest, four: Standin) -> Iterator[Client]:
    """Every client in turn, on the bus with the four devices."""
    if request.param == "mbpoll":
        tools.need("mbpoll")
    client = open_client(request.param, four.path("line1"))
    yield client
    client.close()
