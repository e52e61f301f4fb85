"""A running bench: its ports, devices, clock, faults and journal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timedelta
from difflib import get_close_matches
from typing import Any

from .client import Client, StandinError, segment

#: What registers, coils and inputs show.
Quantity = int | float | bool


class Bench:
    """A running program. Made by the fixtures `standin` and `standin_factory`, which also end it."""

    def __init__(self, report: Mapping[str, Any], client: Client) -> None:
        self._report = report
        self._client = client
        #: The faults that may still be there, and those that were when a snapshot was kept. A reset or a restore gives
        #: their numbers to others.
        self._faults: list[Fault] = []
        self._kept: dict[str, list[Fault]] = {}
        #: Simulated time.
        self.clock = Clock(client)

    @property
    def url(self) -> str:
        """Where the control interface is, for other tools."""
        return self._client.url

    @property
    def buses(self) -> list[str]:
        """The names of the buses."""
        return [bus["name"] for bus in self._report["buses"]]

    def port(self, bus: str | None = None) -> str:
        """What a client opens to reach a bus: the path of a pty, or host and port of a TCP port."""
        return str(self._bus(bus)["path"])

    def ports(self, bus: str | None = None) -> list[str]:
        """All doors to a bus, in the order of devices.toml."""
        return [str(port["path"]) for port in self._bus(bus)["ports"]]

    def _bus(self, name: str | None) -> Mapping[str, Any]:
        buses: list[Mapping[str, Any]] = self._report["buses"]
        if name is None:
            if len(buses) > 1:
                raise LookupError(f"there are several buses, name one of {', '.join(self.buses)}")
            return buses[0]
        for bus in buses:
            if bus["name"] == name:
                return bus
        raise LookupError(f"there is no bus {name}; there is {', '.join(self.buses)}")

    def device(self, name: str) -> Device:
        """A device by its name."""
        for bus in self._report["buses"]:
            for device in bus["devices"]:
                if device["name"] == name:
                    return Device(self._client, name, bus["name"])
        known = ", ".join(device["name"] for bus in self._report["buses"] for device in bus["devices"])
        raise LookupError(f"there is no device {name}; there is {known}")

    @contextmanager
    def fault(
        self, kind: str, *, bus: str | None = None, device: str | Device | None = None, **fields: Any
    ) -> Iterator[Fault]:
        """Makes something go wrong while the block runs: `with standin.fault("drop", device="charger", count=2):`.

        The fields are those of `POST /api/faults`. The bus is that of the device, or the only one.
        """
        fault = self.add_fault(kind, bus=bus, device=device, **fields)
        try:
            yield fault
        finally:
            fault.remove()

    def add_fault(
        self, kind: str, *, bus: str | None = None, device: str | Device | None = None, **fields: Any
    ) -> Fault:
        """Makes something go wrong until it is spent, removed, or the bench ends."""
        if isinstance(device, str):
            device = self.device(device)
        if bus is None:
            bus = device.bus if device is not None else self._bus(None)["name"]
        plan = {"kind": kind, "bus": bus, **fields}
        if device is not None:
            plan["device"] = device.name
        fault = Fault(self._client, self._client.call("POST", "/api/faults", plan))
        self._faults.append(fault)
        return fault

    def clear_faults(self) -> None:
        """Takes all faults away."""
        with self._leaving([]):
            self._client.call("DELETE", "/api/faults")

    @contextmanager
    def _leaving(self, left: list[Fault]) -> Iterator[None]:
        """Around a call that takes faults away, all but those left: these go on showing what they were before."""
        going = [fault for fault in self._faults if fault not in left]
        for fault in going:
            fault.look()
        yield
        for fault in going:
            fault.forget()
        self._faults = [fault for fault in self._faults if fault in left]

    def journal(
        self,
        *,
        bus: str | None = None,
        device: str | None = None,
        function: int | None = None,
        outcome: str | None = None,
        address: int | None = None,
        since: float | None = None,
        limit: int | None = None,
    ) -> list[dict[str, Any]]:
        """What was asked and what came of it, the oldest first: the entries of `GET /api/journal`."""
        query = {
            "bus": bus, "device": device, "function": function, "outcome": outcome, "address": address,
            "since": since, "limit": limit,
        }  # fmt: skip
        entries: list[dict[str, Any]] = self._client.call("GET", "/api/journal", query=query)
        return entries

    def clear_journal(self) -> None:
        """Forgets what was asked until now."""
        self._client.call("DELETE", "/api/journal")

    def status(self) -> dict[str, Any]:
        """What runs, and what the buses have counted: `GET /api/status`."""
        status: dict[str, Any] = self._client.call("GET", "/api/status")
        return status

    def reset(self) -> None:
        """Back to how the program started."""
        with self._leaving([]):
            self._client.call("POST", "/api/reset")

    def snapshot(self, name: str) -> None:
        """Keeps everything as it is under a name."""
        self._client.call("POST", f"/api/snapshots/{segment(name)}")
        self._kept[name] = list(self._faults)

    def restore(self, name: str) -> None:
        """Brings back what was kept."""
        with self._leaving(self._kept.get(name, self._faults)):
            self._client.call("POST", f"/api/snapshots/{segment(name)}/restore")


class Clock:
    """Simulated time."""

    def __init__(self, client: Client) -> None:
        self._client = client

    @property
    def now(self) -> datetime:
        """Simulated local date and time."""
        return datetime.fromisoformat(self._client.call("GET", "/api/clock")["now"])

    @property
    def rate(self) -> float:
        """Simulated seconds a real second; set it to change it, to 0 to stop the clock."""
        return float(self._client.call("GET", "/api/clock")["rate"])

    @rate.setter
    def rate(self, rate: float) -> None:
        self._client.call("PATCH", "/api/clock", {"rate": rate})

    def advance(
        self, seconds: float = 0, *, minutes: float = 0, hours: float = 0, days: float = 0
    ) -> datetime:
        """Lets time pass; everything in between happens. Gives the time that it is then."""
        span = timedelta(seconds=seconds, minutes=minutes, hours=hours, days=days)
        return self._change(advance_s=span.total_seconds())

    def until(self, time: datetime | str) -> datetime:
        """Lets time pass until then; everything in between happens."""
        return self._change(until=_text(time))

    def jump(self, time: datetime | str) -> datetime:
        """Sets the time; nothing happens in between."""
        return self._change(now=_text(time))

    def _change(self, **change: Any) -> datetime:
        return datetime.fromisoformat(self._client.call("PATCH", "/api/clock", change)["now"])


def _text(time: datetime | str) -> str:
    return time.isoformat() if isinstance(time, datetime) else time


class Device:
    """A device on the bench, as its front panel and the world around it see it."""

    def __init__(self, client: Client, name: str, bus: str) -> None:
        self._client = client
        self._path = f"/api/devices/{segment(name)}"
        #: Its name.
        self.name = name
        #: The bus that it is on.
        self.bus = bus

    def state(self) -> dict[str, Any]:
        """All of it: `GET /api/devices/{name}`."""
        state: dict[str, Any] = self._client.call("GET", self._path)
        return state

    @property
    def unit(self) -> int:
        """The unit that it answers now."""
        return int(self.state()["unit"])

    @property
    def is_powered(self) -> bool:
        """Whether it has power."""
        return bool(self.state()["powered"])

    def get(self, name: str) -> Quantity:
        """What a register or coil shows, in its unit of measure; True or False for a coil.

        An input of the world where no register or coil has the name.
        """
        value: Quantity = self._reading(name, "registers", "coils", "inputs")["value"]
        return value

    def raw(self, name: str) -> int:
        """The number of a register or coil on the wire."""
        return int(self._reading(name, "registers", "coils")["raw"])

    def _reading(self, name: str, *groups: str) -> dict[str, Any]:
        state = self.state()
        for group in groups:
            if name in state[group]:
                reading: dict[str, Any] = state[group][name]
                return reading
        kinds = " or ".join(", ".join(group.removesuffix("s") for group in groups).rsplit(", ", 1))
        nearest = get_close_matches(name, [known for group in groups for known in state[group]], n=1)
        tip = f"; do you mean {nearest[0]}?" if nearest else f"; `standin registers {state['model']}` lists them"
        raise LookupError(f"{self.name} has no {kinds} {name}{tip}")

    def set(self, values: Mapping[str, int | bool] | None = None, /, **more: int | bool) -> None:
        """Writes registers and coils, raw numbers, as one write by the device's own rules, as from its front panel."""
        self._client.call("PATCH", f"{self._path}/registers", {**(values or {}), **more})

    def force(self, values: Mapping[str, int | bool] | None = None, /, **more: int | bool) -> None:
        """Sets registers whatever the device says, read-only ones too."""
        self._client.call("PATCH", f"{self._path}/registers", {**(values or {}), **more}, {"force": "true"})

    def inputs(self, values: Mapping[str, Quantity] | None = None, /, **more: Quantity) -> dict[str, Quantity]:
        """Changes the world that it measures, in engineering units, all or nothing; gives all inputs as they are then."""
        changes = {**(values or {}), **more}
        if changes:
            self._client.call("PATCH", f"{self._path}/inputs", changes)
        return {name: shown["value"] for name, shown in self.state()["inputs"].items()}

    def power(self, on: bool) -> None:
        """Puts its plug in, or pulls it."""
        self._client.call("POST", f"{self._path}/power", {"on": on})

    def restart(self) -> None:
        """Restarts it; it is silent for its boot_ms."""
        self._client.call("POST", f"{self._path}/restart")

    def factory_reset(self) -> None:
        """Returns it to its factory settings."""
        self._client.call("POST", f"{self._path}/factory-reset")


class Fault:
    """Something that goes wrong on purpose."""

    def __init__(self, client: Client, state: dict[str, Any]) -> None:
        self._client = client
        self._state = state
        self._is_gone = False

    @property
    def id(self) -> int:
        """Its number."""
        return int(self._state["id"])

    @property
    def hits(self) -> int:
        """How often it has hit, also after it was removed."""
        self.look()
        return int(self._state["hits"])

    @property
    def is_active(self) -> bool:
        """Whether it may still hit."""
        self.look()
        return not self._is_gone and bool(self._state["active"])

    def look(self) -> None:
        """Learns what it has done until now."""
        self._call("GET")

    def remove(self) -> None:
        """Takes it away; once is enough. A reset may have done so before."""
        self._call("DELETE")
        self.forget()

    def forget(self) -> None:
        """Stays as it was seen last: it is gone, and another may have its number."""
        self._is_gone = True

    def _call(self, method: str) -> None:
        if self._is_gone:
            return
        try:
            self._state = self._client.call(method, f"/api/faults/{self.id}")
        except StandinError as error:
            if error.status != 404:
                raise
            self.forget()
