"""The control interface and a TCP port as another host sees them (CTL-1): one in a network namespace of the test's own."""

from __future__ import annotations

import ipaddress
import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

import tools
from program import Standin

#: A network that is kept for examples (RFC 5737), four addresses of it for each of the processes that test side by side.
NETWORK = ipaddress.ip_network("203.0.113.0/24")

BENCH = """
[control]
{control}
[[bus]]
name = "line1"
port = "modbus-tcp:{listen}:0"
[[bus.device]]
name = "charger"
model = "logiccon-trc"
unit = 5
"""

TOKEN = "correct-horse-battery-staple"

#: What the other host does: a call; it prints the status, or what kept it from one.
CALL = """
import sys, urllib.request, urllib.error
request = urllib.request.Request(sys.argv[1], headers=dict(header.split("=", 1) for header in sys.argv[2:]))
try:
    print(urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=10).status)
except urllib.error.HTTPError as error:
    print(error.code)
except OSError as error:
    print(type(getattr(error, "reason", error)).__name__)
"""

#: TRC-1: the manual's question for registers 5 and 6, over Modbus TCP; it prints the answer in hex.
ASK = """
import socket, sys
with socket.create_connection((sys.argv[1], int(sys.argv[2])), timeout=10) as line:
    line.sendall(bytes.fromhex("0007 0000 0006 05 03 0005 0002"))
    print(line.recv(64).hex(" "))
"""


class Host:
    """Another host, at the other end of a wire of its own; it sees this one at `here`."""

    def __init__(self, name: str, here: str) -> None:
        self.name, self.here = name, here

    def python(self, code: str, *args: str) -> str:
        """Runs Python there, and gives what it prints."""
        command = ["ip", "netns", "exec", self.name, sys.executable, "-c", code, *args]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


@pytest.fixture
def host() -> Iterator[Host]:
    tools.need("ip")
    if os.geteuid() != 0:
        pytest.skip("only root makes network namespaces")
    name, wire = f"standin-{os.getpid()}", f"st{os.getpid() % 1_000_000}"
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    here, there = (str(NETWORK[4 * worker + side]) for side in (1, 2))
    steps = [
        f"netns add {name}",
        f"link add {wire} type veth peer name {wire}n netns {name}",
        f"address add {here}/30 dev {wire}",
        f"link set {wire} up",
        f"-n {name} address add {there}/30 dev {wire}n",
        f"-n {name} link set {wire}n up",
        f"-n {name} link set lo up",
    ]
    try:
        for step in steps:
            done = subprocess.run(["ip", *step.split()], capture_output=True, text=True)
            if done.returncode != 0 and step == steps[0]:
                pytest.skip(f"no network namespace can be made here: {done.stderr.strip()}")
            assert done.returncode == 0, f"ip {step}: {done.stderr}"
        yield Host(name, here)
    finally:
        subprocess.run(["ip", "link", "delete", wire], capture_output=True)
        subprocess.run(["ip", "netns", "delete", name], capture_output=True)


def ports(bench: Standin) -> tuple[str, str]:
    """The port numbers of the control interface and of Modbus TCP."""
    return bench.report["control"].rpartition(":")[2], bench.report["buses"][0]["path"].rpartition(":")[2]


def test_ctl_1_what_listens_on_loopback_is_not_there_for_another_host(host: Host, standin: Callable[..., Standin]) -> None:
    control, modbus = ports(standin(BENCH.format(control='listen = "127.0.0.1:0"', listen="127.0.0.1")))
    assert host.python(CALL, f"http://{host.here}:{control}/api/status") == "ConnectionRefusedError"
    assert host.python(CALL, f"http://{host.here}:{modbus}/") == "ConnectionRefusedError"


def test_ctl_1_another_host_needs_the_token_and_a_name_of_ours(host: Host, standin: Callable[..., Standin]) -> None:
    told = f'listen = "0.0.0.0:0"\ntoken = "{TOKEN}"\nhosts = ["bench.example"]'
    control, modbus = ports(standin(BENCH.format(control=told, listen="0.0.0.0")))
    url, bearer = f"http://{host.here}:{control}/api/status", f"Authorization=Bearer {TOKEN}"
    assert host.python(CALL, url) == "401"
    assert host.python(CALL, url, bearer + "x") == "401"
    assert host.python(CALL, url, bearer) == "200"
    assert host.python(CALL, url, bearer, "Host=bench.example") == "200"
    assert host.python(CALL, url, bearer, "Host=evil.example") == "403"
    assert host.python(CALL, url, bearer, "Origin=http://evil.example") == "403"
    # 190 and 250 are the factory values of output_current_limit and ac_high_limit.
    assert host.python(ASK, host.here, modbus) == "00 07 00 00 00 07 05 03 04 00 be 00 fa"
