"""The pty as a real port would be: clients come and go, crash, set parity, and come through socat."""

from __future__ import annotations

import asyncio
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial
from pymodbus.client import AsyncModbusSerialClient, ModbusSerialClient

import tools
from clients import CLIENTS, Raw, Silence, framed, open_client
from program import Standin
from tables import ASTRO, COIL, FOUR_DEVICES, HEATER, HOLDING, INPUT, PFC, START, TRC

CLOCK = [14, 10, 27, 14, 22, 8, 1]


def check_answers(name: str, four: Standin, parity: str = "N", stopbits: int = 2) -> None:
    """A client opens the port, reads a word of every device, and closes it."""
    four.settle()
    client = open_client(name, four.path("line1"), parity, stopbits=stopbits)
    try:
        assert client.read(ASTRO, HOLDING, 0x10, 7) == CLOCK
        assert client.read(PFC, INPUT, 0, 2) == [230, 0]
        assert client.read(HEATER, COIL, 0, 7) == [0, 0, 1, 0, 0, 0, 0]
        assert client.read(TRC, HOLDING, 9, 3) == [210, 40, 30]
    finally:
        client.close()


@pytest.mark.parametrize("parity", ["E", "O"])
@pytest.mark.parametrize("name", ["raw", "mbpoll"])
def test_bus_16_parity_set_by_the_client(name: str, parity: str, four: Standin) -> None:
    # pyserial and libmodbus, the first client and the next ones; the kernel does not keep parity on a pty.
    if name == "mbpoll":
        tools.need("mbpoll")
    for _ in range(4):
        check_answers(name, four, parity, stopbits=1)


@pytest.mark.parametrize("parity", ["E", "O"])
def test_bus_16_clients_with_changing_parity(parity: str, four: Standin) -> None:
    for each in ["N", parity, "N", parity, parity]:
        check_answers("raw", four, each, stopbits=1)


def test_bus_14_a_bus_with_even_parity(standin: Callable[..., Standin]) -> None:
    # The Astro offers 8E1 and 8E2, the heater 8E1: registers 0x62 and 1 show it.
    bench = standin(
        """
        [[bus]]
        name = "line1"
        port = "pty:{dir}/line1"
        parity = "even"
        stop_bits = 1
        [[bus.device]]
        name = "yard"
        model = "kael-astro-01"
        unit = 1
        [[bus.device]]
        name = "heater"
        model = "hmi-volcano-ec"
        unit = 3
        """
    )
    for name in ["raw", "mbpoll"]:
        if name == "mbpoll":
            tools.need("mbpoll")
        client = open_client(name, bench.path("line1"), "E", stopbits=1)
        assert client.read(ASTRO, HOLDING, 0x62, 2) == [2, 1]
        assert client.read(HEATER, HOLDING, 0, 2) == [960, ord("e")]
        client.close()


@contextmanager
def socat(left: str, right: str, link: Path) -> Iterator[None]:
    """socat between two addresses until the end of the block; `link` appears when it is ready."""
    process = subprocess.Popen([tools.need("socat"), left, right], stderr=subprocess.PIPE, text=True)
    try:
        end = time.monotonic() + 10
        while not link.exists():
            assert process.poll() is None and time.monotonic() < end, "socat made no pty"
            time.sleep(0.01)
        yield
    finally:
        process.terminate()
        process.wait(10)
        assert process.stderr is not None
        process.stderr.close()


@pytest.mark.parametrize("name", CLIENTS)
def test_bus_5_through_a_socat_pair(name: str, four: Standin) -> None:
    if name == "mbpoll":
        tools.need("mbpoll")
    far = four.dir / "far"
    with socat(f"PTY,link={far},rawer", f"FILE:{four.path('line1')},rawer,b9600,cstopb=1", far):
        client = open_client(name, str(far))
        for run in START:
            assert client.read(run.unit, run.bank, run.addr, len(run.values)) == run.values
        client.close()


@pytest.mark.parametrize("name", CLIENTS)
def test_bus_23_clients_open_and_close(name: str, four: Standin) -> None:
    if name == "mbpoll":
        tools.need("mbpoll")
    check_answers(name, four)
    held = four.open_files()
    for _ in range(20 if name == "mbpoll" else 50):
        check_answers(name, four)
    assert four.open_files() == held


