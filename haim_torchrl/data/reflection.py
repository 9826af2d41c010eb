"""Left and right exchanged: every transition is worth two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor


@dataclass(frozen=True)
class Reflection:
    """How a transition looks in a mirror, for worlds that are the same on the left and the right.

    A road that bends to the left, an obstacle that is passed on the right: mirrored, the mentor
    has shown what to do on the opposite one, too. Costs, and who drove, are the same in a mirror.

    Attributes:
        order: for each number of the observation, the index of the one that it becomes; [D]. Empty
            where no observation is a vector that a mirror changes.
        sign: for each number of the mirrored observation, 1 or -1; [D].
        action_sign: for each number of the action, 1 or -1; [A].
        observation_keys: entries that are observations, vectors.
        image_keys: entries that are images [..., S], columns from the left to the right around the
            vehicle in the middle.
        action_keys: entries that are actions.

    Raises:
        ValueError: if `order` is no permutation, a sign is not 1 or -1, or a reflection of the
            reflection is not the observation itself.
    """

    order: Sequence[int]
    sign: Sequence[float]
    action_sign: Sequence[float]
    observation_keys: tuple[NestedKey, ...] = ("observation", ("next", "observation"))
    image_keys: tuple[NestedKey, ...] = ()
    action_keys: tuple[NestedKey, ...] = ("action", "action_agent", "action_mentor")

    def __post_init__(self) -> None:
        size = len(self.order)
        if sorted(self.order) != list(range(size)) or len(self.sign) != size:
            raise ValueError("order must be a permutation, and sign as long as order.")
        if {abs(sign) for sign in (*self.sign, *self.action_sign)} - {1.0}:
            raise ValueError("sign and action_sign must be 1 or -1 everywhere.")
        for k, source in enumerate(self.order):
            if self.order[source] != k or self.sign[source] != self.sign[k]:
                raise ValueError("mirrored twice, an observation must be what it was.")

    def observation(self, observation: Tensor) -> Tensor:
        """The mirrored observation, ``[..., D]``."""
        index = torch.tensor(self.order, device=observation.device)
        return observation.index_select(-1, index) * observation.new_tensor(self.sign)

    def image(self, image: Tensor) -> Tensor:
        """The mirrored image, ``[..., S]``."""
        return image.flip(-1)

    def action(self, action: Tensor) -> Tensor:
        """The mirrored action, ``[..., A]``."""
        return action * action.new_tensor(self.action_sign)

    def __call__(self, batch: TensorDictBase, share: float = 0.5) -> TensorDictBase:
        """Mirrors transitions, each with a given probability.

        Args:
            batch: transitions, batch size ``[B]``; changed in place. Of the entries named, those
                that it has are mirrored.
            share: the probability, in [0, 1].

        Returns:
            The batch.
        """
        chosen = torch.rand(len(batch), device=batch.device) < share
        for keys, mirrored in (
            (self.observation_keys, self.observation),
            (self.image_keys, self.image),
            (self.action_keys, self.action),
        ):
            for key in keys:
                value = batch.get(key, default=None)
                if value is not None:
                    rows = chosen.reshape(-1, *[1] * (value.ndim - 1))
                    batch.set(key, torch.where(rows, mirrored(value), value))
        return batch
