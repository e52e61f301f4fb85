"""Starts the program and ends it. Nothing of it outlives the test process, however that ends."""

from __future__ import annotations

import itertools
import json
import os
import select
import subprocess
import tempfile
import time
from pathlib import Path
from typing import IO, Any

from .bench import Bench
from .client import Client
from .config import private

#: How long the program may take until it is ready, and to end.
PATIENCE_S = 30.0

_numbers = itertools.count(1)


class StartError(Exception):
    """The program does not start; the message is its own."""


class Process:
    """A running program, and the bench on it."""

    def __init__(self, binary: str, name: str, text: str, folder: Path, options: list[str]) -> None:
        number = next(_numbers)

        def pty_path(path: str) -> str:
            # No folder of our own: the program takes its link away, also when this process is killed.
            return str(Path(tempfile.gettempdir()) / f"standin-{os.getpid()}-{number}-{Path(path).name}")

        config = private(text, pty_path)
        self._stderr: IO[bytes] = tempfile.TemporaryFile()
        with tempfile.TemporaryFile() as file:
            file.write(config.text.encode())
            file.flush()
            # Read by its number, so that no file is left when this process is killed.
            own = f"/dev/fd/{file.fileno()}"
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            command = [binary, "run", own, "--json", "--exit-with-parent", "--listen", "127.0.0.1:0", *options]
            try:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=self._stderr,
                    cwd=folder,
                    pass_fds=[file.fileno()],
                )
            except FileNotFoundError:
                raise StartError(
                    f"there is no program {binary}: install standin, or name it by --standin-binary, the ini key "
                    "standin_binary or STANDIN_BIN"
                ) from None
            try:
                report = self._ready(own, name)
            except BaseException:
                self._process.kill()
                self._process.wait()
                raise
        self._client = Client(report["control"], config.token)
        #: What tests use.
        self.bench = Bench(report, self._client)

    def _ready(self, own: str, name: str) -> dict[str, Any]:
        assert self._process.stdout is not None
        pipe, said, end = self._process.stdout.fileno(), b"", time.monotonic() + PATIENCE_S
        while b"\n" not in said:
            readable, _, _ = select.select([pipe], [], [], max(0.0, end - time.monotonic()))
            more = os.read(pipe, 65536) if readable else b""
            if not more:
                raise StartError(f"standin does not start:\n{self.log()}".replace(own, name))
            said += more
        report: dict[str, Any] = json.loads(said.splitlines()[0])
        return report

    def log(self) -> str:
        """What it has said on stderr until now."""
        size = os.fstat(self._stderr.fileno()).st_size
        return os.pread(self._stderr.fileno(), size, 0).decode(errors="replace")

    def stop(self) -> None:
        """Ends it in order; takes it down where that does not help."""
        if hasattr(self, "_client"):
            self._client.close()
        self._process.terminate()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise
        finally:
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._stderr.close()
