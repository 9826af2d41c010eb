"""Temporal-difference loss of the proxy critic (eq 17 and 18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules.temperature import Temperature, as_temperature
from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.temporal_difference import TemporalDifferenceTerm


class ProxyQLoss(TemporalDifferenceTerm):
    r"""Carries the preference at takeovers back to the states that lead there (eq 17, 18).

    .. math:: \tfrac12 (Q(s, a) - y)^2,\quad y = \gamma [\min Q'(s', a') - \alpha \log\pi(a'|s')]

    The action is the executed one, whoever drove: the critic belongs to the mixed policy. No
    reward is read. Use it with a preference term on the same critic, else there is nothing to
    carry.

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        temperature: entropy temperature α, shared with the other terms, or a constant.
        label: the loss is named ``loss_<label>``.
        actor_weight: weight ψ of this critic in the actor's objective (eq 25).
        actor_reduction: how the actor reduces the twins; ``"min"`` is soft actor-critic's.
        target_reduction: how the target reduces the twins.
        takeover_starts: whether the critic is regressed on the first steps of takeovers, too, as
            eq 17 has it. There the agent's proposal was cut short, and what comes next is the
            mentor's doing; ``False`` leaves these steps to the preference alone.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> from haim_torchrl.objectives import TargetUpdater
        >>> loss = ProxyQLoss(make_actor(3, 2), make_critic(3, 2), temperature=0.1)
        >>> loss = loss.make_value_estimator(gamma=0.9)
        >>> updater = TargetUpdater(loss, tau=0.005)
        >>> next_data = {"observation": torch.zeros(4, 3), "terminated": torch.zeros(4, 1) > 0}
        >>> data = {"observation": torch.zeros(4, 3), "action": torch.zeros(4, 2)}
        >>> loss(TensorDict({**data, "next": next_data}, [4]))["loss_proxy_q"].shape
        torch.Size([])
    """

    @dataclass
    class _AcceptedKeys(TemporalDifferenceTerm._AcceptedKeys):
        takeover_start: NestedKey = "takeover_start"

    default_keys = _AcceptedKeys

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: TensorDictModule,
        temperature: Temperature | float = 1.0,
        *,
        label: str = "proxy_q",
        actor_weight: float = 1.0,
        actor_reduction: Reduction = "min",
        target_reduction: Reduction = "min",
        takeover_starts: bool = True,
        reduction: str | None = None,
    ) -> None:
        super().__init__(
            actor_network,
            critic_network,
            label=label,
            actor_weight=actor_weight,
            actor_reduction=actor_reduction,
            target_reduction=target_reduction,
            reduction=reduction,
        )
        self.temperature = as_temperature(temperature)
        self.takeover_starts = takeover_starts

    @property
    def action_key(self) -> NestedKey:
        """The executed action."""
        return self.tensor_keys.action

    def target(
        self, batch: ForwardPass, next_values: Tensor, next_log_prob: Tensor, gamma: Tensor
    ) -> Tensor:
        """Reward-free soft target (eq 18), ``[..., 1]``."""
        return functional.proxy_td_target(
            next_values,
            next_log_prob,
            batch.read(("next", self.tensor_keys.terminated)),
            alpha=self.temperature(),
            gamma=gamma,
            reduction=self.target_reduction,
        )

    def counted(self, batch: ForwardPass) -> Tensor | None:
        """All steps, or all but the first ones of takeovers."""
        return None if self.takeover_starts else ~batch.read(self.tensor_keys.takeover_start)

    def reads(self) -> Sequence[NestedKey]:
        """What the base reads, and where takeovers begin if these steps are left out."""
        keys = [] if self.takeover_starts else [self.tensor_keys.takeover_start]
        return [*super().reads(), *keys]
