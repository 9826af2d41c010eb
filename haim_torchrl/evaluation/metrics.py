"""From steps to episodes to figures: what every table of this project reports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

from tensordict import TensorDictBase

from haim_torchrl.evaluation.recording import ScenarioLabels
from haim_torchrl.evaluation.statistics import (
    Estimate,
    mean_interval,
    ratio_interval,
    wilson_interval,
)

OUTCOMES = ("success", "crash", "out_of_road", "wrong_way", "timeout", "other")


@dataclass(frozen=True)
class EpisodeRecord:
    """One finished episode in numbers.

    Attributes:
        scenario: Number of the scenario, -1 when unknown.
        blocks: Block types on its route.
        obstacles: Number of obstacles in it, -1 when unknown.
        steps: Steps driven.
        outcome: One of :data:`OUTCOMES`.
        violations: Collision events with a vehicle or an obstacle (decision 16).
        reward: Undiscounted sum of the environment reward, which training never sees.
        distance: Distance driven, in m.
        progress: Share of the route covered, 0 to 1.
        hard_brakes: Steps with the hard-brake flag, acceleration <= lambda.
        hard_brake_onsets: Rising edges of that flag.
        disturbance_cost: Sum of the disturbance cost.
        mentor_steps: Steps that the mentor drove.
        takeover_lengths: Length of each takeover, in steps.
        duration: Driven time, in s.
    """

    scenario: int = -1
    blocks: tuple[str, ...] = ()
    obstacles: int = -1
    steps: int = 0
    outcome: str = "other"
    violations: float = 0.0
    reward: float = 0.0
    distance: float = 0.0
    progress: float = 0.0
    hard_brakes: int = 0
    hard_brake_onsets: int = 0
    disturbance_cost: float = 0.0
    mentor_steps: int = 0
    takeover_lengths: tuple[int, ...] = ()
    duration: float = 0.0

    @property
    def success(self) -> bool:
        """Arrived at the destination without a crash."""
        return self.outcome == "success"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


STEP_KEYS = (
    "reward",
    "cost",
    "success",
    "crash",
    "out_of_road",
    "wrong_way",
    "truncated",
    "done",
    "speed",
    "progress",
    "disturbance",
    "disturbance_onset",
    "disturbance_cost",
    "intervention",
    "takeover_start",
)
"""What a step may report; a key that is missing counts as zero."""


class EpisodeMeter:
    """Adds up the steps of one environment and hands out a record at each episode's end.

    Args:
        time_step: Duration of a step, in s.
    """

    def __init__(self, time_step: float = 0.1) -> None:
        self.time_step = time_step
        self._open = False
        self.start()

    def start(self, labels: ScenarioLabels | None = None) -> None:
        """Forget an unfinished episode and begin the next."""
        self._labels = labels
        self._sums = dict.fromkeys(
            (
                "steps",
                "reward",
                "cost",
                "speed",
                "disturbance",
                "disturbance_onset",
                "disturbance_cost",
                "intervention",
            ),
            0.0,
        )
        self._takeovers: list[int] = []
        self._driving = False

    def add(self, step: Mapping[str, float]) -> EpisodeRecord | None:
        """Count one step.

        Args:
            step: Values of that step under :data:`STEP_KEYS`; missing ones count as zero.

        Returns:
            The record if the step ended its episode, else None.
        """
        sums = self._sums
        sums["steps"] += 1
        for key in sums:
            if key != "steps":
                sums[key] += float(step.get(key, 0.0))
        mentor = bool(step.get("intervention", 0.0))
        if mentor and (not self._driving or step.get("takeover_start", 0.0)):
            self._takeovers.append(0)
        if mentor:
            self._takeovers[-1] += 1
        self._driving = mentor
        if not step.get("done", 0.0):
            return None
        record = self._record(step)
        self.start()
        return record

    def _record(self, last: Mapping[str, float]) -> EpisodeRecord:
        sums = self._sums
        labels = self._labels or ScenarioLabels(index=-1, obstacles=-1)
        return EpisodeRecord(
            scenario=labels.index,
            blocks=tuple(labels.blocks),
            obstacles=labels.obstacles,
            steps=int(sums["steps"]),
            outcome=outcome_of(last),
            violations=sums["cost"],
            reward=sums["reward"],
            distance=sums["speed"] * self.time_step,
            progress=float(last.get("progress", 0.0)),
            hard_brakes=int(sums["disturbance"]),
            hard_brake_onsets=int(sums["disturbance_onset"]),
            disturbance_cost=sums["disturbance_cost"],
            mentor_steps=int(sums["intervention"]),
            takeover_lengths=tuple(self._takeovers),
            duration=sums["steps"] * self.time_step,
        )


def outcome_of(step: Mapping[str, float]) -> str:
    """Name the way an episode ended from the flags of its last step.

    A crash outranks an arrival in the same step: success means arrived and not crashed.
    """
    for name in ("crash", "out_of_road", "wrong_way", "success"):
        if step.get(name, 0.0):
            return name
    return "timeout" if step.get("truncated", 0.0) else "other"


def steps_of(batch: TensorDictBase) -> list[list[dict[str, float]]]:
    """Plain numbers of a collected batch, one list of steps per environment.

    Args:
        batch: Transitions ``[T]`` or ``[B, T]``, in the form of the environment or of the replay:
            who drove is read from ``next`` where it is there, else from the root.
    """
    rows = batch if batch.ndim > 1 else batch.unsqueeze(0)
    rows = rows.reshape(-1, rows.shape[-1])
    following = rows.get("next")
    columns: dict[str, list[list[float]]] = {}
    for key in STEP_KEYS:
        values = following.get(key, None)
        if values is None and key in ("intervention", "takeover_start"):
            values = rows.get(key, None)
        if values is not None:
            columns[key] = values.reshape(rows.shape[0], rows.shape[1], -1)[..., 0].float().tolist()
    return [
        [{key: column[row][t] for key, column in columns.items()} for t in range(rows.shape[1])]
        for row in range(rows.shape[0])
    ]


@dataclass(frozen=True)
class Summary:
    """What a set of episodes shows.

    Attributes:
        overall: Metric name to estimate over all episodes.
        success_by_block: Block type to success over the episodes whose route has that block.
        success_by_obstacles: ``"with"`` and ``"without"`` obstacles to success.
        outcomes: Number of episodes by outcome.
    """

    overall: dict[str, Estimate]
    success_by_block: dict[str, Estimate] = field(default_factory=dict)
    success_by_obstacles: dict[str, Estimate] = field(default_factory=dict)
    outcomes: dict[str, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""

        def plain(group: dict[str, Estimate]) -> dict[str, Any]:
            return {key: estimate.as_dict() for key, estimate in group.items()}

        return {
            "overall": plain(self.overall),
            "success_by_block": plain(self.success_by_block),
            "success_by_obstacles": plain(self.success_by_obstacles),
            "outcomes": dict(self.outcomes),
        }


def summarise(records: Sequence[EpisodeRecord], level: float = 0.95) -> Summary:
    """Figures of a set of episodes with confidence intervals over episodes.

    The disturbance rate is the share of steps with the hard-brake flag, comparable with the
    paper's, and the onsets per km stand beside it because one long brake counts as one disturbance
    there (decision 14). The takeover rate is the share of mentor-driven steps (decision 15). A
    safety violation is one collision event (decision 16).

    Args:
        records: Finished episodes.
        level: Confidence level of the intervals.

    Raises:
        ValueError: If there is no episode.
    """
    if not records:
        raise ValueError("summarise needs at least one finished episode; got none")

    def share(test: Callable[[EpisodeRecord], bool], of: Sequence[EpisodeRecord]) -> Estimate:
        return wilson_interval(sum(test(record) for record in of), len(of), level)

    def ratio(top: Iterable[float], bottom: Iterable[float]) -> Estimate:
        return ratio_interval(list(top), list(bottom), level)

    steps = [record.steps for record in records]
    kilometres = [record.distance / 1000.0 for record in records]
    lengths = [length for record in records for length in record.takeover_lengths]
    overall = {
        "success": share(lambda record: record.success, records),
        "violations": mean_interval([record.violations for record in records], level),
        "return": mean_interval([record.reward for record in records], level),
        "disturbance_rate": ratio((record.hard_brakes for record in records), steps),
        "disturbance_onsets_per_km": ratio(
            (record.hard_brake_onsets for record in records), kilometres
        ),
        "disturbance_cost": mean_interval([record.disturbance_cost for record in records], level),
        "takeover_rate": ratio((record.mentor_steps for record in records), steps),
        "takeovers": mean_interval([len(record.takeover_lengths) for record in records], level),
        "takeover_length_median": Estimate(
            float(median(lengths)) if lengths else float("nan"),
            float("nan"),
            float("nan"),
            len(lengths),
        ),
        "mentor_steps": mean_interval([record.mentor_steps for record in records], level),
        "out_of_road": share(lambda record: record.outcome == "out_of_road", records),
        "wrong_way": share(lambda record: record.outcome == "wrong_way", records),
        "timeout": share(lambda record: record.outcome == "timeout", records),
        "crash": share(lambda record: record.outcome == "crash", records),
        "progress": mean_interval([record.progress for record in records], level),
        "speed": ratio(
            (record.distance for record in records), (record.duration for record in records)
        ),
        "steps": mean_interval(steps, level),
    }
    blocks = sorted({block for record in records for block in record.blocks})
    known = [record for record in records if record.obstacles >= 0]
    groups = {
        "with": [record for record in known if record.obstacles > 0],
        "without": [record for record in known if record.obstacles == 0],
    }
    return Summary(
        overall=overall,
        success_by_block={
            block: share(lambda record: record.success, [r for r in records if block in r.blocks])
            for block in blocks
        },
        success_by_obstacles={
            name: share(lambda record: record.success, group)
            for name, group in groups.items()
            if group
        },
        outcomes={
            name: count
            for name in OUTCOMES
            if (count := sum(record.outcome == name for record in records))
        },
    )
