"""What the journal hints at when a pymodbus beginner makes a beginner's mistakes (`control.md`, journal)."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusIOException

from program import Standin
from tables import FOUR_DEVICES, HEATER, NOBODY, PFC, TRC

Mistake = Callable[[ModbusSerialClient], Any]


def float_registers(order: str) -> list[int]:
    """22.5 °C as a float: 0x41B40000."""
    return ModbusSerialClient.convert_to_registers(22.5, ModbusSerialClient.DATATYPE.FLOAT32, word_order=order)  # type: ignore


MISTAKES: dict[str, tuple[Mistake, list[str]]] = {
    # The manual's list counts from 1: the twelfth and last setting is register 11.
    "off by one": (lambda client: client.read_holding_registers(12, device_id=TRC), ["holding 11 (fan_off_temperature)"]),
    "4xxxx numbering": (
        lambda client: client.read_holding_registers(40024, device_id=HEATER),
        ["holding register 23 (zone_temperature_target)"],
    ),
    "3xxxx numbering": (
        lambda client: client.read_input_registers(30003, count=2, device_id=TRC),
        ["input register 2 (output_voltage)"],
    ),
    "a setting read as an input": (
        lambda client: client.read_input_registers(23, device_id=HEATER),
        ["zone_temperature_target", "function 03"],
    ),
    "a coil read as a discrete input": (
        lambda client: client.read_discrete_inputs(1, device_id=TRC),
        ["relay2_fan", "function 01"],
    ),
    "a unit nobody has": (lambda client: client.read_holding_registers(0, device_id=NOBODY), ["yard is 1", "heater is 3"]),
    "a float, high word first": (
        lambda client: client.write_registers(23, float_registers("big"), device_id=HEATER),
        ["float 22.5", "high word first"],
    ),
    "a float, low word first": (
        lambda client: client.write_registers(23, float_registers("little"), device_id=HEATER),
        ["float 22.5", "low word first"],
    ),
    # The PFC's manual allows 64 registers at once.
    "a quantity above the device's limit": (
        lambda client: client.read_input_registers(0, count=100, device_id=PFC),
        ["100", "at most 64"],
    ),
    "half of a two-word register": (
        lambda client: client.read_input_registers(2, device_id=TRC),
        ["output_voltage takes two registers, 2 and 3"],
    ),
}


@pytest.fixture
def bench(standin: Callable[..., Standin]) -> Standin:
    """The four devices with a control interface."""
    return standin(FOUR_DEVICES, "--listen", "127.0.0.1:0")


@pytest.fixture
def client(bench: Standin) -> Iterator[ModbusSerialClient]:
    """A client as its documentation shows it."""
    client = ModbusSerialClient(bench.path("line1"), baudrate=9600, stopbits=2, timeout=0.3, retries=0)
    assert client.connect()
    yield client
    client.close()


def last(bench: Standin) -> dict[str, Any]:
    """The youngest entry of the journal."""
    with urllib.request.urlopen(f"{bench.report['control']}/api/journal?limit=1", timeout=10) as answer:
        entries: list[dict[str, Any]] = json.load(answer)
    return entries[-1]


@pytest.mark.parametrize("name", MISTAKES)
def test_a_beginners_mistake_gets_its_hint(name: str, bench: Standin, client: ModbusSerialClient) -> None:
    mistake, words = MISTAKES[name]
    try:
        mistake(client)
    except ModbusIOException:
        # Nobody answers.
        pass
    hint = last(bench)["hint"] or ""
    assert all(word in hint for word in words), last(bench)


def test_what_is_right_gets_none(bench: Standin, client: ModbusSerialClient) -> None:
    assert client.read_holding_registers(0x10, count=7, device_id=1).registers[:3] == [14, 10, 27]
    assert last(bench)["hint"] is None
