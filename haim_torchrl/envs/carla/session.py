"""The world of one server while a simulator drives it, and everything put back afterwards."""

from __future__ import annotations

import contextlib
from typing import Any

from haim_torchrl.envs.carla.client import short_name

TIME_STEP = 0.1
"""Duration of a step [s]."""
SUBSTEP, SUBSTEPS = 0.01, 10
"""CARLA's physics takes this many steps [s] in one of ours."""
TRAFFIC_PORT = 6000
"""The traffic manager's port is this much higher than the server's; 8000 beside 2000, as usual."""
SEEDS = 2**31
"""CARLA's random states take numbers below this."""
LOADING = 120.0
"""How long loading a town may take [s]."""


class Session:
    """A server's world in synchronous mode.

    Args:
        client: connected to the server.
        port: the server's port.
        timeout: how long an answer may take [s].
        rendering: whether the server draws pictures.

    Attributes:
        world: the world; another one once another town is loaded.
        traffic_manager: drives the traffic; None before the first :meth:`begin`.
        closed: whether all is put back.
    """

    def __init__(self, client: Any, port: int, timeout: float, rendering: bool) -> None:
        self._client, self._port, self._timeout = client, port, timeout
        self._rendering = rendering
        self.world = client.get_world()
        self._former = self.world.get_settings()
        self._town = short_name(self.world.get_map().name)
        self._actors: list[Any] = []
        self._working: list[Any] = []
        self.traffic_manager: Any = None
        self.closed = False

    def begin(self, town: str, seed: int) -> None:
        """Clear the last episode away, load a town if it is not loaded, and stop the clock.

        Args:
            town: its name.
            seed: for the traffic manager and the pedestrians.
        """
        self._clear()
        if town != self._town:
            # A traffic manager or a world that waits for ticks keeps a town from being loaded.
            self._let_go()
            self._client.set_timeout(max(self._timeout, LOADING))
            self.world = self._client.load_world(town)
            self._client.set_timeout(self._timeout)
            self._town = town
        self.traffic_manager = self._client.get_trafficmanager(self._port + TRAFFIC_PORT)
        self.traffic_manager.set_synchronous_mode(True)
        self.traffic_manager.set_random_device_seed(seed % SEEDS)
        settings = self.world.get_settings()
        settings.synchronous_mode = True
        settings.fixed_delta_seconds = TIME_STEP
        settings.substepping = True
        settings.max_substep_delta_time = SUBSTEP
        settings.max_substeps = SUBSTEPS
        settings.no_rendering_mode = not self._rendering
        self.world.apply_settings(settings)
        self.world.set_pedestrians_seed(seed % SEEDS)

    @property
    def traffic_port(self) -> int:
        """Port of the traffic manager."""
        return self._port + TRAFFIC_PORT

    def tick(self) -> int:
        """Let one time step pass.

        Returns:
            The number of the frame.
        """
        return self.world.tick()

    def spawn(self, blueprint: Any, transform: Any, parent: Any = None) -> Any:
        """Place an actor, which goes when the episode or the session ends.

        Returns:
            The actor, or None if something is in the way.
        """
        if parent is None:
            actor = self.world.try_spawn_actor(blueprint, transform)
        else:
            actor = self.world.try_spawn_actor(blueprint, transform, attach_to=parent)
        if actor is not None:
            self._actors.append(actor)
        return actor

    def stop_first(self, actor: Any) -> None:
        """Note a sensor or controller that must be stopped before it can go."""
        self._working.append(actor)

    def destroy(self, actor: Any) -> None:
        """Take an actor away now."""
        self._actors.remove(actor)
        with contextlib.suppress(RuntimeError):
            actor.destroy()

    def close(self) -> None:
        """Give the world its former settings back and take everything away that was placed."""
        if self.closed:
            return
        try:
            self._let_go()
        except RuntimeError:
            pass  # the server is gone, and each further call would wait for it in vain
        else:
            self._clear()
        self.closed = True  # at the end: what Ctrl-C cuts short is done again

    def _let_go(self) -> None:
        """Let the clock run again as it did."""
        if self.traffic_manager is not None:
            with contextlib.suppress(RuntimeError):  # it has a time-out of its own, of two seconds
                self.traffic_manager.set_synchronous_mode(False)
        self.world.apply_settings(self._former)

    def _clear(self) -> None:
        while self._working:
            with contextlib.suppress(RuntimeError):
                self._working[-1].stop()
            self._working.pop()
        while self._actors:
            with contextlib.suppress(RuntimeError):
                self._actors[-1].destroy()
            self._actors.pop()
