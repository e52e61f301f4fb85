"""Every client reads and writes all four devices, and sees their refusals and their silence."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from clients import Client, Refused, Silence
from program import Standin
from tables import (
    ASTRO,
    ASTRO_START,
    COIL,
    DISCRETE,
    HEATER,
    HEATER_START,
    HOLDING,
    INPUT,
    NOBODY,
    PFC,
    PFC_START,
    TRC,
    TRC_START,
    Run,
)


def check_start(client: Client, runs: Sequence[Run]) -> None:
    """The client reads what the tables say."""
    for run in runs:
        got = client.read(run.unit, run.bank, run.addr, len(run.values))
        assert got == run.values, f"{run.bank} {run.addr:#06x} of unit {run.unit}"


def check_refused(code: int, ask: Callable[..., object], *args: object) -> None:
    """The device answers with an exception."""
    with pytest.raises(Refused) as refusal:
        ask(*args)
    assert refusal.value.code == code


def test_astro_1_start_values(client: Client) -> None:
    check_start(client, ASTRO_START)


def test_trc_1_start_values(client: Client) -> None:
    check_start(client, TRC_START)


def test_pfc_1_start_values(client: Client) -> None:
    check_start(client, PFC_START)


def test_vol_1_start_values(client: Client) -> None:
    check_start(client, HEATER_START)


def test_astro_3_the_clock_is_written(client: Client) -> None:
    client.write(ASTRO, HOLDING, 0x10, 15)
    assert client.read(ASTRO, HOLDING, 0x10, 3) == [15, 10, 27]
    client.write_many(ASTRO, HOLDING, 0x10, [14, 11, 2, 15, 17, 0])
    # The second of November 2014 is a Sunday.
    assert client.read(ASTRO, HOLDING, 0x10, 7) == [14, 11, 2, 15, 17, 0, 7]
    check_refused(3, client.write, ASTRO, HOLDING, 0x10, 101)
    check_refused(2, client.read, ASTRO, HOLDING, 0x10, 8)


def test_astro_21_and_31_written_rules_make_the_mode_custom(client: Client) -> None:
    client.write(ASTRO, HOLDING, 0x31, 4)
    assert client.read(ASTRO, HOLDING, 0x30, 2) == [2, 4]
    # Three hours west: two's complement on the wire, and the district becomes a custom place.
    client.write(ASTRO, HOLDING, 0x27, 0x10000 - 180)
    assert client.read(ASTRO, HOLDING, 0x27, 1) == [0x10000 - 180]
    assert client.read(ASTRO, HOLDING, 0x20, 1) == [0]
    check_refused(3, client.write, ASTRO, HOLDING, 0x27, 100)


def test_trc_1_and_5_limits_are_written(client: Client) -> None:
    client.write(TRC, HOLDING, 11, 40)
    assert client.read(TRC, HOLDING, 11, 1) == [40]
    client.write_many(TRC, HOLDING, 9, [220, 45, 35])
    assert client.read(TRC, HOLDING, 9, 3) == [220, 45, 35]
    check_refused(3, client.write, TRC, HOLDING, 9, 226)
    # All or nothing (BUS-10): the second value is out of its range.
    check_refused(3, client.write_many, TRC, HOLDING, 9, [215, 61, 35])
    assert client.read(TRC, HOLDING, 9, 3) == [220, 45, 35]


def test_pfc_2_a_step_is_written(client: Client) -> None:
    client.write(PFC, HOLDING, 3, 5)
    assert client.read(PFC, HOLDING, 1, 5) == [1, 0, 5, 0, 6]
    check_refused(3, client.write, PFC, HOLDING, 3, 10_000)
    check_refused(2, client.read, PFC, HOLDING, 0, 1)
    check_refused(2, client.read, PFC, INPUT, 657, 2)


def test_vol_10_and_11_values_are_rounded_down(client: Client) -> None:
    client.write(HEATER, HOLDING, 23, 2234)
    assert client.read(HEATER, HOLDING, 23, 1) == [2200]
    client.write_many(HEATER, HOLDING, 28, [532, 803, 905, 1330])
    assert client.read(HEATER, HOLDING, 28, 4) == [525, 795, 900, 1320]
    # The stop lies before its start (VOL-15).
    check_refused(3, client.write_many, HEATER, HOLDING, 28, [600, 540, 905, 1330])
    assert client.read(HEATER, HOLDING, 28, 4) == [525, 795, 900, 1320]


def test_vol_4_coils_are_written(client: Client) -> None:
    client.write(HEATER, COIL, 4, 1)
    assert client.read(HEATER, COIL, 0, 7) == [0, 0, 1, 0, 1, 0, 0]
    client.write_many(HEATER, COIL, 4, [0, 0, 1])
    assert client.read(HEATER, COIL, 0, 7) == [0, 0, 1, 0, 0, 0, 1]
    check_refused(2, client.write, HEATER, COIL, 1, 1)
    check_refused(2, client.write_many, HEATER, COIL, 1, [0, 1])


def test_bus_8_a_function_that_the_device_has_not(client: Client) -> None:
    check_refused(1, client.read, ASTRO, INPUT, 0, 1)
    check_refused(1, client.read, ASTRO, COIL, 0, 1)
    check_refused(1, client.read, TRC, DISCRETE, 0, 1)
    check_refused(1, client.write, TRC, COIL, 0, 1)
    check_refused(1, client.write_many, PFC, HOLDING, 1, [1, 0])


def test_bus_8_a_read_only_register(client: Client) -> None:
    check_refused(2, client.write, ASTRO, HOLDING, 0x16, 1)
    check_refused(2, client.write, HEATER, HOLDING, 12, 1)
    assert client.read(ASTRO, HOLDING, 0x16, 1) == [1]


def test_bus_11_a_read_that_leaves_the_map(client: Client) -> None:
    check_refused(2, client.read, ASTRO, HOLDING, 0x15, 3)
    check_refused(2, client.read, TRC, HOLDING, 11, 2)
    check_refused(2, client.read, HEATER, HOLDING, 40, 2)


def test_trc_3_and_pfc_3_lowered_limits(client: Client) -> None:
    check_refused(3, client.read, TRC, HOLDING, 0, 31)
    check_refused(3, client.read, PFC, HOLDING, 1, 65)
    assert len(client.read(PFC, HOLDING, 1, 64)) == 64


def test_bus_2_a_unit_nobody_has_is_silent(client: Client) -> None:
    with pytest.raises(Silence):
        client.read(NOBODY, HOLDING, 0, 1)
    assert client.read(ASTRO, HOLDING, 0x10, 1) == [14]


@pytest.mark.parametrize("client", ["pymodbus", "pymodbus-async", "minimalmodbus"], indirect=True)
def test_bus_3_a_broadcast_reaches_every_device(client: Client, four: Standin) -> None:
    # Register 11 is the TRC's fan off temperature, the relay's power of step 2 and the heater's seconds; the Astro has
    # none. mbpoll refuses to send broadcasts.
    broadcast(client, HOLDING, 11, 41)
    assert client.read(TRC, HOLDING, 11, 1) == [41]
    assert client.read(PFC, HOLDING, 11, 1) == [41]
    assert client.read(HEATER, HOLDING, 11, 1) == [41]
    # 62 fits the relay only; the others keep what they have.
    broadcast(client, HOLDING, 11, 62)
    assert client.read(TRC, HOLDING, 11, 1) == [41]
    assert client.read(PFC, HOLDING, 11, 1) == [62]
    assert client.read(HEATER, HOLDING, 11, 1) == [41]
    assert client.read(ASTRO, HOLDING, 0x10, 1) == [14]


def broadcast(client: Client, bank: str, addr: int, value: int) -> None:
    """Writes to unit 0 the way the client offers; nobody answers."""
    try:
        client.write(0, bank, addr, value)
    except Silence:
        pass
