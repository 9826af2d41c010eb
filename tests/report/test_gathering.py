"""Reading runs: what counts, what is left out, and what is said about it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from haim_torchrl.report.gathering import gather
from haim_torchrl.report.runs import COURSE_POINTS, publish

Writer = Callable[..., Path]


def test_folders_are_searched_and_seeds_ordered(write_run: Writer, tmp_path: Path) -> None:
    for seed in (2, 0, 1):
        write_run("haim", seed, [1, 0])
    write_run("haco", 0, [1, 1], folder="more")
    found = gather([tmp_path / "runs", tmp_path / "more"])
    assert [run.seed for run in found.methods["haim"].runs] == [0, 1, 2]
    assert found.methods["haco"].scores("success").figures().tolist() == [1.0]
    assert found.problems == ["haco has no run of seeds 1, 2, which other methods have"]


def test_a_long_course_is_thinned_and_mentor_steps_stand_at_the_validations(
    write_run: Writer,
) -> None:
    folder = write_run("haim", 0, [1], frames=20_000, mentor=300)
    (run,) = gather([folder]).methods["haim"].runs
    assert len(run.course["frames"]) == COURSE_POINTS
    assert (run.course["frames"][-1], run.course["mentor_steps"][-1]) == (20_000, 300)
    at = dict(zip(run.validation["frames"], run.validation["mentor_steps"]))
    assert at[500] == pytest.approx(15.0) and at[10_000] == 300


def test_the_published_form_is_the_run(write_run: Writer, tmp_path: Path) -> None:
    write_run("haim", 0, [1, 0], hard_brakes=3)
    write_run("haim", 1, [1, 1])
    first = gather([tmp_path / "runs"])
    path = publish(first.runs(), tmp_path / "runs.json")
    assert str(tmp_path) not in path.read_text()
    second = gather([path])
    assert second.runs() == first.runs() and not second.problems
    # Given both, each run counts once.
    assert gather([tmp_path]).runs() == first.runs()


def test_a_run_gone_on_with_counts_as_it_ended(write_run: Writer) -> None:
    folder = write_run("haim", 0, [0])
    contents = json.loads((folder / "metrics.json").read_text())
    contents["training"]["frames"] = 2000
    (folder / "metrics_2000.json").write_text(json.dumps(contents))
    (run,) = gather([folder]).runs()
    assert run.total("frames") == 2000


def test_an_evaluation_tells_how_the_mentor_drives(write_run: Writer, tmp_path: Path) -> None:
    contents = json.loads((write_run("haim", 0, [1, 1]) / "metrics.json").read_text())
    shutil.rmtree(tmp_path / "runs")
    drivers = {name: {"episodes": contents["episodes"]} for name in ("mentor", "policy")}
    path = tmp_path / "metrics.json"
    path.write_text(json.dumps({"checkpoint": None, "drivers": drivers}))
    found = gather([tmp_path])
    assert list(found.methods) == ["mentor"] and not found.methods["mentor"].trained
    (tmp_path / "config.yaml").write_text("eval: {set: validation}\n")  # chosen on, so no test
    assert not gather([tmp_path]).methods


def _broken(folder: Path) -> None:
    text = (folder / "metrics.json").read_text()
    (folder / "metrics.json").write_text(text[: len(text) // 2])


def _without(key: str) -> Callable[[Path], None]:
    def remove(folder: Path) -> None:
        contents = json.loads((folder / "metrics.json").read_text())
        del contents[key]
        (folder / "metrics.json").write_text(json.dumps(contents))

    return remove


def _unfinished(folder: Path) -> None:
    (folder / "metrics.json").unlink()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (_broken, "cannot be read"),
        (_without("episodes"), "has no 'episodes'; it is left out"),
        (_without("seed"), "has no 'seed'; it is left out"),
        (_unfinished, "has no metrics.json, since its run has not come to its end"),
        (shutil.rmtree, "does not exist; its runs are missing"),
    ],
)
def test_what_is_half_there_is_left_out_with_a_sentence(
    write_run: Writer, damage: Callable[[Path], None], words: str
) -> None:
    good, bad = write_run("haim", 0, [1]), write_run("haco", 0, [1])
    damage(bad)
    found = gather([good, bad])
    assert list(found.methods) == ["haim"]
    assert len(found.problems) <= 2 and words in found.problems[0]
    assert str(bad) in found.problems[0]


def test_a_foreign_file_is_named(write_run: Writer, tmp_path: Path) -> None:
    foreign = tmp_path / "runs.json"
    foreign.write_text('{"format": "another"}')
    later = tmp_path / "later.json"
    later.write_text('{"format": "haim_torchrl runs", "version": 99, "runs": []}')
    found = gather([foreign, later])
    assert not found.methods
    assert "is no runs.json of a report" in found.problems[0]
    assert "has version 99" in found.problems[1]


def test_two_runs_of_one_seed_are_named(write_run: Writer) -> None:
    first = write_run("haim", 0, [1, 1])
    second = write_run("haim", 0, [0, 0], folder="again")
    found = gather([first, second])
    assert found.methods["haim"].scores("success").figures().tolist() == [1.0]
    (problem,) = found.problems
    assert "two runs of seed 0" in problem and str(second) in problem


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"frames": 500}, "different numbers of environment steps (1000, 500)"),
        ({"settings": "b"}, "have different settings"),
        ({"first": 20001}, "its figures are over the 1 that all of them share"),
        ({"first": 90000}, "share no test scenario, so that it has no figures"),
    ],
)
def test_runs_that_do_not_belong_together_are_named(
    write_run: Writer, tmp_path: Path, other: dict[str, int], words: str
) -> None:
    write_run("haim", 0, [1, 0])
    write_run("haim", 1, [1, 0], **other)
    (problem,) = gather([tmp_path]).problems
    assert words in problem
