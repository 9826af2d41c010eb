"""The risk forecast that switches ask for, and the count of steps lost without cause."""

from __future__ import annotations

import numpy as np

from haim_torchrl.envs.carriageway import Surroundings
from haim_torchrl.envs.planning import Manoeuvre, Margins, look_ahead
from haim_torchrl.switches.protocol import Forecast


def forecast(
    road: Surroundings,
    acceleration: float,
    steering: float,
    *,
    hold: float,
    braking: float,
    road_margin: float,
    gap_margin: float,
    stalled_steps: int,
) -> Forecast:
    """Where a command leads if it is held for a moment and the AV then brakes.

    Args:
        road: the scene now.
        acceleration, steering: the command [m/s², rad].
        hold: how long it is held [s].
        braking: how hard the AV brakes then [m/s²].
        road_margin: how far inside the road's edge the AV's centre has to stay [m].
        gap_margin: distance to others, ahead and behind [m].
        stalled_steps: steps lost so far.
    """
    outlook = look_ahead(
        road,
        Manoeuvre(
            acceleration=acceleration,
            steering=steering,
            hold=hold,
            then=-braking,
            max_speed=road.av.model.max_speed,
        ),
        Margins(road_margin, gap_margin, 0.4, 3.0),
    )
    return Forecast(
        collision=bool(np.isfinite(outlook.time_to_collision)),
        departure=bool(np.isfinite(outlook.time_to_departure)),
        stalled_steps=stalled_steps,
        **outlook._asdict(),
    )


class StallCounter:
    """Counts steps of driving slowly, getting no faster, with nothing in the way.

    Args:
        speed: speed at the start [m/s].

    Attributes:
        steps: the count, which any good step sets back to 0.
    """

    def __init__(self, speed: float) -> None:
        self.steps = 0
        self._mark = speed

    def update(self, speed: float, slow: float, held_up: bool) -> None:
        """Count a step.

        Args:
            speed: speed now [m/s].
            slow: speed from which on nothing is lost [m/s].
            held_up: whether something is in the way.
        """
        if held_up or speed > slow or speed > self._mark + 0.5:
            self.steps, self._mark = 0, speed
        else:
            self.steps += 1
