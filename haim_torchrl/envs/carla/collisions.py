"""What CARLA's collision sensor reports of the AV."""

from __future__ import annotations

from queue import Empty, SimpleQueue
from typing import Any

from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.carla.session import Session

GROUND = frozenset(
    f"static.{name}" for name in ("road", "roadline", "sidewalk", "ground", "terrain")
)
"""Types that the sensor reports for what one drives on: no collision."""

Other = tuple[int, str]
"""Who was hit: its number and type. All of a town's houses may share a number."""


class CollisionSensor:
    """The sensor of one vehicle.

    CARLA calls back from a thread of its own, at times just after the step that a contact
    belongs to; such a report counts in the next step.

    Args:
        session: the world.
        vehicle: whom it is mounted on.
    """

    def __init__(self, session: Session, vehicle: Any) -> None:
        blueprint = session.world.get_blueprint_library().find("sensor.other.collision")
        sensor = session.spawn(blueprint, carla_package().Transform(), parent=vehicle)
        session.stop_first(sensor)
        reports: SimpleQueue[tuple[int, Other]] = SimpleQueue()

        def report(event: Any) -> None:
            other = event.other_actor
            reports.put((event.frame, (other.id, other.type_id)))

        sensor.listen(report)
        self._reports = reports

    def take(self) -> list[tuple[int, Other]]:
        """What was reported since the last time: the frame, and who was hit."""
        found: list[tuple[int, Other]] = []
        while True:
            try:
                frame, other = self._reports.get_nowait()
            except Empty:
                return found
            if other[1] not in GROUND:
                found.append((frame, other))
