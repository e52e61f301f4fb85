"""Starts the built program and ends it."""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

#: How long the program may take until it is ready, and to end.
PATIENCE_S = 20.0


def binary() -> Path:
    """The program under test: STANDIN_BIN, or the debug build."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return Path(os.environ.get("STANDIN_BIN", target / "debug" / "standin")).absolute()


class Standin:
    """A running program and what it said when it was ready."""

    def __init__(self, toml: str, folder: Path, *args: str) -> None:
        self.dir = folder
        config = folder / "devices.toml"
        config.write_text(toml.replace("{dir}", str(folder)), encoding="utf-8")
        self._stderr = folder / "stderr.txt"
        command = [str(binary()), "run", str(config), "--json", "--exit-with-parent", *args]
        with self._stderr.open("wb") as stderr:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=stderr, cwd=folder
            )
        try:
            self.report: dict[str, Any] = self._ready()
        except BaseException:
            self.process.kill()
            self.process.wait()
            raise

    def _ready(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        pipe, said, end = self.process.stdout.fileno(), b"", time.monotonic() + PATIENCE_S
        while b"\n" not in said:
            readable, _, _ = select.select([pipe], [], [], max(0.0, end - time.monotonic()))
            more = os.read(pipe, 65536) if readable else b""
            if not more:
                code = self.process.poll()
                raise AssertionError(f"not ready (exit {code}); said {said!r} and on stderr:\n{self.stderr()}")
            said += more
        report: dict[str, Any] = json.loads(said.splitlines()[0])
        assert report["ready"] is True, report
        return report

    def path(self, bus: str) -> str:
        """The pty path of a bus."""
        found: list[str] = [each["path"] for each in self.report["buses"] if each["name"] == bus]
        return found[0]

    def stderr(self) -> str:
        """What it has said on stderr until now."""
        return self._stderr.read_text(encoding="utf-8", errors="replace")

    def stop(self) -> int:
        """Ends it as a service manager does; gives its exit status."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
                raise AssertionError(f"SIGTERM did not end it; stderr:\n{self.stderr()}") from None
        if self.process.stdout is not None:
            self.process.stdout.close()
        return self.process.returncode

    def settle(self) -> None:
        """Waits until it has heard of all that happened on its ports, a client's close among it.

        A client that opens a pty before that can meet what the last one left there: the kernel tells of a close at once,
        but the program has to be given the CPU to act on it.
        """
        time.sleep(0.05)
        end = time.monotonic() + PATIENCE_S
        while self._stat()[0] != "S":
            assert time.monotonic() < end, "it is never at rest"
            time.sleep(0.005)

    def _stat(self) -> list[str]:
        """The kernel's words on the process, from its state on."""
        return Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()

    def cpu_s(self) -> float:
        """CPU time that it has used, in seconds."""
        fields = self._stat()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def open_files(self) -> int:
        """How many descriptors it holds."""
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))
