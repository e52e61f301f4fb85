"""Five Modbus clients behind one face, so that every test can be asked of each.

Each turns its library's own way of saying "exception 02" or "no answer" into `Refused` or `Silence`.
"""

from __future__ import annotations

import asyncio
import re
import subprocess
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import minimalmodbus
import serial
from pymodbus.client import AsyncModbusSerialClient, ModbusSerialClient
from pymodbus.exceptions import ModbusIOException

from tables import COIL, DISCRETE, HOLDING, INPUT

READ = {COIL: 1, DISCRETE: 2, HOLDING: 3, INPUT: 4}

#: How long a client waits for an answer.
TIMEOUT_S = 1.0

#: The names of the exceptions (Modbus application protocol, section 7).
EXCEPTION = {"function": 1, "data address": 2, "data value": 3, "device": 4, "failure": 4}


class Refused(Exception):
    """An exception reply."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code:02}")
        self.code = code


class Silence(Exception):
    """No reply."""


class Client(Protocol):
    """What every client can do."""

    def read(self, unit: int, bank: str, addr: int, count: int) -> list[int]:
        """Reads bits or registers."""

    def write(self, unit: int, bank: str, addr: int, value: int) -> None:
        """Writes one coil or register, by function 05 or 06."""

    def write_many(self, unit: int, bank: str, addr: int, values: Sequence[int]) -> None:
        """Writes neighbouring coils or registers, by function 15 or 16."""

    def close(self) -> None:
        """Closes the port."""


class Pymodbus:
    """pymodbus' blocking client."""

    def __init__(self, path: str, **line: Any) -> None:
        self.client = ModbusSerialClient(path, timeout=TIMEOUT_S, retries=0, **line)
        assert self.client.connect()

    def _result(self, ask: Callable[[], Any]) -> Any:
        try:
            reply = ask()
        except ModbusIOException as silence:
            raise Silence from silence
        if reply.isError():
            raise Refused(reply.exception_code)
        return reply

    def read(self, unit: int, bank: str, addr: int, count: int) -> list[int]:
        """Reads bits or registers."""
        call = getattr(self.client, READ_CALL[bank])
        reply = self._result(lambda: call(addr, count=count, device_id=unit))
        return [int(bit) for bit in reply.bits[:count]] if bank in (COIL, DISCRETE) else list(reply.registers)

    def write(self, unit: int, bank: str, addr: int, value: int) -> None:
        """Writes one coil or register."""
        if bank == COIL:
            self._result(lambda: self.client.write_coil(addr, bool(value), device_id=unit))
        else:
            self._result(lambda: self.client.write_register(addr, value, device_id=unit))

    def write_many(self, unit: int, bank: str, addr: int, values: Sequence[int]) -> None:
        """Writes neighbouring coils or registers."""
        if bank == COIL:
            self._result(lambda: self.client.write_coils(addr, [bool(value) for value in values], device_id=unit))
        else:
            self._result(lambda: self.client.write_registers(addr, list(values), device_id=unit))

    def close(self) -> None:
        """Closes the port."""
        self.client.close()


READ_CALL = {
    COIL: "read_coils",
    DISCRETE: "read_discrete_inputs",
    HOLDING: "read_holding_registers",
    INPUT: "read_input_registers",
}


class PymodbusAsync(Pymodbus):
    """pymodbus' asyncio client, each call run to its end."""

    def __init__(self, path: str, **line: Any) -> None:
        self.loop = asyncio.new_event_loop()

        async def connect() -> Any:
            client = AsyncModbusSerialClient(path, timeout=TIMEOUT_S, retries=0, **line)
            assert await client.connect()
            return client

        self.client = self.loop.run_until_complete(connect())

    def _result(self, ask: Callable[[], Any]) -> Any:
        return super()._result(lambda: self.loop.run_until_complete(ask()))

    def close(self) -> None:
        """Closes the port."""

        async def close() -> None:
            self.client.close()
            await asyncio.sleep(0)

        self.loop.run_until_complete(close())
        self.loop.close()


class Minimalmodbus:
    """minimalmodbus, which has an instrument per unit."""

    def __init__(self, path: str, *, baudrate: int, parity: str, stopbits: int) -> None:
        self.instruments: dict[int, minimalmodbus.Instrument] = {}
        self.port = serial.Serial(path, baudrate, 8, parity, stopbits, timeout=TIMEOUT_S)

    def _ask(self, unit: int, ask: Callable[[minimalmodbus.Instrument], Any]) -> Any:
        instrument = self.instruments.setdefault(unit, minimalmodbus.Instrument(self.port, unit))
        try:
            return ask(instrument)
        except minimalmodbus.NoResponseError as silence:
            raise Silence from silence
        except minimalmodbus.SlaveReportedException as refusal:
            raise Refused(exception_code(str(refusal))) from refusal

    def read(self, unit: int, bank: str, addr: int, count: int) -> list[int]:
        """Reads bits or registers."""
        call = "read_bits" if bank in (COIL, DISCRETE) else "read_registers"
        return list(self._ask(unit, lambda instrument: getattr(instrument, call)(addr, count, READ[bank])))

    def write(self, unit: int, bank: str, addr: int, value: int) -> None:
        """Writes one coil or register."""
        if bank == COIL:
            self._ask(unit, lambda instrument: instrument.write_bit(addr, value, functioncode=5))
        else:
            self._ask(unit, lambda instrument: instrument.write_register(addr, value, functioncode=6))

    def write_many(self, unit: int, bank: str, addr: int, values: Sequence[int]) -> None:
        """Writes neighbouring coils or registers."""
        call = "write_bits" if bank == COIL else "write_registers"
        self._ask(unit, lambda instrument: getattr(instrument, call)(addr, list(values)))

    def close(self) -> None:
        """Closes the port."""
        self.port.close()