def test_bus_23_nobody_there_costs_nothing(four: Standin) -> None:
    check_answers("raw", four)
    before = four.cpu_s()
    time.sleep(2)
    # A closed last client must not turn into reads that fail at once, again and again.
    assert four.cpu_s() - before < 0.2


def test_bus_23_a_reply_that_nobody_read_is_dropped(four: Standin) -> None:
    request = framed(bytes([TRC, 3, 0, 9, 0, 3]))
    for rest in range(20):
        with serial.Serial(four.path("line1"), 9600, stopbits=2) as port:
            # One whole request, and the beginning of another.
            port.write(request + request[: rest % 8])
            if rest % 2:
                time.sleep(0.05)
        four.settle()
        with serial.Serial(four.path("line1"), 9600, stopbits=2, timeout=1) as port:
            port.write(framed(bytes([ASTRO, 3, 0, 0x10, 0, 7])))
            # Read by hand: no client's own flush may hide what is left over.
            reply = port.read(19)
            assert reply[:3] == bytes([ASTRO, 3, 14]), reply.hex(" ")
            assert framed(reply[:-2]) == reply


def test_bus_5_a_request_one_byte_at_a_time(four: Standin) -> None:
    with serial.Serial(four.path("line1"), 9600, stopbits=2, timeout=1) as port:
        for byte in framed(bytes([TRC, 3, 0, 9, 0, 3])):
            port.write(bytes([byte]))
            time.sleep(0.002)
        assert port.read(11) == framed(bytes([TRC, 3, 6, 0, 210, 0, 40, 0, 30]))


def test_bus_5_a_good_request_after_garbage_and_silence(four: Standin) -> None:
    with serial.Serial(four.path("line1"), 9600, stopbits=2, timeout=1) as port:
        for garbage in [b"\xff" * 40, b"\x01\x03", bytes(range(1, 120)), b"\x00" * 600]:
            port.write(garbage)
            time.sleep(0.1)
            port.reset_input_buffer()
            port.write(framed(bytes([TRC, 3, 0, 9, 0, 3])))
            assert port.read(11) == framed(bytes([TRC, 3, 6, 0, 210, 0, 40, 0, 30]))


def test_bus_5_several_requests_in_one_write(four: Standin) -> None:
    asks = [bytes([TRC, 3, 0, 9, 0, 3]), bytes([HEATER, 3, 0, 23, 0, 1]), bytes([TRC, 3, 0, 40, 0, 1])]
    limits, target = bytes([TRC, 3, 6, 0, 210, 0, 40, 0, 30]), bytes([HEATER, 3, 2, 2200 >> 8, 2200 & 255])
    replies = [limits, target, bytes([TRC, 0x83, 2])]
    with serial.Serial(four.path("line1"), 9600, stopbits=2, timeout=1) as port:
        port.write(b"".join(framed(ask) for ask in asks))
        wanted = b"".join(framed(reply) for reply in replies)
        assert port.read(len(wanted)) == wanted


def test_bus_4_a_wrong_crc(four: Standin) -> None:
    with serial.Serial(four.path("line1"), 9600, stopbits=2, timeout=0.5) as port:
        for unit, reply in [
            (ASTRO, b""),
            (HEATER, b""),
            (TRC, framed(bytes([TRC, 0x83, 3]))),
            (PFC, framed(bytes([PFC, 0x83, 3]))),
        ]:
            good = framed(bytes([unit, 3, 0, 3, 0, 1]))
            port.write(good[:-1] + bytes([good[-1] ^ 0xFF]))
            assert port.read(5) == reply


