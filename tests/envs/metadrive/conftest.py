"""MetaDrive for tests. A process may hold one engine, so a new simulator closes the last one."""

import pytest

pytest.importorskip("metadrive", reason='pip install "haim-torchrl[metadrive]"')

from haim_torchrl.envs.metadrive import MetaDriveConfig
from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

_open: list[tuple[dict, MetaDriveSimulator]] = []


@pytest.fixture
def make_simulator():
    """Makes a simulator with settings, or hands out the one that is open with the same ones."""

    def make(**settings) -> MetaDriveSimulator:
        if _open and _open[0][0] == settings:
            return _open[0][1]
        close_simulator()
        simulator = MetaDriveSimulator(MetaDriveConfig.of({"scenarios": 10, **settings}))
        _open.append((settings, simulator))
        return simulator

    return make


def close_simulator() -> None:
    """Close the simulator that is open, if one is."""
    while _open:
        _open.pop()[1].close()


@pytest.fixture(scope="module", autouse=True)
def leave_no_engine():
    """Tests of other modules may start engines of their own in this process."""
    yield
    close_simulator()


@pytest.fixture
def no_engine():
    """This process holds no engine when the test begins, and none when it has ended."""
    close_simulator()
    yield
    close_simulator()


@pytest.fixture
def free_road(make_simulator):
    """A simulator without traffic and accidents, seen with MetaDrive's own lasers."""
    return make_simulator(
        traffic_density=0.0, accident_probability=0.0, observation={"view": "rays"}
    )
