"""Several actors as one policy, which knows how far they disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from haim_torchrl.modules.actor import ActorMLP, make_actor
from haim_torchrl.modules.doubt import ensemble_doubt
from haim_torchrl.modules.encoder import make_image_actor


class EnsembleActor(nn.Module):
    """E deterministic policies: the action of each, their mean, and their disagreement.

    Each member is an actor's network, of which the squashed mean is the action; the members differ
    by the parameters that they began with. (Networks that begin apart and see the same data
    disagree where there are no data, without a bootstrap: Lakshminarayanan et al., "Simple and
    Scalable Predictive Uncertainty Estimation using Deep Ensembles", 2017.)

    Args:
        members: their networks, at least two.

    Raises:
        ValueError: if there are fewer.
    """

    def __init__(self, members: Sequence[ActorMLP]) -> None:
        super().__init__()
        if len(members) < 2:
            raise ValueError(f"members must be at least 2, to disagree, got {len(members)}.")
        self.members = nn.ModuleList(members)

    def forward(self, *observations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What the ensemble does.

        Args:
            *observations: what each member reads.

        Returns:
            Actions of the members ``[..., E, A]``, their mean ``[..., A]``, and the doubt
            ``[..., 1]``; actions in [-1, 1].
        """
        actions = torch.stack([member(*observations)[0].tanh() for member in self.members], -2)
        return actions, actions.mean(-2), ensemble_doubt(actions.detach())


def make_ensemble_actor(
    observation_dim: int | Mapping[str, Sequence[int]],
    action_dim: int,
    hidden: Sequence[int] = (256, 256),
    *,
    members: int = 5,
    out_keys: Sequence[NestedKey] = ("action_members", "action", "doubt"),
    device: torch.device | str | None = None,
    **options: Any,
) -> TensorDictModule:
    """Makes a policy of several actors, as HG-DAgger has it.

    A collector stores what it writes: ``doubt`` stands beside each step, whoever drove it.

    Args:
        observation_dim: size D of the observation; or the shapes of its entries, for actors that
            see an image, each with an encoder of its own.
        action_dim: size A of the action in [-1, 1].
        hidden: widths of the hidden layers of each member.
        members: number of members E, at least 2.
        out_keys: where the members' actions, the mean action and the doubt go.
        device: where to keep the parameters.
        **options: further arguments of :func:`~haim_torchrl.modules.make_actor`, or of
            :func:`~haim_torchrl.modules.make_image_actor`.

    Returns:
        The policy; it has no spread, and does the same whatever the exploration type.

    Examples:
        >>> from tensordict import TensorDict
        >>> policy = make_ensemble_actor(8, 2, members=3)
        >>> data = policy(TensorDict(observation=torch.zeros(5, 8), batch_size=[5]))
        >>> data["action_members"].shape, data["action"].shape, data["doubt"].shape
        (torch.Size([5, 3, 2]), torch.Size([5, 2]), torch.Size([5, 1]))
    """
    make: Any = make_image_actor if isinstance(observation_dim, Mapping) else make_actor
    actors = [
        make(observation_dim, action_dim, hidden, device=device, **options) for _ in range(members)
    ]
    network = EnsembleActor([actor.module[0].module for actor in actors])
    keys = list(actors[0].module[0].in_keys) if actors else []
    return TensorDictModule(network, in_keys=keys, out_keys=list(out_keys))
