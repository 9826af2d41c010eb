"""Batches of data that nobody adds to, in the place of a collector."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tensordict import TensorDictBase

from haim_torchrl.data.replay import TakeoverReplayBuffer


class DatasetBatches:
    """Draws a number of batches from a replay, and knows how many it has drawn.

    Args:
        replay: Holds the data.
        total: Number of batches.
    """

    def __init__(self, replay: TakeoverReplayBuffer, total: int) -> None:
        self.replay, self.total = replay, total
        self._drawn = 0

    def __iter__(self) -> Iterator[TensorDictBase]:
        """The batches that are left."""
        while self._drawn < self.total:
            self._drawn += 1
            yield self.replay.sample()

    def reset(self) -> None:
        """Nothing to begin anew: no episode is driven."""

    def shutdown(self) -> None:
        """Nothing to end: no environment is open."""

    def state_dict(self) -> dict[str, Any]:
        """How many have been drawn; the data are not in it."""
        return {"drawn": self._drawn}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Go on after as many."""
        self._drawn = int(state_dict["drawn"])
