"""The report recipe from run folders to one page."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from haim_torchrl.report.runs import FinishedRun, publish
from haim_torchrl.report.settings import Settings

TABLES = ("report.md", "table1.csv", "table2.csv", "improvement.csv", "effort.csv")


class Links(HTMLParser):
    """All addresses that a page refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("script", "link", "iframe"), tag
        self.found += [value or "" for name, value in attrs if name in ("src", "href")]


def finished(name: str, seed: int, mentor: int) -> FinishedRun:
    frames = [500, 1000]
    return FinishedRun(
        name,
        seed,
        {"frames": 1000, "mentor_steps": mentor, "violations": 1, "seconds": 60},
        Settings("platoon", 1000),
        1000,
        {
            "scenario": [20000, 20001],
            "outcome": ["success", "crash"],
            "violations": [0, 1],
            "reward": [300.0, 100.0 + seed],
            "steps": [100, 50],
            "hard_brakes": [0, 1],
            "distance": [50, 25],
            "duration": [10, 5],
        },
        {
            "frames": frames,
            "mentor_steps": [mentor // 2, mentor],
            "success": [0.5, 1.0],
            "return": [100.0, 200.0],
            "violations": [0.5, 0.0],
            "disturbance_rate": [0.01, 0.0],
        },
        {"frames": frames, "mentor_steps": [mentor // 2, mentor], "violations": [0, 1]},
    )


def test_a_page_with_everything_in_it(tmp_path: Path, command: Callable[..., Any]) -> None:
    runs = [finished("haim", 0, 300), finished("haim", 1, 310), finished("sac_rs", 0, 0)]
    publish(runs, tmp_path / "given.json")
    outcome = command("report", "runs=[given.json,nowhere]", "output=out", "resamples=100")
    assert outcome.code == 0, outcome.err
    assert "nowhere does not exist; its runs are missing from the tables" in outcome.out
    out = tmp_path / "out"
    page = (out / "report.html").read_text()
    links = Links()
    links.feed(page)
    assert links.found and all(link.startswith("data:image/png;base64,") for link in links.found)
    assert base64.b64decode(links.found[0].split(",")[1])[:4] == b"\x89PNG"
    assert not re.search(r"url\(|@import", page)
    assert "nowhere does not exist" in page and "sac_rs has no run of seed 1" in page
    for name in (*TABLES, "runs.json", "fig6.png"):
        assert (out / name).stat().st_size > 0, name
    assert not (out / "fig9.png").exists()  # nobody of that figure beside the reference

    # Its runs.json gives the same tables again.
    again = command("report", "runs=out/runs.json", "output=again", "resamples=100")
    assert again.code == 0, again.err
    for name in TABLES[1:]:
        assert (tmp_path / "again" / name).read_text() == (out / name).read_text(), name
    assert (tmp_path / "again" / "runs.json").read_text() == (out / "runs.json").read_text()


def test_real_runs_side_by_side(trained: Any, tmp_path: Path, command: Callable[..., Any]) -> None:
    name = json.loads((trained.folder / "metrics.json").read_text())["name"]
    outcome = command(
        "report", f"runs={trained.folder}", "resamples=100", f"reference={name}",
        f"side_by_side=[{name},haco]",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert "no run folder of haco was given, so it cannot drive" in outcome.out
    assert (tmp_path / "report" / "fig10.png").stat().st_size > 10_000
    assert (tmp_path / "report" / f"top_view_{name}.png").exists()
    assert len((tmp_path / "report" / "runs.json").read_text()) < 5000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["runs=[]"], "runs names nothing"),
        (["runs=[nowhere]"], "hold no finished run"),
        (["runs=[nowhere]", "level=95"], "level must lie between 0 and 1"),
        (["runs=[nowhere]", "resamples=0"], "resamples must be at least 1"),
        (["runs=[nowhere]", "scenario=first"], "could not be converted to Integer"),
        (["run=[nowhere]"], "Could not override 'run'"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], words: str, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command("report", *arguments)
    assert outcome.code == 2 and words in outcome.err
    assert "Traceback" not in outcome.err
    assert not list(tmp_path.iterdir())
