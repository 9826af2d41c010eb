"""Names, places and types of the entries that say who drove and what it cost.

Inside an environment everything new appears under ``next``: entries that a transform writes next
to the action before a step do not survive it. After ``step_mdp`` the root entry of the same name
is therefore that of the step before, which is why the root ``intervention`` an environment reads
means "the mentor controlled the last step". In a collected or stored transition
(:class:`~haim_torchrl.transforms.TakeoverToTransition`) the entries that belong to the action
stand beside it at the root.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from tensordict.utils import NestedKey


@dataclass(frozen=True)
class InterventionKeys:
    """Names used by :class:`~haim_torchrl.transforms.InterventionTransform`.

    Attributes:
        action: read before the step: what the agent proposes; replaced for the simulator by what
            is executed.
        action_agent: what the agent proposed.
        action_mentor: what the mentor did, zeros where it did not intervene.
        behavior_action: what the simulator executed.
        intervention: whether the mentor controlled the step; also the state entry that carries
            the flag to the next step.
        takeover_start: whether the step is the first of a takeover.
        takeover_cost: C^EX of the step.
    """

    action: NestedKey = "action"
    action_agent: NestedKey = "action_agent"
    action_mentor: NestedKey = "action_mentor"
    behavior_action: NestedKey = "behavior_action"
    intervention: NestedKey = "intervention"
    takeover_start: NestedKey = "takeover_start"
    takeover_cost: NestedKey = "takeover_cost"

    @property
    def published(self) -> tuple[NestedKey, ...]:
        """What the transform writes, in the order of the table."""
        return (
            self.action_agent,
            self.action_mentor,
            self.behavior_action,
            self.intervention,
            self.takeover_start,
            self.takeover_cost,
        )


@dataclass(frozen=True)
class DisturbanceKeys:
    """Names used by :class:`~haim_torchrl.transforms.DisturbanceTransform`.

    Attributes:
        speed: speed of the AV, ``[..., 1]``, m/s.
        acceleration: measured acceleration of the AV over the last step, ``[..., 1]``, m/s².
        follower_gaps: gap of each follower to its predecessor, ``[..., N]``, m.
        follower_speeds: speed of each follower, ``[..., N]``, m/s.
        intervention: whether the mentor controlled the step, if anybody says so.
        disturbance: written: whether the agent braked hard in this step.
        disturbance_onset: written: whether it began to.
        disturbance_cost: written: C^IM of the step.
    """

    speed: NestedKey = "speed"
    acceleration: NestedKey = "acceleration"
    follower_gaps: NestedKey = "follower_gaps"
    follower_speeds: NestedKey = "follower_speeds"
    intervention: NestedKey = "intervention"
    disturbance: NestedKey = "disturbance"
    disturbance_onset: NestedKey = "disturbance_onset"
    disturbance_cost: NestedKey = "disturbance_cost"

    @property
    def read(self) -> tuple[NestedKey, ...]:
        """What the environment must offer."""
        return (self.speed, self.acceleration, self.follower_gaps, self.follower_speeds)

    @property
    def published(self) -> tuple[NestedKey, ...]:
        """What the transform writes."""
        return (self.disturbance, self.disturbance_onset, self.disturbance_cost)


@dataclass(frozen=True)
class KeyEntry:
    """One row of the key table.

    Attributes:
        name: key under the default names.
        place: where it stands in a transition.
        size: last dimension: ``"A"`` that of the action, ``"D"`` that of the observation.
        dtype: ``None`` means that of the action or observation.
        meaning: one line.
    """

    name: str
    place: Literal["root", "next"]
    size: Literal["1", "A", "D"]
    dtype: torch.dtype | None
    meaning: str


TRANSITION_TABLE: tuple[KeyEntry, ...] = (
    KeyEntry("observation", "root", "D", None, "as the agent sees it"),
    KeyEntry("action", "root", "A", None, "what the simulator executed"),
    KeyEntry("action_agent", "root", "A", None, "what the agent proposed"),
    KeyEntry("action_mentor", "root", "A", None, "what the mentor did, zeros where it did not"),
    KeyEntry("intervention", "root", "1", torch.bool, "the mentor controlled the step"),
    KeyEntry("takeover_start", "root", "1", torch.bool, "first step of a takeover"),
    KeyEntry("observation", "next", "D", None, "what came of it"),
    KeyEntry("takeover_cost", "next", "1", torch.float32, "C^EX"),
    KeyEntry("disturbance", "next", "1", torch.bool, "the agent braked hard"),
    KeyEntry("disturbance_onset", "next", "1", torch.bool, "the agent began to brake hard"),
    KeyEntry("disturbance_cost", "next", "1", torch.float32, "C^IM"),
    KeyEntry("reward", "next", "1", torch.float32, "of the environment; not read by HAIM-DRL"),
    KeyEntry("done", "next", "1", torch.bool, "terminated or truncated"),
    KeyEntry("terminated", "next", "1", torch.bool, "nothing follows: no bootstrap"),
    KeyEntry("truncated", "next", "1", torch.bool, "interrupted: bootstrap through it"),
)
"""A transition as collectors hand it out and replay stores it, beside what else the environment
says (``next.cost``, ``next.success``, ...: for evaluation only)."""

REPLAY_KEYS: tuple[NestedKey, ...] = tuple(
    row.name if row.place == "root" else ("next", row.name)
    for row in TRANSITION_TABLE
    if row.name not in ("disturbance", "disturbance_onset", "reward")
)
"""What the reward-free losses read: everything else costs memory in replay."""
