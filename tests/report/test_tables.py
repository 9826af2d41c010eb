"""Tables from runs: figures, gaps, the paper's column."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from haim_torchrl.report.effort import effort_table
from haim_torchrl.report.gathering import gather
from haim_torchrl.report.improvement import improvement_table
from haim_torchrl.report.paper import figures, known, rows
from haim_torchrl.report.runs import publish, read_published
from haim_torchrl.report.table import ReportTable
from haim_torchrl.report.tables import table1, table2

Writer = Callable[..., Path]
RESAMPLES = 200


@pytest.fixture
def folder(write_run: Writer, tmp_path: Path) -> Path:
    for seed, successes in enumerate(([1, 1, 1, 0], [1, 1, 0, 0], [1, 1, 1, 1])):
        write_run("haim", seed, successes, hard_brakes=seed)
    write_run("haco", 0, [0, 0, 0, 1])
    return tmp_path / "runs"


def cells(table: ReportTable, row: int) -> dict[str, str]:
    """A row by heading; of the paper's columns the last."""
    return dict(zip(table.columns, table.rows[row]))


def test_table_1_has_the_papers_rows_and_figures() -> None:
    assert [row.title for row in rows("table1")[1:]] == [
        "SAC-RS", "PPO-RS", "SAC-Lag", "PPO-Lag", "CPO", "CQL", "BC", "GAIL", "HG-DAgger", "IWR",
        "HACO", "HAIM-DRL",
    ]  # fmt: skip
    assert known("haim").paper["success"] == (0.85, 0.03)  # type: ignore[index]
    assert known("ppo_rs").paper["training_violations"] == (27510, 3860)  # type: ignore[index]
    assert len(rows("table2")) == 5
    names = {row.name for table in ("table1", "table2", "further") for row in rows(table)}
    assert {name for figure in figures() for name in figure.names} <= names


def test_figures_by_hand(folder: Path) -> None:
    methods = gather([folder]).methods
    table = table1(methods, resamples=RESAMPLES)
    haim = next(row for row in table.numbers if row["method"] == "haim")
    # Successes of .75, .5 and 1: the outer two weigh a quarter each.
    assert haim["seeds"] == 3 and haim["success"] == pytest.approx(0.75)
    assert haim["return"] == pytest.approx(250.0) and haim["violations"] == pytest.approx(0.25)
    assert haim["disturbance_rate"] == pytest.approx(0.01)  # 0, 1 and 2 of 100 steps
    assert haim["minutes"] == pytest.approx(2.5) and haim["frames"] == 1000
    assert haim["success_low"] < 0.75 < haim["success_high"]
    assert (haim["success_paper"], haim["success_paper_sd"]) == (0.85, 0.03)
    shown = cells(table, -1)
    assert shown["method"] == "HAIM-DRL" and shown["seeds"] == "3"
    assert shown["training data usage"] == "1000" and shown["mentor steps"] == "200"


def test_a_method_without_runs_is_a_gap_with_a_reason(folder: Path) -> None:
    table = table1(gather([folder]).methods, resamples=RESAMPLES)
    cpo = next(row for row in table.rows if row[1] == "CPO")
    assert cpo[2:5] == ["0", "-", "4360 ± 2220"]
    (note,) = (note for note in table.notes if note.startswith("CPO: "))
    assert note.endswith("made by `python recipes/on_policy.py algorithm=cpo`.")
    assert "One seed, so that intervals are over scenarios only: HACO." in table.notes


def test_methods_that_the_paper_has_not_come_last(write_run: Writer, tmp_path: Path) -> None:
    write_run("pvp", 0, [1])
    write_run("mine", 0, [1])
    table = table1(gather([tmp_path]).methods, resamples=RESAMPLES)
    assert [row[:2] for row in table.rows[-2:]] == [
        ["not in the paper", "mine"],
        ["Human-AI copilot", "PVP"],
    ]


def test_table_2_takes_the_same_runs(folder: Path) -> None:
    table = table2(gather([folder]).methods, resamples=RESAMPLES)
    shown = cells(table, 3)
    assert shown["method"] == "(d) no implicit intervention"
    assert shown["test success rate"].startswith("0.25")
    assert table.rows[0][1] == "0"


def test_improvement_over_each_other_method(folder: Path, write_run: Writer) -> None:
    write_run("bc", 0, [1], first=90000)
    methods = gather([folder]).methods
    table = improvement_table(methods, "haim", resamples=RESAMPLES)
    numbers = {row["method"]: row for row in table.numbers}
    assert numbers["haco"]["success_value"] == 1.0  # all three seeds arrive more often
    assert numbers["haco"]["disturbance_rate_value"] == pytest.approx(0.5 / 3)  # a tie, two lost
    assert numbers["bc"]["success_value"] is None
    assert "BC was not tested on the same scenarios of the same world." in table.notes
    nobody = improvement_table(methods, "cpo")
    assert not nobody.rows and "no finished run of cpo" in nobody.notes[0]


def test_effort_and_commands(folder: Path) -> None:
    table = effort_table(gather([folder]).methods, resamples=RESAMPLES)
    haco, haim = (cells(table, place) for place in (0, 1))
    assert haco["minutes"] == "1.5" and haim["seeds"] == "0, 1, 2" and haim["paper"] == "65"
    assert haco["command"] == "python recipes/haim.py method=haco seed=0 total_frames=1000"


@pytest.mark.parametrize(
    ("given", "shown"),
    [("platoon/expert-v0", "platoon/expert-v0"), ("/data/of/mine/expert-v0", "expert-v0")],
)
def test_a_command_names_the_demonstrations(write_run: Writer, given: str, shown: str) -> None:
    where = write_run("gail", 0, [1])
    config = json.loads((where / "config.yaml").read_text())
    (where / "config.yaml").write_text(json.dumps({**config, "demonstrations": given}))
    gathered = gather([where.parent]).methods
    published = read_published(publish(gathered["gail"].runs, where / "runs.json"))
    assert published[0].settings.demonstrations == shown
    command = cells(effort_table(gathered, resamples=RESAMPLES), 0)["command"]
    assert command.endswith(f"algorithm=gail seed=0 total_frames=1000 demonstrations={shown}")


def test_forms_of_a_table(tmp_path: Path) -> None:
    table = ReportTable(
        "small", "A & B", ["a", "b"], [["1", "<2>"]], ["note"], [{"a": 1, "b": None}]
    )
    assert "| 1 | <2> |" in table.markdown() and "note" in table.markdown()
    assert "<td>&lt;2&gt;</td>" in table.html() and "A &amp; B" in table.html()
    with table.write_csv(tmp_path).open() as stream:
        assert list(csv.DictReader(stream)) == [{"a": "1", "b": ""}]
