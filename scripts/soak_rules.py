"""What a reply has to be, by the map that `standin registers MODEL --format json` prints and the clauses of the bus."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

READS = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
WRITES = {5: "coil", 6: "holding", 15: "coil", 16: "holding"}

#: The protocol's own limits of quantity (BUS-9) are in the map, per model, with this key.
LIMIT = {
    1: "read_bits",
    2: "read_bits",
    3: "read_registers",
    4: "read_registers",
    15: "write_bits",
    16: "write_registers",
}

#: Never written: a device that moves to another unit, by itself or by its factory settings, is another test's subject.
MOVERS = {"unit", "modbus_unit", "slave_addr", "factory_reset", "go_to_default"}

#: Registers that take more than their range, because the device wraps the value (TRC-4).
WRAPPED = {"baud", "stop_bits"}

#: A write that carries one of these changes more than what was written: all that is volatile (ASTRO-80), the programs
#: (ASTRO-68) and what the handshake works on (ASTRO-61), all temperatures (VOL-30), the place (ASTRO-30, 31), the
#: season's rules (ASTRO-21, 22), the clock's day (VOL-21), the only mode left (VOL-42), the limits (VOL-13).
FAR_REACHING = {
    "remote_reset", "delete_all_programs", "process_start", "temp_unit", "district",
    "dst_mode", "rtc_year", "rtc_month", "zone_available_mode", "zone_mode", "zone_temperature_min",
    "zone_temperature_max", "utc_offset_minutes", "latitude_hemisphere", "latitude_degrees", "latitude_minutes",
    "longitude_hemisphere", "longitude_degrees", "longitude_minutes", "baudrate", "parity_mode",
}

#: Registers that show something else than what was written: rounded (VOL-10 … 12), wrapped (TRC-4), or a state of their
#: own (ASTRO-40, ASTRO-50).
SHAPED = WRAPPED | {
    "zone_temperature_target", "zone_temperature_eco", "zone_temperature_delta", "zone_fan_speed", "holiday_a_status",
    "holiday_b_status", "manual_select_a", "manual_select_b", "program_update",
} | {
    f"zone_schedule_{day}_work_{number}_{end}"
    for day in ("mon_fri", "sat", "sun")
    for number in (1, 2)
    for end in ("start", "stop")
}


def crc16(data: bytes) -> int:
    """The CRC of RTU frames."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
    return byte


CRC_TABLE = [_crc_of_byte(byte) for byte in range(256)]


def framed(data: bytes) -> bytes:
    """Data and its CRC."""
    return data + crc16(data).to_bytes(2, "little")


def words(*numbers: int) -> bytes:
    """Numbers as words on the wire."""
    return b"".join(number.to_bytes(2, "big") for number in numbers)


