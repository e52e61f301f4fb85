"""The fixtures do what the documentation says, each tried by a project of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from conftest import CONFIG, passes


def test_a_device_shows_what_the_wire_shows(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        from modbus import connect

        def test_it(standin):
            charger = standin.device("charger")
            client = connect(standin.port("line1"))
            assert standin.port() == standin.port("line1") == standin.ports()[0]
            # TRC-1: holding register 3 counts tenths of a volt, 275 from the factory; coil 1 is the fan's relay.
            assert client.read_holding_registers(3, device_id=5).registers == [275]
            assert charger.get("charge_voltage_limit") == 27.5
            assert charger.raw("charge_voltage_limit") == 275
            assert charger.get("relay2_fan") is False
            assert (charger.unit, charger.bus, charger.is_powered) == (5, "line1", True)
            charger.set(fan_on_temperature=50)
            charger.set({"fan_off_temperature": 20})
            assert client.read_holding_registers(10, count=2, device_id=5).registers == [50, 20]
            assert standin.device("heater").get("room_temperature") == 20, "an input, where no register has the name"
            charger.force(fan_on_temperature=1000)
            assert client.read_holding_registers(10, device_id=5).registers == [1000]
            client.close()
        """,
    )


def test_refusals_and_wrong_names_are_errors_that_say_why(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        import pytest
        from pytest_standin import StandinError

        def test_it(standin):
            with pytest.raises(StandinError, match="20 to 60") as caught:
                standin.device("charger").set(fan_on_temperature=61)
            assert (caught.value.status, caught.value.code, caught.value.field) == (422, "refused", "fan_on_temperature")
            with pytest.raises(LookupError, match="charger, yard, heater"):
                standin.device("boiler")
            with pytest.raises(LookupError, match="line1"):
                standin.port("line2")
            with pytest.raises(LookupError, match="no register, coil or input voltage"):
                standin.device("charger").get("voltage")
            with pytest.raises(LookupError, match="do you mean zone_temperature_target"):
                standin.device("heater").raw("zone_temprature_target")
            with pytest.raises(StandinError, match="0 to 500"):
                standin.device("charger").inputs(ac_voltage=-1)
        """,
    )


def test_world_power_and_time(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        from datetime import datetime
        import pytest
        from pymodbus.exceptions import ModbusIOException
        from modbus import connect

        def test_it(standin):
            charger, client = standin.device("charger"), connect(standin.port())
            assert charger.inputs()["ac_voltage"] == 230
            assert charger.inputs(ac_voltage=0, load_current=5)["ac_voltage"] == 0
            before = charger.get("output_voltage")
            assert standin.clock.advance(hours=1) == datetime(2014, 10, 31, 16)
            assert charger.get("output_voltage") < before
            assert standin.clock.until("2014-10-31T16:30") == datetime(2014, 10, 31, 16, 30)
            assert standin.clock.jump(datetime(2020, 2, 29, 12)) == standin.clock.now == datetime(2020, 2, 29, 12)
            standin.clock.rate = 3600
            assert standin.clock.rate == 3600
            charger.power(False)
            assert not charger.is_powered
            with pytest.raises(ModbusIOException):
                client.read_holding_registers(3, device_id=5)
            charger.power(True)
            assert client.read_holding_registers(3, device_id=5).registers == [275]
            yard = standin.device("yard")
            yard.set(summer_hour=5)
            yard.restart()
            assert yard.state()["listening"] is False
            client.close()
        """,
    )


def test_faults_journal_reset_and_snapshots(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        import pytest
        from pymodbus.exceptions import ModbusIOException
        from modbus import connect

        def read(client):
            return client.read_holding_registers(3, device_id=5)

        def test_it(standin):
            client = connect(standin.port())
            with standin.fault("drop", device="charger", count=1) as fault:
                assert fault.is_active
                with pytest.raises(ModbusIOException):
                    read(client)
                assert read(client).registers == [275]
                assert fault.hits == 1 and not fault.is_active
            assert fault.hits == 1
            with standin.fault("exception", device=standin.device("charger"), code=6):
                assert read(client).exception_code == 6
            assert read(client).registers == [275]
            outcomes = [entry["outcome"] for entry in standin.journal(device="charger")]
            assert outcomes == ["silence", "reply", "exception", "reply"]
            assert len(standin.journal(outcome="reply", limit=1)) == 1
            standin.clear_journal()
            assert standin.journal() == []
            standin.device("charger").set(fan_on_temperature=50)
            standin.snapshot("warm")
            standin.add_fault("offline")
            standin.reset()
            assert standin.device("charger").raw("fan_on_temperature") == 40
            assert read(client).registers == [275]
            standin.restore("warm")
            assert standin.device("charger").raw("fan_on_temperature") == 50
            assert standin.status()["buses"][0]["counters"]["replies"] == 1
            client.close()
        """,
    )


def test_a_reset_within_a_fault_takes_it_away_once(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        def test_it(standin):
            with standin.fault("drop"):
                standin.reset()
        """,
    )


