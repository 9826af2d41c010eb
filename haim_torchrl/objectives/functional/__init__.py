"""The formulas of HAIM-DRL as pure functions of tensors (only torch is imported here).

Every function returns one number per transition, not reduced over the batch, so that a caller
can mask, weight or average as it likes. Shapes: ``[..., E]`` is a critic ensemble with its
members in the last dimension (``E = 2`` for twins), ``[..., A]`` an action, and everything that
is one number per transition has shape ``[..., 1]``. Equation numbers are those of the HAIM-DRL
paper (Huang et al., "Human as AI mentor", 2024).
"""

from haim_torchrl.objectives.functional.baselines import (
    conservative_penalty,
    ensemble_distance,
    penalised_value,
    shaped_reward,
)
from haim_torchrl.objectives.functional.costs import (
    constant_takeover_cost,
    distance_takeover_cost,
    takeover_cost,
)
from haim_torchrl.objectives.functional.policy import (
    actor_objective,
    anchor_distance,
    temperature_loss,
)
from haim_torchrl.objectives.functional.preference import (
    bounded_preference,
    linear_preference,
)
from haim_torchrl.objectives.functional.targets import (
    Reduction,
    cost_td_target,
    proxy_td_target,
    reduce_ensemble,
    td_loss,
)

__all__ = [
    "Reduction",
    "actor_objective",
    "anchor_distance",
    "bounded_preference",
    "conservative_penalty",
    "constant_takeover_cost",
    "cost_td_target",
    "distance_takeover_cost",
    "ensemble_distance",
    "linear_preference",
    "penalised_value",
    "proxy_td_target",
    "reduce_ensemble",
    "shaped_reward",
    "takeover_cost",
    "td_loss",
    "temperature_loss",
]
