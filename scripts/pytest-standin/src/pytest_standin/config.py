"""Makes a devices.toml fit to run beside others: every pty and TCP port its own, memory its own."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


class ConfigError(Exception):
    """A configuration that cannot be run beside others."""


@dataclass(frozen=True)
class Private:
    """A configuration whose ports nobody else has."""

    text: str
    #: The token of its control interface, where it has one.
    token: str | None


def private(text: str, folder: Path, pty_path: Callable[[str], str]) -> Private:
    """The configuration with ports of its own; `pty_path` gives the path in place of one in the text.

    Serial ports stay what they are: they are hardware. `state` is taken out, so that every bench is fresh. `folder` is
    the one that its paths are relative to.
    """
    try:
        config = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        # The program says better what is wrong with it.
        return Private(text, None)
    for port in _ports(config):
        kind, _, rest = port.partition(":")
        if kind == "pty":
            text = _replaced(text, port, f"pty:{pty_path(rest)}")
        elif kind in ("tcp", "modbus-tcp"):
            text = _replaced(text, port, f"{kind}:127.0.0.1:0")
    if "state" in config:
        table = re.search(r"^[ \t]*\[", text, flags=re.MULTILINE)
        end = table.start() if table else len(text)
        text = re.sub(r"^[ \t]*state[ \t]*=.*$", "", text[:end], flags=re.MULTILINE) + text[end:]
        if "state" in tomllib.loads(text):
            raise ConfigError("state must stand on a line of its own, above the first table")
    return Private(text, _token(config, folder))


def _token(config: dict[str, Any], folder: Path) -> str | None:
    control = config.get("control")
    if not isinstance(control, dict):
        return None
    token, file = control.get("token"), control.get("token_file")
    if isinstance(file, str):
        try:
            return (folder / file).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError):
            # The program says better what is wrong with it.
            return None
    return token if isinstance(token, str) else None


def _ports(config: dict[str, Any]) -> list[str]:
    """Every port once, in the order of the file."""
    buses = config.get("bus")
    found: dict[str, None] = {}
    for bus in buses if isinstance(buses, list) else []:
        if isinstance(bus, dict):
            several = bus.get("ports")
            every = [bus.get("port"), *(several if isinstance(several, list) else [])]
            found.update((port, None) for port in every if isinstance(port, str))
    return list(found)


def _replaced(text: str, port: str, own: str) -> str:
    quoted = [f'"{port}"', f"'{port}'"]
    if not any(form in text for form in quoted):
        raise ConfigError(f"the port {port} must stand in plain quotes")
    for form in quoted:
        text = text.replace(form, f'"{own}"')
    return text