def test_wider_fixtures_share_a_bench(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        import pytest
        from modbus import connect

        @pytest.fixture(scope="module")
        def running(standin_module_factory):
            return standin_module_factory()

        @pytest.fixture(scope="session")
        def other(standin_session_factory):
            return standin_session_factory("devices.toml", "--rate", "1")

        @pytest.fixture
        def bench(running):
            running.reset()
            return running

        @pytest.mark.parametrize("number", range(20, 24))
        def test_it(bench, running, other, number):
            assert bench is running and bench.port() != other.port()
            assert bench.device("charger").raw("fan_on_temperature") == 40
            bench.device("charger").set(fan_on_temperature=number + 1)
            assert other.clock.rate == 1

        def test_that_fails(bench):
            client = connect(bench.port())
            assert not client.read_holding_registers(12, device_id=5).isError()
        """,
        passed=4,
        failed=1,
    ).stdout.fnmatch_lines(["*standin journal*", "*read holding registers 12+1: exception 02"])


def test_paths_are_where_they_were_named(project: pytest.Pytester, binary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program starts in the folder of its configuration, and a test may have gone elsewhere."""
    (project.mkdir("conf") / "bench.toml").write_text(CONFIG)
    (project.mkdir("bin") / "standin").symlink_to(binary)
    source = """
    import pytest

    @pytest.fixture(autouse=True)
    def elsewhere(tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)

    def test_it(standin):
        pass
    """
    config = ["--standin-config", "conf/bench.toml"]
    monkeypatch.delenv("STANDIN_BIN")
    passes(project, source, *config, "--standin-binary", "bin/standin")
    passes(project, source, *config, "--standin-binary", "bin/standin", "-n", "1")
    monkeypatch.setenv("STANDIN_BIN", "bin/standin")
    passes(project, source, *config)
    monkeypatch.setenv("STANDIN_BIN", "standin-that-is-not-there")
    passes(project, source, *config, "-o", "standin_binary=bin/standin")
    monkeypatch.setenv("PATH", f"{project.path / 'bin'}:{os.environ['PATH']}")
    passes(project, source, *config, "-o", "standin_binary=standin")


def test_a_factory_runs_what_a_test_brings(project: pytest.Pytester) -> None:
    passes(
        project,
        '''
        BENCH = """
        state = "state"
        [control]
        listen = "127.0.0.1:1"
        token = "correct-horse-battery"
        [[bus]]
        name = "a"
        ports = ["pty:/tmp/standin-x/a", "modbus-tcp:127.0.0.1:502", "pty:/tmp/standin-y/a"]
        [[bus.device]]
        name = "one"
        model = "logiccon-trc"
        unit = 1
        [[bus]]
        name = "b"
        port = 'tcp:127.0.0.1:5020'
        [[bus.device]]
        name = "two"
        model = "logiccon-trc"
        unit = 1
        """

        def test_it(standin_factory, standin, tmp_path):
            bench = standin_factory(BENCH, "--rate", "0")
            assert bench.buses == ["a", "b"] and bench.clock.rate == 0
            assert bench.port("b").startswith("127.0.0.1:") and not bench.port("b").endswith(":5020")
            assert len(set(bench.ports("a"))) == 3
            bench.device("two").set(fan_on_temperature=50)
            assert bench.device("one").raw("fan_on_temperature") == 40
            (tmp_path / "token.txt").write_text("horse-battery-staple")
            text = BENCH.replace('token = "correct-horse-battery"', 'token_file = "token.txt"')
            (tmp_path / "bench.toml").write_text(text)
            assert standin_factory(tmp_path / "bench.toml").buses == ["a", "b"]
            other = standin_factory("devices.toml")
            assert other.port() != standin.port()
            kept = standin_factory("devices.toml", "--state", str(tmp_path / "memory"))
            assert (tmp_path / "memory").is_dir()
        ''',
    )


def test_an_option_names_another_configuration(project: pytest.Pytester) -> None:
    project.makefile(".toml", other=CONFIG.replace('"line1"', '"elsewhere"'))
    source = "def test_it(standin):\n    assert standin.buses == ['elsewhere']\n"
    passes(project, source, "--standin-config", "other.toml")


def test_what_does_not_start_says_why(project: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    project.makefile(".toml", devices=CONFIG.replace("logiccon-trc", "logicon-trc"))
    result = passes(project, "def test_it(standin):\n    pass\n", errors=1)
    result.stdout.fnmatch_lines(["*devices.toml:11:9*logiccon-trc*"])
    result.stdout.no_fnmatch_line("*another exception*")
    result = passes(project, "def test_it(standin):\n    pass\n", "--standin-config", "none.toml", errors=1)
    result.stdout.fnmatch_lines(["*none.toml: No such file*"])
    (project.path / "latin.toml").write_bytes("# Gerät\n".encode("latin-1"))
    result = passes(project, "def test_it(standin):\n    pass\n", "--standin-config", "latin.toml", errors=1)
    result.stdout.fnmatch_lines(["*latin.toml: not UTF-8*"])
    wrong = {
        "standin-that-is-not-there": "*no program standin-that-is-not-there*",
        "/dev/null": "*/dev/null is no program that can be run: Permission denied*",
        "true": "*standin does not start:*",
        "echo": "*echo is not standin: it said run /dev/fd/*",
    }
    for program, why in wrong.items():
        monkeypatch.setenv("STANDIN_BIN", program)
        result = passes(project, "def test_it(standin):\n    pass\n", errors=1)
        result.stdout.fnmatch_lines([why])
    project.makeini("[pytest]\n")
    result = passes(project, "def test_it(standin):\n    pass\n", errors=1)
    result.stdout.fnmatch_lines(["*set standin_config*"])


def test_a_failed_test_shows_what_was_asked(project: pytest.Pytester) -> None:
    source = """
    from modbus import connect

    def test_it(standin):
        client = connect(standin.port())
        assert not client.read_holding_registers(12, device_id=5).isError()
    """
    result = passes(project, source, failed=1)
    result.stdout.fnmatch_lines(
        ["*standin journal*", "*charger: read holding registers 12+1: exception 02", "*hint: one less would exist*"]
    )


def test_parallel_runs_do_not_touch_each_other(project: pytest.Pytester) -> None:
    source = """
    import pytest
    from modbus import connect

    @pytest.mark.parametrize("number", range(20, 44))
    def test_it(standin, number):
        client = connect(standin.port())
        assert client.read_holding_registers(10, device_id=5).registers == [40]
        client.write_register(10, number, device_id=5)
        standin.clock.advance(hours=number)
        assert client.read_holding_registers(10, device_id=5).registers == [number]
        assert len(standin.journal()) == 3
        client.close()
    """
    passes(project, source, "-n", "4", passed=24)


def left_behind(folder: Path, pid: int) -> set[str]:
    """Files and programs of the tests that ran in a folder, in a process of that number."""
    found = {str(path) for path in Path(tempfile.gettempdir()).glob(f"standin-{pid}-*")}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().split(b"\0")
            if b"--exit-with-parent" in words and (process / "cwd").resolve() == folder.resolve():
                found.add(process.name)
        except OSError:
            continue
    return found


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_test_process_leaves_nothing(project: pytest.Pytester, number: signal.Signals) -> None:
    project.makepyfile(
        """
        import time
        from pathlib import Path

        def test_it(standin):
            assert Path(standin.port()).is_symlink()
            Path("running").write_text(standin.port())
            time.sleep(60)
        """
    )
    process = subprocess.Popen([sys.executable, "-m", "pytest"], cwd=project.path, stdout=subprocess.DEVNULL)
    running = project.path / "running"
    while not (running.exists() and running.read_text()):
        assert process.poll() is None
        time.sleep(0.05)
    port = running.read_text()
    assert os.path.islink(port) and len(left_behind(project.path, process.pid)) == 2
    process.send_signal(number)
    process.wait()
    end = time.monotonic() + 15
    while left_behind(project.path, process.pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert left_behind(project.path, process.pid) == set()
