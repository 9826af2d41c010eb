"""Pictures show what was recorded."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.evaluation.curves import draw_curves, smooth
from haim_torchrl.evaluation.drivers import StraightDriver
from haim_torchrl.evaluation.evaluator import evaluate
from haim_torchrl.evaluation.pictures import COLORS, animate, corners, platoon_figure, top_view
from haim_torchrl.evaluation.recording import Episode
from haim_torchrl.evaluation.training_log import CsvTable


@pytest.fixture
def episode(toy_road: Any) -> Episode:
    return evaluate(StraightDriver(), toy_road, [1], record=[1]).episodes[0]


def has_color(image: np.ndarray, color: str) -> bool:
    wanted = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return bool((np.abs(image[..., :3].astype(int) - wanted).max(-1) <= 2).any())


def test_corners_turn_with_the_heading() -> None:
    turned = corners(np.array([[10.0, 5.0, np.pi / 2, 4.0, 2.0]]))[0]
    assert turned == pytest.approx(np.array([[9.0, 7.0], [9.0, 3.0], [11.0, 3.0], [11.0, 7.0]]))


@given(
    st.floats(-50, 50), st.floats(-50, 50), st.floats(-4, 4), st.floats(0.5, 9), st.floats(0.5, 3)
)
def test_corners_keep_centre_and_area(
    x: float, y: float, heading: float, length: float, width: float
) -> None:
    box = corners(np.array([[x, y, heading, length, width]]))[0]
    assert box.mean(0) == pytest.approx([x, y], abs=1e-9)
    a, b = box[1] - box[0], box[3] - box[0]
    assert abs(a[0] * b[1] - a[1] * b[0]) == pytest.approx(length * width)


def test_top_view_shows_every_kind(episode: Episode, tmp_path: Path) -> None:
    aside = np.array([[18.0, 1.5, 0.0, 1.0, 0.5]])  # the one that was hit is under the vehicle
    episode.snapshots[-1] = dataclasses.replace(episode.snapshots[-1], obstacles=aside)
    image = imageio.imread(top_view(episode, tmp_path / "top.png", scenes=1))
    for kind in ("vehicle", "followers", "obstacles", "edge"):
        assert has_color(image, COLORS[kind]), kind
    assert not has_color(image, COLORS["mentor"])


def test_mentor_driven_path_is_red(episode: Episode, tmp_path: Path) -> None:
    episode.interventions = [True] * len(episode)
    image = imageio.imread(top_view(episode, tmp_path / "top.png", scenes=1))
    assert has_color(image, COLORS["mentor"])


def test_platoon_has_three_rows_for_each_episode(episode: Episode, tmp_path: Path) -> None:
    one = imageio.imread(platoon_figure([("a", episode)], tmp_path / "one.png"))
    two = imageio.imread(platoon_figure([("a", episode), ("b", episode)], tmp_path / "two.png"))
    assert two.shape[1] == 2 * one.shape[1] and two.shape[0] == one.shape[0]
    assert has_color(one, COLORS["vehicle"]) and has_color(one, COLORS["mentor"])


def test_film_ends_with_the_episode_and_is_bounded(episode: Episode, tmp_path: Path) -> None:
    film = imageio.imread(animate(episode, tmp_path / "a.gif", every=3))
    assert film.shape == (5, 320, 640, 3)  # scenes 0, 3, 6, 9 and the last, 10
    short = imageio.imread(animate(episode, tmp_path / "b.gif", every=1, max_frames=4))
    assert len(short) <= 5


def test_curves_of_a_run_and_of_nothing(tmp_path: Path) -> None:
    empty = imageio.imread(draw_curves(tmp_path, tmp_path / "empty.png"))
    table = CsvTable(tmp_path / "train.csv")
    for k in range(60):
        table.append({"frames": 100 * (k + 1), "takeover_rate": 0.5, "violations_total": k})
    full = imageio.imread(draw_curves(tmp_path, tmp_path / "full.png"))
    assert full.shape == empty.shape
    assert has_color(full, COLORS["vehicle"]) and not has_color(empty, COLORS["vehicle"])


def test_smoothing_by_hand() -> None:
    values = np.array([0.0, 3.0, 6.0, np.nan, 12.0])
    assert smooth(values, 3).tolist() == [1.5, 3.0, 4.5, 9.0, 12.0]
    assert smooth(values[:3], 1).tolist() == [0.0, 3.0, 6.0]
