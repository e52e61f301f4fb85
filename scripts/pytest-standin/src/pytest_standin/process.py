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
        self._links: list[Path] = []

        def pty_path(path: str) -> str:
            # No folder of our own: the program takes its link away, also when this process is killed.
            name = f"standin-{os.getpid()}-{number}.{len(self._links) + 1}-{Path(path).name}"
            self._links.append(Path(tempfile.gettempdir()) / name)
            return str(self._links[-1])

        config = private(text, folder, pty_path)
        self._name = name
        self._stderr: IO[bytes] = tempfile.TemporaryFile()
        with tempfile.TemporaryFile() as file:
            file.write(config.text.encode())
            file.flush()
            # Read by its number, so that no file is left when this process is killed.
            self._own = f"/dev/fd/{file.fileno()}"
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            command = [binary, "run", self._own, "--json", "--exit-with-parent", "--listen", "127.0.0.1:0", *options]
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
            except OSError as error:
                raise StartError(f"{binary} is no program that can be run: {error.strerror}") from None
            try:
                report = self._ready(binary)
            except BaseException:
                self._process.kill()
                self._process.wait()
                self._unlink()
                raise
        self._client = Client(report["control"], config.token)
        #: What tests use.
        self.bench = Bench(report, self._client)

    def _ready(self, binary: str) -> dict[str, Any]:
        assert self._process.stdout is not None
        pipe, said, end = self._process.stdout.fileno(), b"", time.monotonic() + PATIENCE_S
        while b"\n" not in said:
            readable, _, _ = select.select([pipe], [], [], max(0.0, end - time.monotonic()))
            more = os.read(pipe, 65536) if readable else b""
            if not more:
                raise StartError(f"standin does not start:\n{self.log() or f'{binary} said nothing'}")
            said += more
        try:
            report: dict[str, Any] = json.loads(said.splitlines()[0])
        except ValueError:
            raise StartError(f"{binary} is not standin: it said {said.decode(errors='replace')}") from None
        return report

    def log(self) -> str:
        """What it has said on stderr until now."""
        size = os.fstat(self._stderr.fileno()).st_size
        return os.pread(self._stderr.fileno(), size, 0).decode(errors="replace").replace(self._own, self._name)

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
            self._unlink()
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._stderr.close()

    def _unlink(self) -> None:
        """Takes away the links of a program that was killed; one that ended in order has done so itself."""
        for link in self._links:
            link.unlink(missing_ok=True)
