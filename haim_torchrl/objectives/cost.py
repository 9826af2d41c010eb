"""Critics of the expected cost of intervention, explicit (eq 24) and implicit (eq 22)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.temporal_difference import TemporalDifferenceTerm


class CostCriticLoss(TemporalDifferenceTerm):
    r"""Expected discounted cost of the agent's proposals.

    .. math:: \tfrac12 (Q^C(s, a_{agent}) - y)^2,\quad y = C + \gamma \min Q'^C(s', a')

    The critic has its own twins, targets and loss, and no other loss reaches it. It is regressed
    at the action that the agent *proposed*, also where the mentor did something else: the cost is
    charged to the proposal that provoked it. There is no entropy bonus in the target, because it
    counts costs only.

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        label: the loss is named ``loss_<label>``; by default after the cost.
        actor_weight: signed weight in the actor's objective (eq 25), negative: costs are
            minimised.
        actor_reduction: how the actor reduces the twins. ``"max"`` by default: a policy that
            minimises a value seeks out where it is underestimated, so the larger twin is the
            cautious one, as the smaller one is for a value that is maximised.
        target_reduction: how the target reduces the twins. ``"min"`` by default, as in clipped
            double Q-learning: with ``"max"`` each backup takes the larger twin, and the values were
            seen to grow without end.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(TemporalDifferenceTerm._AcceptedKeys):
        action_agent: NestedKey = "action_agent"
        cost: NestedKey = "cost"
        priority: NestedKey = "cost_td_error"

    default_keys = _AcceptedKeys
    #: What the loss is named after where no label is given.
    default_label: ClassVar[str] = "cost"

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: TensorDictModule,
        *,
        label: str | None = None,
        actor_weight: float = -1.0,
        actor_reduction: Reduction = "max",
        target_reduction: Reduction = "min",
        reduction: str | None = None,
    ) -> None:
        super().__init__(
            actor_network,
            critic_network,
            label=label or self.default_label,
            actor_weight=actor_weight,
            actor_reduction=actor_reduction,
            target_reduction=target_reduction,
            reduction=reduction,
        )

    @property
    def action_key(self) -> NestedKey:
        """The action that the agent proposed."""
        return self.tensor_keys.action_agent

    def target(
        self, batch: ForwardPass, next_values: Tensor, next_log_prob: Tensor, gamma: Tensor
    ) -> Tensor:
        """Cost plus discounted expected cost (eq 22, 24), ``[..., 1]``."""
        return functional.cost_td_target(
            batch.read(("next", self.tensor_keys.cost)),
            next_values,
            batch.read(("next", self.tensor_keys.terminated)),
            gamma=gamma,
            reduction=self.target_reduction,
        )

    def reads(self) -> Sequence[NestedKey]:
        """What the base reads, and the cost."""
        return [*super().reads(), ("next", self.tensor_keys.cost)]


class ExplicitInterventionLoss(CostCriticLoss):
    """Q^EX: how much takeover a proposal will cost the mentor (eq 24).

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        label: the loss is named ``loss_<label>``.
        actor_weight: −β of eq 25.
        actor_reduction: see :class:`CostCriticLoss`.
        target_reduction: see :class:`CostCriticLoss`.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(CostCriticLoss._AcceptedKeys):
        cost: NestedKey = "takeover_cost"
        priority: NestedKey = "explicit_td_error"

    default_keys = _AcceptedKeys
    default_label = "explicit"


class ImplicitInterventionLoss(CostCriticLoss):
    """Q^IM: how much a proposal will disturb the following traffic (eq 22).

    A proposal that the mentor replaced was never seen to disturb anybody, and its cost of 0 says
    nothing about it: these steps are left out, unless ``intervened`` (decision 11).

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        label: the loss is named ``loss_<label>``.
        actor_weight: −φ of eq 25.
        actor_reduction: see :class:`CostCriticLoss`.
        target_reduction: see :class:`CostCriticLoss`.
        intervened: whether the critic is regressed on the mentor's steps, too, as eq 22 has it.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(CostCriticLoss._AcceptedKeys):
        cost: NestedKey = "disturbance_cost"
        intervention: NestedKey = "intervention"
        priority: NestedKey = "implicit_td_error"

    default_keys = _AcceptedKeys
    default_label = "implicit"

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: TensorDictModule,
        *,
        label: str | None = None,
        actor_weight: float = -1.0,
        actor_reduction: Reduction = "max",
        target_reduction: Reduction = "min",
        intervened: bool = False,
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
        self.intervened = intervened

    def counted(self, batch: ForwardPass) -> Tensor | None:
        """The agent's own steps, unless the mentor's count, too."""
        return None if self.intervened else ~batch.read(self.tensor_keys.intervention)

    def reads(self) -> Sequence[NestedKey]:
        """What the base reads, and who drove."""
        keys = [] if self.intervened else [self.tensor_keys.intervention]
        return [*super().reads(), *keys]
