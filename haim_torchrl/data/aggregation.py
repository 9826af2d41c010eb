"""Dataset aggregation: what of a round with takeovers is learned from, and with which weight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from haim_torchrl.data.replay import TakeoverReplayBuffer

Keep = Literal["mentor", "all"]


class Aggregate:
    """Demonstrations, and of each round what the method learns from.

    ``keep="mentor"`` is HG-DAgger's (Kelly et al. 2019): what the mentor did, in demonstrations
    and takeovers alike; what the agent did itself is dropped. With a replay that samples uniformly
    each of these steps counts the same.

    ``keep="all"`` is that of intervention weighted regression (IWR; Mandlekar et al.,
    "Human-in-the-Loop Imitation Learning using Remote Teleoperation", 2020): the agent's own steps
    are cloned, too, as the mentor let them pass. Takeovers are few among them, and are what avoids
    harm, so they get half of the weight: with a balanced replay an intervened sample counts
    ``n_free / n_intervened`` times as much as a free one. Demonstrations count as free.

    Args:
        replay: keeps the steps; ``sampling="uniform"`` or ``"balanced"``. Nothing that it is given
            may be forgotten: its capacity must hold all.
        keep: ``"mentor"`` or ``"all"``.
        start_key: entry that marks the first step of a takeover.
        doubt_key: entry with the doubt of the agent, where it has one.

    Raises:
        ValueError: if ``keep`` is unknown.

    Examples:
        >>> from tensordict import TensorDict
        >>> seen = TensorDict({"observation": torch.zeros(6, 3)}, batch_size=[6])
        >>> driven = seen[:4].set("intervention", torch.tensor([[True], [False], [False], [False]]))
        >>> data = Aggregate(TakeoverReplayBuffer(100, batch_size=8), keep="all")
        >>> data.add_demonstrations(seen)
        >>> data.add_round(driven)
        >>> len(data), data.replay.sample()["intervention"].sum().item()
        (10, 4)
    """

    def __init__(
        self,
        replay: TakeoverReplayBuffer,
        keep: Keep,
        *,
        start_key: NestedKey = "takeover_start",
        doubt_key: NestedKey = "doubt",
    ) -> None:
        if keep not in ("mentor", "all"):
            raise ValueError(f"keep must be 'mentor' or 'all', got {keep!r}.")
        self.replay = replay
        self.keep = keep
        self.start_key = start_key
        self.doubt_key = doubt_key
        self._doubts = torch.empty(0)

    def __len__(self) -> int:
        return len(self.replay)

    @property
    def doubts(self) -> Tensor:
        """The agent's doubt at each takeover so far, in their order, ``[N]``."""
        return self._doubts

    def add_demonstrations(self, data: TensorDictBase) -> None:
        """Adds what the mentor did when it drove alone.

        Args:
            data: steps ``[N]`` with what the replay keeps, but for who drove.
        """
        flag = torch.full((len(data), 1), self.keep == "mentor", device=data.device)
        self.replay.extend(data.copy().set(self.replay.intervention_key, flag))

    def add_round(self, batch: TensorDictBase) -> None:
        """Adds steps that were driven with the mentor at hand.

        Args:
            batch: transitions of any batch shape, that say who drove.
        """
        flat = batch.reshape(-1)
        mentor = flat.get(self.replay.intervention_key).reshape(len(flat)).bool()
        doubt, start = flat.get(self.doubt_key, None), flat.get(self.start_key, None)
        if doubt is not None and start is not None:
            at_takeovers = doubt.reshape(len(flat))[start.reshape(len(flat)).bool()]
            self._doubts = torch.cat([self._doubts, at_takeovers.detach().cpu().float()])
        self.replay.extend(flat if self.keep == "all" else flat[mentor])

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to go on: plain numbers, strings and tensors."""
        return {"replay": self.replay.state_dict(), "doubts": self._doubts}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Goes on from a saved state.

        Args:
            state_dict: result of :meth:`state_dict`.
        """
        self.replay.load_state_dict(state_dict["replay"])
        self._doubts = state_dict["doubts"].cpu()
