"""Contacts, progress and outcome, on value objects."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.envs.carla.episode import RELEASE, Contacts, Events, Progress, judge
from haim_torchrl.envs.path import Path, Piece, arc, draw

STRAIGHT = Path.through(np.arange(300.0), np.zeros(300))


def test_a_lasting_contact_is_one_event():
    contacts = Contacts()
    assert contacts.update([(1, "a"), (2, "a")]) == ["a"]
    assert contacts.update([(3, "a")]) == []
    assert contacts.update([]) == []
    assert contacts.update([(8, "a")]) == []  # five frames later


def test_a_contact_that_was_let_go_is_a_new_one():
    contacts = Contacts()
    contacts.update([(10, "a")])
    assert contacts.update([(10 + RELEASE + 1, "a")]) == ["a"]


def test_two_at_once_are_two_events():
    assert Contacts().update([(5, "a"), (5, "b"), (6, "a")]) == ["a", "b"]


@given(st.lists(st.tuples(st.integers(0, 60), st.sampled_from("ab")), max_size=30))
def test_events_are_the_gaps_in_the_reports(reports):
    """Handed over in order, all at once or one by one, they are the same events."""
    reports.sort()
    expected = 0
    for other in "ab":
        frames = [frame for frame, who in reports if who == other]
        expected += sum(later - before > RELEASE for before, later in pairwise(frames)) + bool(
            frames
        )
    contacts = Contacts()
    assert sum(len(contacts.update([report])) for report in reports) == expected


def test_progress_by_hand():
    progress = Progress(STRAIGHT, 100.0)
    assert progress.share == 0.0
    assert progress.update((110.0, 1.5, 0.2)) == pytest.approx(10.0)
    assert (progress.s, progress.d, progress.error) == pytest.approx((110.0, 1.5, 0.2))
    assert progress.share == pytest.approx(10.0 / (299.0 - 8.0 - 100.0))
    assert not progress.arrived
    progress.update((180.0, 0.0, 0.0))
    progress.update((260.0, 0.0, 0.0))
    assert progress.update((291.0, 0.0, 0.0)) == pytest.approx(31.0)
    assert progress.arrived
    assert progress.share == 1.0


def test_a_route_that_comes_back_beside_itself_does_not_mislead():
    """Out 150 m, round, and back 4 m beside: left of its lane the AV is nearer to the way back."""
    path = draw([Piece(150.0), arc(2.0, -np.pi), Piece(150.0)])
    progress = Progress(path, 20.0)
    for x in range(20, 60):
        progress.update((float(x), 0.0, 0.0))
    moved = progress.update((60.0, -2.5, 0.0))
    assert moved == pytest.approx(1.0)
    assert progress.d == pytest.approx(-2.5)


@pytest.mark.parametrize(
    ("pose", "collisions", "drivable", "expected"),
    [
        ((150.0, 0.0, 0.0), 0, True, Events()),
        ((150.0, 4.0, 0.0), 0, True, Events()),
        ((150.0, 4.0, 0.0), 0, False, Events(out_of_road=True)),
        ((150.0, 2.1, 0.0), 0, False, Events()),  # a gap beside the route's own lane
        ((150.0, -5.1, 0.0), 0, True, Events(out_of_road=True)),
        ((150.0, 0.0, 1.6), 0, True, Events(wrong_way=True)),
        ((150.0, 0.0, 1.5), 0, True, Events()),
        ((150.0, 0.0, 0.0), 2, True, Events(crash=True, cost=2.0)),
        ((292.0, 0.0, 0.0), 0, True, Events(success=True)),
        ((292.0, 0.0, 0.0), 1, True, Events(crash=True, cost=1.0)),
        ((292.0, 0.0, 3.0), 0, True, Events(wrong_way=True)),
    ],
)
def test_outcomes(pose, collisions, drivable, expected):
    progress = Progress(STRAIGHT, pose[0] - 1.0)
    progress.update(pose)
    assert judge(progress, collisions, drivable, 4.0, off_route=5.0) == expected
