"""The hand-written town, as a map and behind a stand-in for a server."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from .opendrive import town

QUIET = {"traffic": 0, "pedestrians": 0, "obstacles": [1.0]}
"""Settings for a world without anybody else."""


@pytest.fixture(scope="session")
def opendrive() -> str:
    """The town as OpenDRIVE."""
    return town()


@pytest.fixture(scope="session")
def town_map(opendrive: str) -> Any:
    """The town as the client package's own map."""
    carla = pytest.importorskip("carla")
    return carla.Map("Town01", opendrive)


@pytest.fixture
def server(opendrive: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> Any:
    """A stand-in for a server, which no other process has locked."""
    pytest.importorskip("carla")
    from .stand_in import Server

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return Server(opendrive)


@pytest.fixture
def simulator(server: Any) -> Iterator[Callable[..., Any]]:
    """Makes simulators on the stand-in, with nobody else in the world unless settings say so."""
    from haim_torchrl.envs.carla import CarlaSimulator

    made = []

    def make(**settings: Any) -> CarlaSimulator:
        made.append(CarlaSimulator({**QUIET, **settings}, server.client))
        return made[-1]

    yield make
    for one in made:
        one.close()
