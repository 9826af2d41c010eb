"""How good recorded driving is, in figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import fmean, stdev
from typing import Any

import torch
from tensordict import TensorDictBase

MIN_SUCCESS, MAX_COST = 0.9, 0.1
"""Share of arrivals below which, and cost per episode above which, driving is no model to learn
from. The paper's human arrived always, at a cost of 0.03."""


@dataclass(frozen=True)
class Quality:
    """Figures of recorded episodes. Those that were cut off by the record count as steps only.

    Attributes:
        episodes: Number of episodes.
        finished: Number of those that came to an end.
        steps: Number of steps.
        mentor_share: Share of the steps that the mentor drove.
        takeovers: Number of takeovers; demonstrations are one each episode.
        success: Share of the finished episodes that arrived; None where nobody says.
        cost: Mean cost of a finished episode, such as collisions; None where there is none.
        disturbances: Steps with a disturbance cost; None where nobody says.
        mean_return: Mean over the finished episodes; NaN if there is none.
        sd_return: Standard deviation over them; NaN for fewer than two.
    """

    episodes: int
    finished: int
    steps: int
    mentor_share: float
    takeovers: int
    success: float | None
    cost: float | None
    disturbances: int | None
    mean_return: float
    sd_return: float

    @classmethod
    def of(cls, episodes: Sequence[TensorDictBase]) -> Quality:
        """The figures of episodes.

        Args:
            episodes: At least one, each of transitions ``[T]`` as
                :func:`~.minari_reader.load_episodes` has them.
        """
        ended = [episode["next"] for episode in episodes if episode["next", "done"][-1].any()]
        returns = [after["reward"].sum().item() for after in ended]
        arrived = [float(after["success"][-1].any()) for after in ended if "success" in after]
        costs = [after["cost"].sum().item() for after in ended if "cost" in after]
        disturbed = [
            int((episode["next", "disturbance_cost"] > 0.0).sum())
            for episode in episodes
            if ("next", "disturbance_cost") in episode.keys(True)
        ]
        driven = torch.cat([episode["intervention"] for episode in episodes])
        return cls(
            episodes=len(episodes),
            finished=len(ended),
            steps=len(driven),
            mentor_share=driven.float().mean().item(),
            takeovers=sum(int(episode["takeover_start"].sum()) for episode in episodes),
            success=fmean(arrived) if arrived else None,
            cost=fmean(costs) if costs else None,
            disturbances=sum(disturbed) if disturbed else None,
            mean_return=fmean(returns) if returns else math.nan,
            sd_return=stdev(returns) if len(returns) > 1 else math.nan,
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values; what is not known is None, since JSON has no NaN."""
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in asdict(self).items()
        }

    def __str__(self) -> str:
        """One line."""

        def shown(value: float | None) -> str:
            return "unknown" if value is None or math.isnan(value) else f"{value:.3g}"

        return (
            f"{self.steps} steps, {self.episodes} episodes ({self.finished} to their end): success "
            f"{shown(self.success)}, cost per episode {shown(self.cost)}, return "
            f"{shown(self.mean_return)} (sd {shown(self.sd_return)}), disturbances "
            f"{shown(self.disturbances)}"
        )

    def complaint(self) -> str | None:
        """One sentence on driving that is no model to learn from; None where it is one."""
        found = []
        if self.success is not None and self.success < MIN_SUCCESS:
            found.append(f"only {self.success:.2f} of the episodes arrive (below {MIN_SUCCESS})")
        if self.cost is not None and self.cost > MAX_COST:
            found.append(f"an episode costs {self.cost:.2f} (above {MAX_COST})")
        if not found:
            return None
        return f"{' and '.join(found)}: what imitates these demonstrations inherits that"
