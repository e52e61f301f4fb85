"""docs/testing.md, tried as it is written: its files, its commands, their output."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from conftest import ROOT

PAGE = ROOT / "docs" / "testing.md"


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its title, its text."""

    language: str
    title: str
    text: str


def blocks() -> list[Block]:
    fence = re.compile(r'^```(\w+)(?: title="([^"]*)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
    found = [Block(*match.groups(default="")) for match in fence.finditer(PAGE.read_text(encoding="utf-8"))]
    assert len(found) > 20
    return found


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
        return port


@pytest.fixture
def environment(binary: str, tmp_path: Path) -> dict[str, str]:
    """A shell in which `standin` is the program under test, and `pytest` that of these tests."""
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "standin").symlink_to(binary)
    return {**os.environ, "PATH": f"{tools}:{Path(sys.executable).parent}:{os.environ['PATH']}"}


def test_the_page_does_what_it_says(tmp_path: Path, environment: dict[str, str]) -> None:
    folder, control = tmp_path / "project", f"127.0.0.1:{free_port()}"
    folder.mkdir()
    environment["STANDIN_URL"] = f"http://{control}"

    def own(text: str) -> str:
        return text.replace("/tmp/standin/", f"{tmp_path}/").replace("127.0.0.1:8502", control)

    in_background: list[subprocess.Popen[bytes]] = []
    said = ""
    try:
        for block in blocks():
            if block.language == "text":
                assert said == block.text
            elif block.language in ("toml", "ini", "python"):
                assert block.title, block.text
                (folder / block.title).write_text(own(block.text), encoding="utf-8")
            elif block.title == "terminal 1":
                in_background.append(subprocess.Popen(["bash", "-c", f"exec {block.text}"], cwd=folder, env=environment))
                wait_for(control)
            elif block.language == "sh" and block.title != "install":
                result = subprocess.run(
                    ["bash", "-ec", own(block.text)], cwd=folder, env=environment, capture_output=True, text=True
                )
                assert result.returncode == 0, f"{block.text}\n{result.stdout}\n{result.stderr}"
                said = result.stdout
                if "pytest" in block.text:
                    assert "9 passed" in said, said
    finally:
        for process in in_background:
            process.terminate()
            process.wait()


def wait_for(address: str) -> None:
    host, port = address.split(":")
    for _ in range(200):
        try:
            socket.create_connection((host, int(port))).close()
            return
        except OSError:
            time.sleep(0.05)
    raise AssertionError(f"nobody listens at {address}")


def test_it_is_installed_as_the_page_says(tmp_path: Path) -> None:
    [install] = [block.text.splitlines() for block in blocks() if block.title == "install"]
    assert install == ["cargo install --path .", "pip install ./scripts/pytest-standin"]
    # Built as the tests' own program is, so that nothing has to be built twice.
    target = os.environ.get("CARGO_TARGET_DIR", str(ROOT / "target"))
    cargo = [*install[0].split(), "--debug", "--locked", "--root", str(tmp_path), "--target-dir", target]
    subprocess.run(cargo, cwd=ROOT, check=True)
    shown = subprocess.run([tmp_path / "bin" / "standin", "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout.startswith("standin ")
    pip = [sys.executable, "-m", *install[1].split(), "--no-deps", "--no-build-isolation", "--target", str(tmp_path / "site")]
    subprocess.run(pip, cwd=ROOT, check=True)
    assert (tmp_path / "site" / "pytest_standin" / "py.typed").exists()


def test_the_ci_job_runs_what_was_tried() -> None:
    every = blocks()
    [job] = [block.text for block in every if block.language == "yaml"]
    tried = {line for block in every if block.language == "sh" for line in block.text.splitlines()}
    runs = re.findall(r"run: (.*)", job)
    assert len(runs) == 4
    assert set(runs) - tried == {"pip install pymodbus pyserial"}, "what these tests are installed with"
