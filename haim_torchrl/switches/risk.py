"""Take over when the simulator foresees harm: a shield that needs no mentor to decide."""

from __future__ import annotations

from haim_torchrl.switches.protocol import Forecast, Situation


class RiskSwitch:
    """Mentor controls when carrying out the agent's action is predicted to go wrong.

    The forecast is the simulator's (:class:`~haim_torchrl.switches.protocol.Forecasting`); this
    switch holds it to limits. The paper leaves the human's threshold for danger open
    (assumption 2), hence each limit is an argument and ``None`` switches it off.

    Args:
        collision: whether a predicted collision counts.
        departure: whether leaving the road counts.
        max_lateral_acceleration: largest lateral acceleration accepted, m/s². 4 m/s² is about
            what passengers bear and dry roads hold with margin.
        max_stalled_steps: number of steps of crawling or standing without cause at which the mentor
            helps, so that an agent cannot avoid takeovers by standing still.
        min_time_to_collision: least time to a collision accepted, s. Without it any predicted
            collision counts, however late.
        min_time_to_departure: likewise for leaving the road, s.
        release_clearance: clearance from the road's edge below which a mentor in control keeps it,
            m. A mentor who lets go as soon as the danger is over lets go beside the edge, and the
            agent never sees how the way back to the lane ends: it then drifts off the road.

    Raises:
        ValueError: a limit that is not positive, or a switch that can never fire.
    """

    memoryless = True

    def __init__(
        self,
        *,
        collision: bool = True,
        departure: bool = True,
        max_lateral_acceleration: float | None = 4.0,
        max_stalled_steps: int | None = 20,
        min_time_to_collision: float | None = None,
        min_time_to_departure: float | None = None,
        release_clearance: float | None = None,
    ) -> None:
        limits = {
            "max_lateral_acceleration": max_lateral_acceleration,
            "max_stalled_steps": max_stalled_steps,
            "min_time_to_collision": min_time_to_collision,
            "min_time_to_departure": min_time_to_departure,
            "release_clearance": release_clearance,
        }
        for name, limit in limits.items():
            if limit is not None and not limit > 0:
                raise ValueError(f"{name} is {limit}: give a positive limit, or None for none.")
        if not (collision or departure or max_lateral_acceleration or max_stalled_steps):
            raise ValueError(
                "every limit of RiskSwitch is off, so the mentor would never take over: "
                "switch one on, or say Never()."
            )
        self.collision = collision
        self.departure = departure
        self.max_lateral_acceleration = max_lateral_acceleration
        self.max_stalled_steps = max_stalled_steps
        self.min_time_to_collision = min_time_to_collision
        self.min_time_to_departure = min_time_to_departure
        self.release_clearance = release_clearance

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """``True`` when the forecast for the agent's action breaks a limit."""
        forecast = getattr(situation.simulator, "forecast", None)
        if forecast is None:
            raise TypeError(
                f"RiskSwitch needs a simulator with a method forecast(action), and "
                f"{type(situation.simulator).__name__} has none: use ActionSwitch or "
                "ProbabilitySwitch, or give the simulator that method."
            )
        outlook = forecast(situation.action_agent.numpy())
        return self.is_risky(outlook) or (
            situation.was_intervening
            and self.release_clearance is not None
            and outlook.clearance < self.release_clearance
        )

    def is_risky(self, forecast: Forecast) -> bool:
        """Whether a forecast breaks a limit."""
        return (
            (
                self.collision
                and forecast.collision
                and (
                    self.min_time_to_collision is None
                    or forecast.time_to_collision < self.min_time_to_collision
                )
            )
            or (
                self.departure
                and forecast.departure
                and (
                    self.min_time_to_departure is None
                    or forecast.time_to_departure < self.min_time_to_departure
                )
            )
            or (
                self.max_lateral_acceleration is not None
                and forecast.lateral_acceleration > self.max_lateral_acceleration
            )
            or (
                self.max_stalled_steps is not None
                and forecast.stalled_steps >= self.max_stalled_steps
            )
        )
