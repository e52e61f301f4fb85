"""A bench whose faults, threads and program come and go."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import passes


def test_a_fault_ends_with_what_took_it_away(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        from modbus import connect

        def test_it(standin):
            client = connect(standin.port())
            with standin.fault("delay", device="charger", ms=1) as before:
                client.read_holding_registers(3, device_id=5)
                standin.reset()
                assert before.hits == 1 and not before.is_active
                after = standin.add_fault("delay", ms=1)
                assert after.id == before.id, "numbers start anew"
            assert after.is_active
            standin.snapshot("one")
            with standin.fault("drop") as later:
                standin.restore("one")
                assert not later.is_active and after.is_active
                other = standin.add_fault("delay", ms=2)
                assert other.id == later.id
            assert other.is_active
            standin.clear_faults()
            assert not other.is_active and not after.is_active
            client.close()
        """,
    )


def test_threads_ask_side_by_side(project: pytest.Pytester) -> None:
    passes(
        project,
        """
        from concurrent.futures import ThreadPoolExecutor

        def test_it(standin):
            with ThreadPoolExecutor(8) as pool:
                shown = pool.map(lambda _: standin.device("heater").get("rtc_year"), range(200))
                standin.clock.advance(days=1)
                assert set(shown) == {14}
        """,
    )


def test_a_program_that_has_ended_is_told_of(project: pytest.Pytester) -> None:
    result = passes(
        project,
        """
        import os, signal
        from pathlib import Path

        def test_it(standin):
            Path("port").write_text(standin.port())
            children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
            for child in children:
                os.kill(int(child), signal.SIGKILL)
            standin.clock.now
        """,
        failed=1,
    )
    result.stdout.fnmatch_lines(["*ConnectionError: standin at http://127.0.0.1:* does not answer*"])
    port = (project.path / "port").read_text()
    assert port.endswith("-line1") and not Path(port).is_symlink(), "the program could not take its link away"
