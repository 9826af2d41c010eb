"""What a run's takeovers show, after the run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean, median

import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.data.session import Session
from haim_torchrl.human.takeovers import ADVICE, ENOUGH, Takeover, hint, share, takeovers_of

SPOT = 20.0
"""Length of a spot on a route [m]."""
CHANGED = 0.1
"""Relative change of the distance to the mentor that counts as one."""


@dataclass(frozen=True)
class Part:
    """One part of a run.

    Attributes:
        rate: Share of mentor-driven steps.
        distance: Mean distance of the agent's and the mentor's action on these, in units of the
            action; None without any.
    """

    rate: float
    distance: float | None


@dataclass(frozen=True)
class CoachReport:
    """What a run's takeovers show; None stands for what is not known.

    Attributes:
        minutes: Of driving.
        control: Of them, those that the mentor drove.
        takeovers: Number of takeovers.
        median_length: Of a takeover [s].
        risk: Share of onsets at which the agent's action was foreseen to end in a collision or off
            the road, among those of which that is known.
        late: Share of onsets that came late.
        collisions: Those that the agent caused before a takeover.
        blocks: Number of takeovers by type of block, the most frequent first.
        spots: The same by scenario and, where it is known, by stretch of the route; the first five.
        first, last: First and last third of the run.
        before: Mean distance of the agent's and the mentor's action on mentor-driven steps, as the
            agent proposed then.
        after: As the present policy proposes for the same observations.
        hint: What would make the takeovers better; empty while there is too little to say.
    """

    minutes: float | None = None
    control: float = 0.0
    takeovers: int = 0
    median_length: float | None = None
    risk: float | None = None
    late: float | None = None
    collisions: int | None = None
    blocks: tuple[tuple[str, int], ...] = ()
    spots: tuple[tuple[str, int], ...] = ()
    first: Part | None = None
    last: Part | None = None
    before: float | None = None
    after: float | None = None
    hint: str = ""

    @property
    def rate(self) -> float | None:
        """Share of mentor-driven time."""
        return self.control / self.minutes if self.minutes else None

    def __str__(self) -> str:
        """The report as text, a line for each figure that is known."""
        rows = [("driving", _number(self.minutes, ".1f", " min"))]
        rows += [("control", _number(self.control, ".1f", " min") + _number(self.rate, " (.0%)"))]
        rows += [("takeovers", str(self.takeovers))]
        rows += [("median length", _number(self.median_length, ".1f", " s"))]
        rows += [("begun by risk", _number(self.risk, ".0%"))]
        rows += [("begun late", _number(self.late, ".0%"))]
        rows += [("collisions of the agent", _number(self.collisions, "d"))]
        rows += [("by block", ", ".join(f"{name} {count}" for name, count in self.blocks))]
        rows += [("most often at", "; ".join(f"{name}: {count}" for name, count in self.spots))]
        if self.first is not None and self.last is not None:
            rows += [("takeover rate", f"{self.first.rate:.0%} in the first third, "
                      f"{self.last.rate:.0%} in the last")]  # fmt: skip
            apart = [_number(part.distance, ".2f") or "?" for part in (self.first, self.last)]
            rows += [("distance of actions", f"{apart[0]} in the first third, {apart[1]} in the "
                      "last, where the mentor drove")]  # fmt: skip
        if self.before is not None and self.after is not None:
            rows += [("the same steps", f"{self.before:.2f} as proposed then, {self.after:.2f} as "
                      f"the policy proposes now: {self.learned}")]  # fmt: skip
        rows += [("advice", f"{self.hint}: {ADVICE[self.hint]}" if self.hint else "")]
        return "\n".join(f"{name:<24}{value}" for name, value in rows if value)

    @property
    def learned(self) -> str:
        """Whether the takeovers changed the policy, in words; empty where it is not known."""
        if self.before is None or self.after is None:
            return ""
        if self.after < (1.0 - CHANGED) * self.before:
            return "the policy came nearer to the mentor"
        if self.after > (1.0 + CHANGED) * self.before:
            return "the policy went away from the mentor"
        return "these takeovers hardly changed the policy"


def make_report(
    takeovers: Sequence[Takeover] = (),
    session: Session | None = None,
    *,
    steps: int | None = None,
    transitions: TensorDictBase | None = None,
    policy: Callable[[Tensor], Tensor] | None = None,
    time_step: float = 0.1,
) -> CoachReport:
    """Make a report of what is there; each part may be left out.

    Args:
        takeovers: What a coach kept.
        session: The recorded session. Time, number and lengths of takeovers are then taken from
            it, since a coach that began later has not seen all of them.
        steps: Steps driven, if there is no session.
        transitions: Those of the replay, ``[N]``, with ``observation [N, D]``,
            ``action_agent [N, A]``, ``action_mentor [N, A]`` and ``intervention [N, 1]``; only
            mentor-driven ones are looked at.
        policy: The present policy: its actions ``[T, A]`` for observations ``[T, D]``.
        time_step: Duration of a step [s].
    """
    counted = list(takeovers) if session is None else takeovers_of(session)
    steps = steps if session is None else len(session)
    mentor_steps = sum(takeover.length for takeover in counted)
    lengths = [takeover.length * time_step for takeover in counted]
    told = list(takeovers) or counted
    known = [takeover.collisions for takeover in told if takeover.collisions is not None]
    before, after = _distances(transitions, policy)
    thirds = (None, None) if session is None else _thirds(session)
    # Advice is for what comes next, so it looks at how the run ended.
    rate = thirds[1].rate if thirds[1] is not None else mentor_steps / steps if steps else 0.0
    return CoachReport(
        minutes=None if steps is None else steps * time_step / 60.0,
        control=mentor_steps * time_step / 60.0,
        takeovers=len(counted),
        median_length=median(lengths) if lengths else None,
        risk=share([takeover.risk for takeover in told]),
        late=share([takeover.late for takeover in told]),
        collisions=sum(known) if known else None,
        blocks=tuple(Counter(t.block for t in told if t.block is not None).most_common()),
        spots=tuple(Counter(_spot(t) for t in told if t.scenario is not None).most_common(5)),
        first=thirds[0],
        last=thirds[1],
        before=before,
        after=after,
        hint="" if len(told) < ENOUGH else hint(told, rate, time_step),
    )


def _spot(takeover: Takeover) -> str:
    if takeover.along is None:
        return f"scenario {takeover.scenario}"
    start = math.floor(takeover.along / SPOT) * SPOT
    return f"scenario {takeover.scenario}, {start:.0f} to {start + SPOT:.0f} m"


def _thirds(session: Session) -> tuple[Part, Part] | tuple[None, None]:
    steps = list(session.steps())
    third = len(steps) // 3
    if not third:
        return None, None
    parts = []
    for part in (steps[:third], steps[-third:]):
        driven = [step for step in part if step.intervention]
        apart = [math.dist(step.action_agent, step.action_mentor) for step in driven]
        parts.append(Part(len(driven) / third, fmean(apart) if apart else None))
    return parts[0], parts[1]


@torch.no_grad()
def _distances(
    transitions: TensorDictBase | None, policy: Callable[[Tensor], Tensor] | None
) -> tuple[float | None, float | None]:
    if transitions is None:
        return None, None
    driven = transitions[transitions["intervention"].squeeze(-1)]
    if not len(driven):
        return None, None

    def apart(agent: Tensor) -> float:
        return (agent - driven["action_mentor"]).norm(dim=-1).mean().item()

    after = None if policy is None else apart(policy(driven["observation"]))
    return apart(driven["action_agent"]), after


def _number(value: float | None, form: str, unit: str = "") -> str:
    """A figure with its unit; empty if it is not known."""
    if value is None:
        return ""
    if form.startswith(" ("):
        return f" ({value:{form[2:-1]}})"
    return f"{value:{form}}{unit}"
