"""Processors, processes, shared memory, disk and clock, as they are here."""

from __future__ import annotations

from pathlib import Path

import pytest

from haim_torchrl.doctor import Check, machine, run_checks


def test_the_cpu_computes() -> None:
    assert machine.devices()[0] == Check("cpu", "ok", "computes")


def test_threads_are_told() -> None:
    assert machine.threads().status == "ok"


def test_prioritised_replay_is_said_to_work_only_if_it_does() -> None:
    from torchrl.data import PrioritizedSampler

    try:
        PrioritizedSampler(8, alpha=0.6, beta=0.4)
        works = True
    except RuntimeError:
        works = False
    assert machine.prioritised_replay().status == ("ok" if works else "warn")


def test_a_process_starts() -> None:
    assert machine.processes().status == "ok"


def test_a_process_that_does_not_start_in_time() -> None:
    check = machine.processes(patience=0.0)
    assert check.status == "warn" and "not started within 0 s" in check.detail


def test_shared_memory(tmp_path: Path) -> None:
    assert machine.shared_memory(tmp_path, enough=1).status == "ok"
    check = machine.shared_memory(tmp_path, enough=2**60)
    assert check.status == "warn" and "--shm-size" in check.fix
    assert machine.shared_memory(tmp_path / "none").status == "info"


def test_runs_folder_that_the_first_run_will_make(tmp_path: Path) -> None:
    assert machine.runs_folder(tmp_path / "runs").status == "ok"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc on this system")
def test_runs_folder_that_cannot_be_written_to() -> None:
    check = machine.runs_folder(Path("/proc/self/runs"))
    assert check.status == "fail"
    assert "cannot write to /proc/self" in check.detail
    assert "hydra.run.dir" in check.fix


def test_runs_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    assert machine.runs_folder(tmp_path / "runs").status == "fail"


def test_clock_measures_how_late_it_wakes() -> None:
    check = machine.clock(naps=3, nap=0.01)
    assert check.status in ("ok", "warn")
    assert "at worst of 3" in check.detail


def test_a_check_that_breaks_does_not_stop_the_others() -> None:
    def broken_thing() -> Check:
        raise ZeroDivisionError("no way")

    first, second = run_checks((broken_thing, machine.threads))
    assert first == Check("broken thing", "fail", "the check broke: ZeroDivisionError: no way")
    assert second.name == "threads"
