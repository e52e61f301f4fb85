"""README.md, tried as it is written: the bench that it shows, its client, its commands and what they print."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from program import ROOT, Standin, binary

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The fenced blocks of a language, the last line's end included."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_the_readme_does_what_it_says(standin: Callable[..., Standin]) -> None:
    [options] = re.findall(r"^cargo run --release -- (.*)$", README, re.MULTILINE)
    options = options.replace("127.0.0.1:8502", "127.0.0.1:0").split()
    file = (ROOT / "devices.toml").read_text(encoding="utf-8")
    bench = standin(file.replace("pty:/tmp/standin/line1", "pty:{dir}/line1"), *options)

    [client] = blocks("python")
    client = client.replace("/tmp/standin/line1", bench.path("line1"))
    said = subprocess.run([sys.executable, "-c", client], capture_output=True, text=True, check=True).stdout
    clock, month, output, target = said.splitlines()
    # The clock starts where the options say, a Friday; a refused month; 27.4 V at rest; 22.34 °C rounds down.
    assert clock == "[14, 10, 31, 15, 0, 0, 5]"
    assert "exception_code=3" in month
    assert output == "[0, 274]"
    assert target.endswith("[2200]")

    tools = bench.dir / "bin"
    tools.mkdir()
    (tools / "standin").symlink_to(binary())
    environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "STANDIN_URL": bench.report["control"]}
    [session] = blocks("console")
    steps = re.findall(r"^\$ (.*)\n((?:[^$].*\n)*)", session, re.MULTILINE)
    assert len(steps) == 5
    for command, wanted in steps:
        done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        # How long an answer took is the machine's business.
        assert re.sub(r", \d+ ms$", ", 0 ms", done.stdout, flags=re.MULTILINE) == wanted


def test_the_readme_shows_the_start_report(tmp_path: Path) -> None:
    [shown] = re.findall(r"^\$ cargo run --release\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    config = tmp_path / "devices.toml"
    config.write_text((ROOT / "devices.toml").read_text(encoding="utf-8").replace("/tmp/standin", str(tmp_path)))
    with subprocess.Popen([binary(), "run", config], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = "".join(next(process.stdout) for _ in shown.splitlines())
        process.terminate()
    assert said.replace(str(tmp_path), "/tmp/standin") == shown
