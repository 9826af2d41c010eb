"""Where a person sits: a window or a page that shows the scene and is steered with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.human.controls import Action, Reading


@dataclass(frozen=True)
class Scene:
    """What stays the same within an episode.

    Attributes:
        episode: number of the episode in this process, from 0.
        labels: what the scenario consists of.
        road: lines of the road and of the route.
    """

    episode: int
    labels: ScenarioLabels
    road: list[RoadLine]


@dataclass(frozen=True)
class Figures:
    """Counts since the run began, as a person wants to see them.

    Attributes:
        steps: steps driven.
        total_steps: steps of the whole run; 0 if it has no end.
        seconds_left: time until then at the pace of the run; None where unknown.
        episodes: finished episodes.
        successes: of them, those that arrived.
        violations: collisions and the like.
        takeovers: takeovers that began.
        takeover_rate: share of the last 2 000 steps that the person drove.
    """

    steps: int = 0
    total_steps: int = 0
    seconds_left: float | None = None
    episodes: int = 0
    successes: int = 0
    violations: int = 0
    takeovers: int = 0
    takeover_rate: float = 0.0


@dataclass(frozen=True)
class Frame:
    """What a person sees of one step: the scene after it, and the flags of the paper.

    Attributes:
        episode: number of the episode, as in :class:`Scene`.
        step: number of the step in its episode; 0 after the reset.
        snapshot: vehicles, followers with their speeds, obstacles.
        driver: who drove the step; ``"fallback"`` where the person's device had failed.
        action: what was executed.
        action_agent: what the agent wanted.
        action_mentor: what the person did; zeros where the agent drove.
        takeover: whether the person drove (I of eq. 5).
        disturbance: whether the agent braked hard for its followers.
        cost: cost of the environment in this step.
        takeover_cost: C^EX of the step.
        disturbance_cost: C^IM of the step ("D cost").
        figures: counts of the run.
        device_ok: whether the person's device works.
        latency_ms: delay of the input that was used [ms].
        notice: why nothing moves, such as "paused"; None while it does.
        hint: the coach's advice, in small print.
    """

    episode: int
    step: int
    snapshot: Snapshot
    driver: Literal["agent", "person", "fallback"] = "agent"
    action: Action = (0.0, 0.0)
    action_agent: Action = (0.0, 0.0)
    action_mentor: Action = (0.0, 0.0)
    takeover: bool = False
    disturbance: bool = False
    cost: float = 0.0
    takeover_cost: float = 0.0
    disturbance_cost: float = 0.0
    figures: Figures = field(default_factory=Figures)
    device_ok: bool = True
    latency_ms: float | None = None
    notice: str | None = None
    hint: str = ""


@runtime_checkable
class Console(Protocol):
    """A window or a page. All methods return at once; none may wait for the person.

    A step may look more than once. What happens between two looks, such as a key that is pressed
    and let go, must therefore be told until a step has been shown.
    """

    def open(self) -> None:
        """Show up. Called before anything else; calling it again does nothing.

        Raises:
            ConsoleError: in one sentence, if there is no display, no device, no free port.
        """

    def read(self) -> Reading:
        """What the person does now; with it, handle what the window system reports."""
        ...

    def begin(self, scene: Scene) -> None:
        """Show a new episode."""

    def show(self, frame: Frame) -> None:
        """Show a step; the same step again, with another notice, while nothing moves."""

    def close(self) -> None:
        """Go away; calling it again does nothing."""


class ConsoleError(RuntimeError):
    """A console that cannot open; the message says why and what to do instead."""


class PersonQuit(BaseException):
    """The person at the console has ended the run.

    As KeyboardInterrupt it is no ``Exception``: TorchRL's collectors shut down on any of those, and
    a run that is to be saved still needs its collector.
    """