@dataclass(frozen=True)
class Register:
    """One register of a map."""

    name: str
    address: int
    words: int
    format: str
    access: str
    min: int | None
    max: int | None
    one_of: tuple[int, ...]
    step: int

    def admits(self, word: int) -> bool:
        """Whether the map lets a write carry this word."""
        number = word - 0x10000 if self.format == "s16" and word & 0x8000 else word
        if self.one_of:
            return number in self.one_of
        assert self.min is not None and self.max is not None
        return self.min <= number <= self.max and number % self.step == 0

    def value(self, dice: random.Random) -> int:
        """A word for a write: mostly one that the map admits, often at the edge, sometimes any."""
        if self.access == "read":
            return dice.choice([0, 1, dice.randrange(0x10000)])
        low, high = self.min or 0, self.max or 0
        edges = [low, high, low - 1, high + 1, low + self.step, high - self.step]
        good = list(self.one_of) or [dice.randint(low // self.step, high // self.step) * self.step for _ in range(3)]
        return dice.choice(good * 4 + edges + [dice.randrange(0x10000)]) & 0xFFFF


@dataclass
class Model:
    """A model's map, by bank and address."""

    name: str
    functions: frozenset[int]
    limits: dict[str, int]
    answers_crc_errors: bool
    banks: dict[str, dict[int, Register]] = field(default_factory=dict)

    @classmethod
    def of(cls, exported: dict[str, Any]) -> Model:
        """A model from what the program exports."""
        options = {option["name"]: option["default"] for option in exported["options"]}
        answers = options.get("crc_error_reply") == "exception"
        model = cls(exported["model"], frozenset(exported["functions"]), exported["limits"], answers)
        for each in exported["registers"]:
            keys = ("name", "address", "words", "format", "access", "min", "max", "step")
            register = Register(**{key: each[key] for key in keys}, one_of=tuple(each["one_of"]))
            bank = model.banks.setdefault(each["bank"], {})
            for offset in range(register.words):
                bank[register.address + offset] = register
        return model

    def span(self, bank: str, start: int, count: int) -> list[Register] | None:
        """The registers of a span, one per address; nothing where the map does not have all of it."""
        own = self.banks.get(bank, {})
        found = [own.get(address) for address in range(start, start + count)]
        return None if None in found else found  # type: ignore[return-value]


class Wrong(Exception):
    """A reply that is not what the map and the clauses say, or none."""


def has_good_start(data: bytes) -> bool:
    """Whether a frame could end somewhere in the data."""
    return any(crc16(data[:end]) == 0 for end in range(4, len(data) + 1))


def refusal(model: Model, function: int, start: int, count: int) -> int | None:
    """The exception that a span alone brings, in the order of BUS-8."""
    if function not in model.functions:
        return 1
    if function in LIMIT and not 1 <= count <= model.limits[LIMIT[function]]:
        return 3
    bank = READS.get(function) or WRITES[function]
    return 2 if model.span(bank, start, count) is None else None


def write_body(function: int, start: int, values: list[int]) -> tuple[bytes, list[int]]:
    """A write's function and data, and its values as bits where they are such."""
    if WRITES[function] == "coil":
        values = [value & 1 for value in values]
    if function == 5:
        return bytes([5]) + words(start, 0xFF00 * values[0]), values
    if function == 6:
        return bytes([6]) + words(start, values[0]), values
    if function == 15:
        bits = sum(value << at for at, value in enumerate(values))
        data = bits.to_bytes((len(values) + 7) // 8, "little")
    else:
        data = words(*values)
    # The count of bytes is one byte: what does not fit is too long for any limit anyway.
    return bytes([function]) + words(start, len(values)) + bytes([len(data) & 0xFF]) + data, values


def check_write(
    model: Model,
    function: int,
    start: int,
    values: list[int],
    reply: bytes,
    before: list[int] | None,
    after: list[int] | None,
) -> None:
    """The reply to a write is what the map says, and so is what is shown afterwards."""
    count = len(values)
    wanted = refusal(model, function, start, count)
    span = model.span(WRITES[function], start, count)
    if wanted is None:
        assert span is not None
        if any(register.access == "read" for register in span):
            wanted = 2
        pairs = zip(span, values, strict=True)
        if wanted is None and any(each.name not in WRAPPED and not each.admits(value) for each, value in pairs):
            wanted = 3
    if wanted is not None:
        expect(reply, bytes([function | 0x80, wanted]))
    if reply[0] & 0x80:
        # What the map admits, a rule between registers (03) or the device's state (04) may still refuse.
        if reply[1] not in ((wanted,) if wanted else (3, 4)):
            raise Wrong(f"an exception without a reason: {reply.hex(' ')}")
        if before != after:
            raise Wrong(f"refused, yet {before} became {after}")
        return
    expect(reply, write_body(function, start, values)[0][:5])
    assert span is not None
    if after is None or any(register.name in FAR_REACHING for register in span):
        return
    for register, value, shows in zip(span, values, after, strict=True):
        if register.name not in SHAPED and shows != (0 if register.access == "command" else value):
            raise Wrong(f"{register.name} was written {value} and shows {shows}")


def expect(got: bytes, wanted: bytes) -> None:
    """The reply is this one."""
    if got != wanted:
        raise Wrong(f"wanted {wanted.hex(' ')}, got {got.hex(' ')}")