class Mbpoll:
    """mbpoll, a program over libmodbus: one process a request."""

    TYPE = {COIL: "0", DISCRETE: "1", INPUT: "3:hex", HOLDING: "4:hex"}
    PARITY = {"N": "none", "E": "even", "O": "odd"}

    def __init__(self, path: str, *, baudrate: int, parity: str, stopbits: int) -> None:
        self.path = path
        self.line = ["-m", "rtu", "-b", str(baudrate), "-P", self.PARITY[parity], "-s", str(stopbits)]

    def _run(self, unit: int, bank: str, addr: int, *rest: str, values: Sequence[int] = ()) -> str:
        command = ["mbpoll", *self.line, "-a", str(unit), "-t", self.TYPE[bank], "-0", "-r", str(addr), "-1"]
        command += ["-o", str(TIMEOUT_S), *rest, self.path, *(str(value) for value in values)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        said = done.stdout + done.stderr
        if "timed out" in said:
            raise Silence
        failed = re.search(r"failed: (.*)", said)
        if failed:
            raise Refused(exception_code(failed[1]))
        assert done.returncode == 0, said
        return said

    def read(self, unit: int, bank: str, addr: int, count: int) -> list[int]:
        """Reads bits or registers."""
        said = self._run(unit, bank, addr, "-c", str(count))
        found = re.findall(r"^\[(\d+)\]:\s+(\S+)", said, re.MULTILINE)
        assert [int(at) for at, _ in found] == list(range(addr, addr + count)), said
        return [int(value, 0) for _, value in found]

    def write(self, unit: int, bank: str, addr: int, value: int) -> None:
        """Writes one coil or register."""
        self._run(unit, bank, addr, values=[value])

    def write_many(self, unit: int, bank: str, addr: int, values: Sequence[int]) -> None:
        """Writes neighbouring coils or registers."""
        assert len(values) > 1, "mbpoll writes one value by function 05 or 06"
        self._run(unit, bank, addr, values=values)

    def close(self) -> None:
        """Every process has closed it itself."""


class Raw:
    """A serial port and frames put together by hand."""

    def __init__(self, path: str, *, baudrate: int, parity: str, stopbits: int) -> None:
        self.port = serial.Serial(path, baudrate, 8, parity, stopbits, timeout=TIMEOUT_S)

    def ask(self, unit: int, function: int, data: bytes) -> bytes:
        """The data of a reply behind unit and function."""
        self.port.reset_input_buffer()
        self.port.write(framed(bytes([unit, function]) + data))
        head = self.port.read(3)
        if not head:
            raise Silence
        assert head[0] == unit and head[1] & 0x7F == function, head.hex(" ")
        if head[1] & 0x80:
            rest = self.port.read(2)
        else:
            rest = self.port.read(head[2] + 2 if function <= 4 else 5)
        whole = head + rest
        assert framed(whole[:-2]) == whole, whole.hex(" ")
        if head[1] & 0x80:
            raise Refused(head[2])
        return bytes(whole[2:-2])

    def read(self, unit: int, bank: str, addr: int, count: int) -> list[int]:
        """Reads bits or registers."""
        data = self.ask(unit, READ[bank], words(addr, count))[1:]
        if bank in (COIL, DISCRETE):
            assert len(data) == (count + 7) // 8
            bits = [byte >> bit & 1 for byte in data for bit in range(8)]
            assert not any(bits[count:]), "unused bits are 0"
            return bits[:count]
        assert len(data) == 2 * count
        return [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]

    def write(self, unit: int, bank: str, addr: int, value: int) -> None:
        """Writes one coil or register; the reply is the request's echo (BUS-7)."""
        sent = words(addr, 0xFF00 * value if bank == COIL else value)
        assert self.ask(unit, 5 if bank == COIL else 6, sent) == sent

    def write_many(self, unit: int, bank: str, addr: int, values: Sequence[int]) -> None:
        """Writes neighbouring coils or registers; the reply repeats address and quantity (BUS-7)."""
        head = words(addr, len(values))
        if bank == COIL:
            bits = sum(value << at for at, value in enumerate(values))
            body = bits.to_bytes((len(values) + 7) // 8, "little")
        else:
            body = words(*values)
        assert self.ask(unit, 15 if bank == COIL else 16, head + bytes([len(body)]) + body) == head

    def close(self) -> None:
        """Closes the port."""
        self.port.close()


def words(*numbers: int) -> bytes:
    """Numbers as words on the wire."""
    return b"".join(number.to_bytes(2, "big") for number in numbers)


def crc16(data: bytes) -> int:
    """The CRC of RTU frames: polynomial 0xA001, from 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def framed(data: bytes) -> bytes:
    """Data and its CRC, low byte first."""
    return data + crc16(data).to_bytes(2, "little")


def exception_code(text: str) -> int:
    """The code of an exception that a client tells in words."""
    found = [code for words, code in EXCEPTION.items() if words in text.lower()]
    assert found, f"no exception, but: {text}"
    return found[0]


MAKERS: dict[str, Callable[..., Client]] = {
    "pymodbus": Pymodbus,
    "pymodbus-async": PymodbusAsync,
    "minimalmodbus": Minimalmodbus,
    "mbpoll": Mbpoll,
    "raw": Raw,
}

CLIENTS = list(MAKERS)


def open_client(name: str, path: str, parity: str = "N", baudrate: int = 9600, stopbits: int = 2) -> Client:
    """Opens a client on a port."""
    return MAKERS[name](path, baudrate=baudrate, parity=parity, stopbits=stopbits)
