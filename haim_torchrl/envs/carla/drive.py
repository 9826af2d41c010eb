"""One episode as it is driven: from the actors' poses to events, scene and snapshot."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.cast import Cast
from haim_torchrl.envs.carla.collisions import Other
from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.control import MAX_SPEED, car_model, control_of
from haim_torchrl.envs.carla.episode import Contacts, Events, Progress, judge
from haim_torchrl.envs.carla.frames import Pose, to_recording
from haim_torchrl.envs.carla.map.town import Town
from haim_torchrl.envs.carla.scenario import CarlaScenario
from haim_torchrl.envs.carla.scene import Body, RouteLane, Scene, body_rows
from haim_torchrl.envs.carla.session import TIME_STEP, Session
from haim_torchrl.envs.forecast import StallCounter
from haim_torchrl.envs.lanes import comfortable_speeds
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.evaluation.recording import Snapshot

CRUISE = 11.1
"""Speed on a free straight road [m/s]: 40 km/h, the paper's limit."""
WAYS = 60.0
"""Of vehicles nearer than this the lane ahead is looked up, to predict them [m]."""


class Drive:
    """An episode.

    Args:
        session: the server's world, already that of the scenario's town.
        config: settings.
        town: the town.
        scenario: what to drive.

    Attributes:
        model: what the AV can do.
        road: the scene now, for the forecast and the expert.
        events: what happened in the last step.
        steps: steps driven.
        acceleration: the AV's, over the last step; 0 in a crash [m/s²].

    Raises:
        RuntimeError: something is in the way at the start.
    """

    def __init__(
        self, session: Session, config: CarlaConfig, town: Town, scenario: CarlaScenario
    ) -> None:
        self.session, self._config, self._town, self.scenario = session, config, town, scenario
        path, start = scenario.route.path, scenario.start
        self._platoon = Platoon(
            path.part(0, start), config.followers, config.follower_gap, 0.0, config.idm
        )
        self._cast = Cast(session, config, scenario, self._follower_poses(), town.height)
        self._speeds = comfortable_speeds(path)
        self._progress = Progress(path, start)
        self._contacts: Contacts[Other] = Contacts()
        self.events = Events()
        self._stall = StallCounter(0.0)
        self.steps, self.acceleration, self._distance = 0, 0.0, 0.0
        self.av, self._rest = self._cast.read_av(), self._cast.read_others()
        self.model = car_model(self.av.length, self.av.width)
        self._progress.update(self.av.pose)
        self._view()

    @property
    def stalled_steps(self) -> int:
        """Steps lost so far by driving slowly without cause."""
        return self._stall.steps

    def advance(self, action: np.ndarray) -> float:
        """Drive one step.

        Returns:
            The reward: metres along the route, a bonus for speed, 20 at the destination.
        """
        before, cast = self.av, self._cast
        cast.av.apply_control(control_of(action, before.speed, cast.full_lock))
        self.session.tick()
        self.steps += 1
        self.av, self._rest = cast.read_av(), cast.read_others()
        x, y, _ = self.av.pose
        self._distance += float(np.hypot(x - before.pose[0], y - before.pose[1]))
        self._platoon.step(np.array([x, y]), self.av.speed, body_rows(self._rest), TIME_STEP)
        cast.move_followers(self._follower_poses())
        moved = self._progress.update(self.av.pose)
        hit = self._contacts.update(cast.collisions.take())
        self.events = judge(
            self._progress,
            len(hit),
            self._town.is_drivable(x, y),
            self.scenario.route.lane_width,
            self._config.off_route,
        )
        # A crash stops the car, but says nothing about how it was braked.
        self.acceleration = 0.0 if self.events.crash else self.av.acceleration
        if hit and not self._config.end_on_collision:
            for other in hit:
                cast.remove(other)
            self._rest = cast.read_others()
        self._view()
        self._count_stall()
        return moved + 0.1 * self.av.speed / MAX_SPEED + 20.0 * self.events.success

    def cut_off(self) -> None:
        """Nothing happens any more."""
        self.events = Events()

    def _view(self) -> None:
        part, low = self._progress.window()
        lane = RouteLane(part, self._speeds[int(low) : int(low) + len(part.x)])
        rest = [self._with_way(body) for body in self._rest]
        width = self.scenario.route.lane_width
        self.road = Scene(lane, width, self.model, self.av, self._follower_bodies(), rest)
        self._comfortable = lane.speed_at(self._progress.s - low)

    def _with_way(self, body: Body) -> Body:
        dx, dy = body.pose[0] - self.av.pose[0], body.pose[1] - self.av.pose[1]
        if body.kind != "vehicle" or np.hypot(dx, dy) > WAYS:
            return body
        return body._replace(way=self._town.way_ahead(body.pose, self.scenario.route.keys))

    def _count_stall(self) -> None:
        slow = self._config.stall_speed * min(CRUISE, self._comfortable)
        speed = self.av.speed
        self._stall.update(speed, slow, speed <= slow and self.road.held_up())

    def _follower_poses(self) -> list[Pose]:
        return [(x, y, heading) for x, y, heading in self._platoon.poses.tolist()]

    def _follower_bodies(self) -> list[Body]:
        platoon = self._platoon
        return [
            Body("vehicle", pose, float(speed), float(acceleration), *size)
            for pose, speed, acceleration, size in zip(
                self._follower_poses(),
                platoon.speeds,
                platoon.accelerations,
                self._cast.follower_sizes,
                strict=True,
            )
        ]

    def info(self) -> dict[str, Any]:
        """The info entries of :class:`~haim_torchrl.envs.driving.DrivingSimulator`."""
        return {
            "speed": self.av.speed,
            "acceleration": self.acceleration,
            "follower_gaps": self._platoon.gaps.astype(np.float32),
            "follower_speeds": self._platoon.speeds.astype(np.float32),
            "progress": self._progress.share,
            **asdict(self.events),
        }

    def snapshot(self) -> Snapshot:
        """The scene now, for recordings."""
        platoon = self._platoon
        return Snapshot(
            time=self.steps * TIME_STEP,
            vehicle=_boxes([self.av])[0],
            speed=self.av.speed,
            acceleration=self.acceleration,
            followers=_boxes(self._follower_bodies()),
            follower_speeds=platoon.speeds.copy(),
            follower_accelerations=platoon.accelerations.copy(),
            follower_gaps=platoon.gaps.copy(),
            traffic=_boxes([body for body in self._rest if body.kind == "vehicle"]),
            obstacles=_boxes([body for body in self._rest if body.kind != "vehicle"]),
            distance=self._distance,
        )


def _boxes(bodies: list[Body]) -> Array:
    """Boxes in the frame of recordings, [M, 5]."""
    return to_recording(np.array([body.box for body in bodies], dtype=float).reshape(-1, 5))