KILLED = """
import os, signal, sys, fcntl, termios, serial
port = serial.Serial(sys.argv[1], 9600, stopbits=2)
fcntl.ioctl(port.fd, termios.TIOCEXCL)
port.write(bytes.fromhex(sys.argv[2]))
port.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_client(path: str, sent: bytes) -> None:
    """A client takes the port for itself, sends this, and is killed."""
    done = subprocess.run([sys.executable, "-c", KILLED, path, sent.hex()], timeout=30, check=False)
    assert done.returncode == -signal.SIGKILL


def test_bus_23_clients_killed_in_mid_request(four: Standin) -> None:
    request = framed(bytes([HEATER, 6, 0, 23, 2500 >> 8, 2500 & 255]))
    held = four.open_files()
    for cut in range(len(request)):
        kill_a_client(four.path("line1"), request[:cut])
        four.settle()
        client = Raw(four.path("line1"), baudrate=9600, parity="N", stopbits=2)
        assert client.read(HEATER, HOLDING, 23, 1) == [2200]
        client.close()
    # A whole request is carried out, though nobody reads its reply.
    kill_a_client(four.path("line1"), request)
    check_answers("raw", four)
    client = Raw(four.path("line1"), baudrate=9600, parity="N", stopbits=2)
    assert client.read(HEATER, HOLDING, 23, 1) == [2500]
    client.close()
    assert four.open_files() == held


def test_bus_23_several_clients_killed_at_once(four: Standin) -> None:
    path, half = four.path("line1"), framed(bytes([TRC, 3, 0, 9, 0, 3]))[:5]
    for _ in range(5):
        clients = [
            subprocess.Popen(
                [sys.executable, "-c", "import os,sys,time; fd=os.open(sys.argv[1], os.O_RDWR|os.O_NOCTTY); "
                 "os.write(fd, bytes.fromhex(sys.argv[2])); print(flush=True); time.sleep(60)", path, half.hex()],
                stdout=subprocess.PIPE,
            )
            for _ in range(3)
        ]
        for each in clients:
            assert each.stdout is not None and each.stdout.readline() == b"\n"
            each.kill()
        for each in clients:
            each.communicate()
        check_answers("raw", four)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else, and root is never kept out")
def test_bus_23_a_killed_client_does_not_keep_the_port(four: Standin) -> None:
    path = four.path("line1")
    os.chmod(four.dir, 0o755)
    os.chmod(path, stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP | stat.S_IROTH | stat.S_IWOTH)
    kill_a_client(path, b"\x01")
    four.settle()
    opens = "import os,sys; os.close(os.open(sys.argv[1], os.O_RDWR|os.O_NOCTTY))"
    nobody = subprocess.run(
        ["/usr/bin/env", "python3", "-c", opens, os.path.realpath(path)],
        user=65534, group=65534, extra_groups=[], cwd="/", capture_output=True, text=True, timeout=30, check=False,
    )
    assert nobody.returncode == 0, nobody.stderr
    check_answers("raw", four)


def test_bus_5_many_requests_at_once_over_asyncio(four: Standin) -> None:
    async def ask() -> list[list[int]]:
        client = AsyncModbusSerialClient(four.path("line1"), baudrate=9600, stopbits=2, timeout=2, retries=0)
        assert await client.connect()
        asked = [client.read_holding_registers(9, count=3, device_id=TRC) for _ in range(30)]
        asked += [client.read_holding_registers(0x10, count=7, device_id=ASTRO) for _ in range(30)]
        replies = await asyncio.gather(*asked)
        client.close()
        return [list(reply.registers) for reply in replies]

    assert asyncio.run(ask()) == [[210, 40, 30]] * 30 + [CLOCK] * 30


def test_bus_3_a_broadcast_without_waiting(four: Standin) -> None:
    client = ModbusSerialClient(four.path("line1"), baudrate=9600, stopbits=2, timeout=1, retries=0)
    assert client.connect()
    client.write_register(11, 33, device_id=0, no_response_expected=True)
    assert client.read_holding_registers(11, device_id=TRC).registers == [33]
    assert client.read_holding_registers(11, device_id=HEATER).registers == [33]
    client.close()


def test_bus_2_a_silent_unit_does_not_disturb_the_next(four: Standin) -> None:
    client = Raw(four.path("line1"), baudrate=9600, parity="N", stopbits=2)
    for unit in [77, 200, 247, 255]:
        with pytest.raises(Silence):
            client.read(unit, HOLDING, 0, 1)
        assert client.read(TRC, HOLDING, 9, 1) == [210]
    client.close()


def test_bus_19_the_link_goes_with_the_program(standin: Callable[..., Standin]) -> None:
    bench = standin(FOUR_DEVICES)
    path = Path(bench.path("line1"))
    assert path.exists()
    assert bench.stop() == 0
    assert not path.is_symlink()


def test_bus_1_ready_names_buses_and_devices(four: Standin) -> None:
    [bus] = four.report["buses"]
    assert (bus["name"], bus["path"]) == ("line1", str(four.dir / "line1"))
    assert bus["devices"] == [
        {"name": "yard", "model": "kael-astro-01", "unit": 1},
        {"name": "panel", "model": "logiccon-pfc24s-tcr", "unit": 2},
        {"name": "heater", "model": "hmi-volcano-ec", "unit": 3},
        {"name": "charger", "model": "logiccon-trc", "unit": 4},
    ]
