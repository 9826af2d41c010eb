"""Conservative Q-learning: soft actor-critic from data alone, wary of actions not in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor
from torchrl.modules.distributions.utils import rsample_and_log_prob
from torchrl.objectives import CQLLoss

from haim_torchrl.objectives.functional import conservative_penalty


class ConservativeQLoss(CQLLoss):
    """TorchRL's ``CQLLoss``, with the penalty of the paper and a warm-up by cloning.

    Kumar et al., "Conservative Q-Learning for Offline Reinforcement Learning" (2020), in the
    variant CQL(H) without a Lagrange multiplier. Two things differ from ``CQLLoss``:

    - The penalty compares an action of the data with *all* actions drawn at its state. TorchRL
      takes the log-sum-exp over three of them at a time, a looser bound that more draws do not
      improve, and compares each with every action of the batch.
    - ``loss_actor`` is TorchRL's ``loss_actor_bc`` while :attr:`cloning` is set: in the authors'
      code the policy clones the data for some updates before it follows the critics.

    Weights of prioritised replay are honoured, too. All losses can be summed and stepped by one
    optimiser: none reaches another one's parameters.

    Args:
        actor_network: policy with actions in [-1, 1].
        qvalue_network: reads observation and action, writes ``[..., 1]``; two are made of it.
        num_random: actions drawn for each state, of each of three kinds: uniform, of the policy,
            of the policy at the next state. The cost of an update grows with it.
        min_q_weight: weight of the penalty.
        temperature: of its log-sum-exp.
        deactivate_vmap: evaluate the two critics one after the other, at half the time of a vmap.
        **options: of ``CQLLoss``: ``alpha_init``, ``target_entropy``, ``loss_function``, ...

    Attributes:
        cloning: whether the policy clones the data for now.

    Raises:
        ValueError: if ``num_random`` is not positive.

    Examples:
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> loss = ConservativeQLoss(make_actor(3, 2), make_critic(3, 2, ensemble_size=1))
        >>> [key for key in loss.out_keys if key.startswith("loss_")]
        ['loss_actor', 'loss_qvalue', 'loss_cql', 'loss_alpha']
    """

    @dataclass
    class _AcceptedKeys(CQLLoss._AcceptedKeys):
        """Names of entries, beside those of ``CQLLoss``.

        Attributes:
            priority_weight: weights of prioritised replay, ``[...]``; optional.
        """

        priority_weight: NestedKey = "priority_weight"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        qvalue_network: TensorDictModule,
        *,
        num_random: int = 4,
        min_q_weight: float = 1.0,
        temperature: float = 1.0,
        deactivate_vmap: bool = True,
        **options: Any,
    ) -> None:
        if num_random < 1:
            raise ValueError(f"num_random must be at least 1, got {num_random}.")
        super().__init__(
            actor_network,
            qvalue_network,
            num_random=num_random,
            min_q_weight=min_q_weight,
            temperature=temperature,
            deactivate_vmap=deactivate_vmap,
            **options,
        )
        self.out_keys = ["loss_actor", "loss_qvalue", "loss_cql", "loss_alpha"]
        if self.reduction != "none":
            self.out_keys += ["alpha", "entropy"]
        self.cloning = False

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses of a batch.

        Args:
            tensordict: transitions ``[B]`` with a reward. Priorities are added to it.

        Returns:
            ``loss_actor``, ``loss_qvalue``, ``loss_cql`` and ``loss_alpha``, and, unless nothing is
            reduced, ``alpha`` and ``entropy``.
        """
        data = tensordict.copy()
        loss_qvalue, about = self.q_loss(data)
        priority = about["td_error"].max(0).values
        loss_cql, _ = self.cql_loss(data)
        loss_actor, about = self.actor_loss(data)
        loss_alpha, _ = self.alpha_loss(about, mask_tensordict=data)
        losses = {
            "loss_actor": self.actor_bc_loss(data)[0] if self.cloning else loss_actor,
            "loss_qvalue": loss_qvalue,
            "loss_cql": loss_cql,
            "loss_alpha": loss_alpha,
        }
        tensordict.set(self.tensor_keys.priority, priority)
        if self.reduction == "none":
            return TensorDict(losses, batch_size=tensordict.batch_size)
        entropy = -about[self.tensor_keys.log_prob].detach().mean()
        return TensorDict({**losses, "alpha": self._alpha, "entropy": entropy})

    def cql_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Any]]:
        """The penalty of both critics, and nothing beside it.

        Args:
            tensordict: transitions ``[B]`` to which ``q_loss`` has written its predictions.
        """
        actions, log_density = self._draw(tensordict)
        keys = [key for key in self.qvalue_network.in_keys if key != self.tensor_keys.action]
        states = tensordict.select(*keys).unsqueeze(-1).expand(*actions.shape[:-1])
        states = states.set(self.tensor_keys.action, actions)
        value = self.tensor_keys.state_action_value
        drawn = self._vmap_qvalue_networkN0(states, self.qvalue_network_params).get(value)
        known = torch.stack(
            [tensordict.get(self.tensor_keys.pred_q1), tensordict.get(self.tensor_keys.pred_q2)]
        )
        penalty = conservative_penalty(drawn.squeeze(-1), log_density, known, self.temperature)
        loss = self.min_q_weight * penalty.squeeze(-1).sum(0)
        return self._reduce_loss(loss, tensordict=tensordict), {}

    @torch.no_grad()
    def _draw(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Actions ``[B, K, A]`` for each state, and their log-densities ``[B, K]``."""
        known = tensordict.get(self.tensor_keys.action)
        uniform = torch.empty(self.num_random, *known.shape, device=known.device).uniform_(-1, 1)
        density = known.new_full(uniform.shape[:-1], 0.5 ** known.shape[-1]).log()
        drawn = [(uniform, density)]
        with (
            set_exploration_type(ExplorationType.RANDOM),
            self.actor_network_params.data.to_module(
                self.actor_network, preserve_module_state=False
            ),
        ):
            for states in (tensordict, tensordict.get("next")):
                inputs = states.select(*self.actor_network.in_keys)
                inputs = inputs.expand(self.num_random, *inputs.batch_size)
                drawn.append(rsample_and_log_prob(self.actor_network.get_dist(inputs)))
        actions, densities = zip(*drawn)
        return torch.cat(actions).movedim(0, -2), torch.cat(densities).movedim(0, -1)

    def _reduce_loss(
        self, loss: Tensor, tensordict: TensorDictBase | None = None, **options: Any
    ) -> Tensor:
        if tensordict is not None:
            options.setdefault("weights", self._maybe_get_priority_weight(tensordict))
        return super()._reduce_loss(loss, tensordict, **options)
