"""Connecting, taking a world, and leaving it as it was."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

from haim_torchrl.envs.carla import CarlaConfig, CarlaSimulator
from haim_torchrl.envs.carla.client import connect
from haim_torchrl.envs.carla.seat import Seat

from .conftest import QUIET

carla = pytest.importorskip("carla")
DRIVE = np.array([0.5, 0.0])


def is_as_found(server) -> bool:
    settings = server.settings
    managers = [manager.synchronous for manager in server.managers.values()]
    return not (settings.synchronous_mode or settings.no_rendering_mode or any(managers))


def test_a_world_is_taken_in_synchronous_steps(server, simulator):
    simulator(traffic=2).reset(seed=5)
    settings = server.settings
    assert settings.synchronous_mode
    assert settings.fixed_delta_seconds == pytest.approx(0.1)
    assert settings.max_substeps * settings.max_substep_delta_time == pytest.approx(0.1)
    assert settings.no_rendering_mode
    assert server.managers[8000].synchronous
    assert server.managers[8000].seed == 5
    assert "pedestrians 5" in server.calls


def test_close_puts_everything_back_and_may_be_called_twice(server, simulator):
    sim = simulator(traffic=3, pedestrians=2, obstacles=[0.0, 1.0])
    sim.reset(seed=0)
    assert len(server.alive) == 1 + 1 + 5 + 3 + 2 * 2 + 1  # with sensor and controllers
    working = [actor for actor in server.alive if "sensor" in actor.type_id or actor.started]
    assert len(working) == 3
    sim.close()
    assert not server.alive
    assert all(actor.stopped for actor in working)
    assert is_as_found(server)
    calls = list(server.calls)
    sim.close()
    assert server.calls == calls


def test_a_new_episode_leaves_nothing_of_the_last(server, simulator):
    sim = simulator(traffic=3)
    sim.reset(seed=0)
    before = set(server.alive)
    sim.reset(seed=1)
    assert len(server.alive) == len(before)
    assert not before & set(server.alive)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_leaving_a_with_puts_everything_back(server, error):
    with pytest.raises(error), CarlaSimulator(QUIET, server.client) as sim:
        sim.reset(seed=0)
        raise error
    assert not server.alive
    assert is_as_found(server)


def test_forgetting_a_simulator_puts_everything_back(server):
    sim = CarlaSimulator(QUIET, server.client)
    sim.reset(seed=0)
    assert not is_as_found(server)
    del sim
    assert not server.alive
    assert is_as_found(server)


def test_a_reset_that_fails_leaves_nothing_behind(server, simulator):
    sim = simulator()
    sim.reset(seed=0)
    sim.close()
    x, y, _ = sim._drive.scenario.route.path.at(sim._drive.scenario.start)
    library = server.world.get_blueprint_library()
    lorry = server.world.try_spawn_actor(
        library.find("vehicle.audi.a2"), carla.Transform(carla.Location(x=x, y=y))
    )
    with pytest.raises(RuntimeError, match="could not place the hero"):
        sim.reset(seed=0)
    sim.close()
    assert server.alive == [lorry]
    assert is_as_found(server)


def test_a_server_that_dies_is_not_waited_for_again_and_again(server, simulator):
    sim = simulator(traffic=5)
    sim.reset(seed=0)
    server.answers = False
    with pytest.raises(RuntimeError, match="time-out"):
        sim.step(DRIVE)
    calls = list(server.calls)
    sim.close()
    assert server.calls == calls


def test_a_town_is_loaded_while_the_clock_runs(server, simulator):
    """A traffic manager or a world that waits for ticks would keep it from being loaded."""
    sim = simulator(traffic=2)
    sim.reset(seed=0)
    sim.reset(seed=20_000)
    calls = [call for call in server.calls if not call.startswith("pedestrians")]
    loading = ["synchronous False", "load Town01", "synchronous True"]
    assert calls == [*loading, "synchronous False", "load Town02", "synchronous True"]
    sim.step(DRIVE)


def test_a_traffic_manager_that_does_not_answer_keeps_nothing_from_being_put_back(
    server, simulator
):
    sim = simulator(traffic=2)
    sim.reset(seed=0)

    def silent(on):
        raise RuntimeError("rpc::timeout: Timeout of 2000ms")

    server.managers[8000].set_synchronous_mode = silent
    sim.close()
    assert not server.settings.synchronous_mode
    assert not server.alive


def test_no_server_is_said_in_one_sentence(server):
    """By the real client, which waits as long as it was told."""
    begin = time.monotonic()
    with pytest.raises(RuntimeError) as failure:
        connect("127.0.0.1", 1, 0.3)
    assert time.monotonic() - begin < 5.0
    assert str(failure.value).startswith("no CARLA server answered at 127.0.0.1:1 within 0.3 s")
    assert "CarlaUE4.sh" in str(failure.value)


def test_another_version_is_said_with_the_remedy(server):
    server.version = "0.9.15"
    with pytest.raises(RuntimeError, match=r"0\.9\.15.*pip install carla==0\.9\.15"):
        CarlaSimulator({}, server.client)


def test_an_unknown_town_is_said_with_the_known_ones(server):
    with pytest.raises(RuntimeError, match=r"no town Town99.*Town01, Town02"):
        CarlaSimulator({"train_town": "Town99"}, server.client)


def test_two_simulators_take_turns_at_one_server(server, simulator):
    """As validation does in the middle of training."""
    training, validation = simulator(), simulator()
    training.reset(seed=0)
    training.step(DRIVE)
    validation.reset(seed=10_000)
    assert len(server.alive) == 7
    validation.step(DRIVE)
    frame = server.world.frame
    before = training.snapshot()
    _, reward, terminated, truncated, info = training.step(DRIVE)
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert not any(info[key] for key in ("crash", "out_of_road", "success", "cost"))
    assert server.world.frame == frame  # the other one's clock was not touched
    np.testing.assert_array_equal(training.snapshot().vehicle, before.vehicle)
    training.reset()
    training.step(DRIVE)
    assert validation.step(DRIVE)[3]
    validation.close()
    assert server.settings.synchronous_mode  # it is not that one's any more
    training.close()
    assert is_as_found(server)
    assert not server.alive


def test_two_servers_are_driven_side_by_side(opendrive, server, simulator):
    from .stand_in import Server

    servers = {2000: server, 2004: Server(opendrive)}
    make = lambda host, port: servers[port].client(host, port)  # noqa: E731
    first = CarlaSimulator({**QUIET, "ports": [2000, 2004]}, make)
    second = CarlaSimulator({**QUIET, "ports": [2000, 2004]}, make)
    with first, second:
        first.reset(seed=0)
        second.reset(seed=0)
        assert not first.step(DRIVE)[3]
        assert not second.step(DRIVE)[3]
        assert len(servers[2000].alive) == len(servers[2004].alive) == 7
    assert is_as_found(servers[2000])
    assert is_as_found(servers[2004])


def test_a_server_that_another_process_drives_is_not_touched(server, tmp_path):
    seat = Seat(CarlaConfig(ports=(2100,)), server.client)
    seat.take()
    seat.close()
    (lock,) = tmp_path.glob("*.lock")
    holder = "import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_EX); "
    holder += "print('holds', flush=True); input()"
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", holder, str(lock)]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe) as other:
        assert other.stdout.readline() == b"holds\n"
        calls = list(server.calls)
        with pytest.raises(RuntimeError, match=r"other processes drive.*env.ports=\[2100,2104\]"):
            seat.take()
        assert server.calls == calls
        other.communicate(b"\n")
    assert seat.take() is seat.session  # the lock went with the process
    seat.close()
