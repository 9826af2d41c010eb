"""The formulas of HAIM-DRL as pure functions of tensors (only torch is imported here).

Every function returns one number per transition, not reduced over the batch, so that a caller
can mask, weight or average as it likes. Shapes: ``[..., E]`` is a critic ensemble with its
members in the last dimension (``E = 2`` for twins), ``[..., A]`` an action, and everything that
is one number per transition has shape ``[..., 1]``. Equation numbers are those of the HAIM-DRL
paper (Huang et al., "Human as AI mentor", 2024).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from torch import Tensor

Reduction = Literal["min", "max", "mean"]

#: Below this product of norms the angle between two actions is not defined (decision for eq 23).
MINIMUM_NORM_PRODUCT = 1e-6


def reduce_ensemble(values: Tensor, reduction: Reduction) -> Tensor:
    """Turns the estimates of all ensemble members into one.

    Args:
        values: estimates, ``[..., E]``.
        reduction: ``"min"`` is pessimistic for a value that the policy maximises, ``"max"`` is
            pessimistic for a cost that the policy minimises, ``"mean"`` is neither.

    Returns:
        One estimate per transition, ``[..., 1]``.

    Raises:
        ValueError: if the reduction is unknown.

    Examples:
        >>> import torch
        >>> reduce_ensemble(torch.tensor([[1.0, 3.0]]), "min")
        tensor([[1.]])
    """
    if reduction == "min":
        return values.amin(-1, keepdim=True)
    if reduction == "max":
        return values.amax(-1, keepdim=True)
    if reduction == "mean":
        return values.mean(-1, keepdim=True)
    raise ValueError(f"reduction must be 'min', 'max' or 'mean', got {reduction!r}.")


def proxy_td_target(
    next_values: Tensor,
    next_log_prob: Tensor,
    terminated: Tensor,
    *,
    alpha: Tensor | float,
    gamma: Tensor | float,
    reduction: Reduction = "min",
) -> Tensor:
    r"""Reward-free soft target of the proxy critic (eq 18).

    .. math:: y = \gamma\,(1 - d)\,[\min_e Q'_e(s', a') - \alpha \log\pi(a' \mid s')]

    There is no reward: what the agent should value is carried by the preference term alone. The
    minimum over twins keeps the maximising policy from exploiting overestimated actions. The
    target bootstraps through a truncation (the episode was only cut off by the clock) and never
    through a termination (there is no next state): hence ``terminated`` and not ``done``.

    Args:
        next_values: target critics at the next state and at a fresh action of the agent's
            policy, ``[..., E]``.
        next_log_prob: log-density of that action in nats, ``[..., 1]``.
        terminated: whether the episode really ended, bool, ``[..., 1]``.
        alpha: entropy temperature.
        gamma: discount factor of the whole step (already raised to n for an n-step transition).
        reduction: how to reduce the ensemble.

    Returns:
        Targets, ``[..., 1]``.
    """
    _check_scalar("next_log_prob", next_log_prob)
    _check_scalar("terminated", terminated)
    soft_value = reduce_ensemble(next_values, reduction) - alpha * next_log_prob
    return gamma * soft_value.masked_fill(terminated, 0.0)


def cost_td_target(
    cost: Tensor,
    next_values: Tensor,
    terminated: Tensor,
    *,
    gamma: Tensor | float,
    reduction: Reduction = "min",
) -> Tensor:
    r"""Target of a cost critic: implicit (eq 22) and explicit (eq 24) intervention.

    .. math:: y = C + \gamma\,(1 - d)\,\min_e Q'_e(s', a')

    There is no entropy bonus: a cost critic counts expected costs only, and the exploration bonus
    already is in the proxy critic and in the actor's objective. The larger twin would be the
    pessimistic one, since the policy *minimises* this value and exploits an underestimated cost;
    but bootstrapped through the maximum the values grew without end, hence the minimum as default.

    Args:
        cost: cost of the transition, ``[..., 1]``.
        next_values: target critics at the next state and at a fresh action of the agent's
            policy, ``[..., E]``.
        terminated: whether the episode really ended, bool, ``[..., 1]``.
        gamma: discount factor of the whole step.
        reduction: how to reduce the ensemble.

    Returns:
        Targets, ``[..., 1]``.
    """
    _check_scalar("cost", cost)
    _check_scalar("terminated", terminated)
    next_value = reduce_ensemble(next_values, reduction)
    return cost + gamma * next_value.masked_fill(terminated, 0.0)


def td_loss(values: Tensor, target: Tensor) -> Tensor:
    r"""Squared temporal-difference error (eq 17), :math:`\sum_e \frac12 (Q_e(s, a) - y)^2`.

    The ½ stands before the square: the paper prints it inside the bracket, before Q, where the
    fixed point would be Q = 2y. Members are summed, so that each twin has the gradient that it
    would have alone.

    Args:
        values: critics at the stored state and action, ``[..., E]``.
        target: regression target, without gradient, ``[..., 1]``.

    Returns:
        Loss of each transition, ``[..., 1]``.
    """
    _check_scalar("target", target)
    return 0.5 * (values - target).square().sum(-1, keepdim=True)


def linear_preference(values_agent: Tensor, values_mentor: Tensor, intervention: Tensor) -> Tensor:
    r"""Preference of the mentor's action over the rejected one (eq 16).

    .. math:: I \cdot \sum_e [Q_e(s, a_{agent}) - Q_e(s, a_{mentor})]

    Linear, hence unbounded: without a reward nothing but the TD term anchors the proxy values.
    Zero where nobody intervened, whatever the values there (even when not finite).

    Args:
        values_agent: proxy critics at the action that the agent proposed, ``[..., E]``.
        values_mentor: proxy critics at the mentor's action, ``[..., E]``.
        intervention: whether the mentor drove, bool, ``[..., 1]``.

    Returns:
        Term of each transition, without its weight, ``[..., 1]``.
    """
    _check_scalar("intervention", intervention)
    gap = (values_agent - values_mentor).sum(-1, keepdim=True)
    return gap.masked_fill(~intervention, 0.0)


def bounded_preference(
    values_agent: Tensor,
    values_mentor: Tensor,
    intervention: Tensor,
    *,
    bound: float = 1.0,
) -> Tensor:
    r"""Preference with values drawn to ±bound instead of pushed apart for ever (PVP).

    .. math:: \tfrac12 I \cdot \sum_e [(Q_e(s, a_{mentor}) - b)^2 + (Q_e(s, a_{agent}) + b)^2]

    The bounded twin of eq 16, after Peng et al., "Learning from Active Human Involvement through
    Proxy Value Propagation" (NeurIPS 2023): with the linear form proxy values were seen to grow
    without limit, which then degrades the policy.

    Args:
        values_agent: proxy critics at the action that the agent proposed, ``[..., E]``.
        values_mentor: proxy critics at the mentor's action, ``[..., E]``.
        intervention: whether the mentor drove, bool, ``[..., 1]``.
        bound: value of a preferred action; a rejected one gets ``-bound``.

    Returns:
        Term of each transition, without its weight, ``[..., 1]``.
    """
    _check_scalar("intervention", intervention)
    squares = (values_mentor - bound).square() + (values_agent + bound).square()
    return 0.5 * squares.sum(-1, keepdim=True).masked_fill(~intervention, 0.0)


def takeover_cost(action_agent: Tensor, action_mentor: Tensor, takeover_start: Tensor) -> Tensor:
    r"""Cost of causing a takeover (eq 23), graded by the angle between both actions.

    .. math:: C^{EX} = 1 - \cos(a_{agent}, a_{mentor}) \in [0, 2]

    Only the first step of a takeover is charged, because it is the action rejected at that moment
    that provoked it. Where the product of norms is below ``1e-6`` the angle is not defined and
    the cost is 0: a standing-still action by either side is no evidence of disagreement.

    Args:
        action_agent: what the agent proposed, ``[..., A]``.
        action_mentor: what the mentor did, ``[..., A]``.
        takeover_start: whether this is the first step of a takeover, bool, ``[..., 1]``.

    Returns:
        Cost, ``[..., 1]``.

    Examples:
        >>> import torch
        >>> takeover_cost(torch.tensor([1.0, 0.0]), torch.tensor([0.0, 1.0]), torch.tensor([True]))
        tensor([1.])
    """
    _check_scalar("takeover_start", takeover_start)
    inner = (action_agent * action_mentor).sum(-1, keepdim=True)
    norms = action_agent.norm(dim=-1, keepdim=True) * action_mentor.norm(dim=-1, keepdim=True)
    cosine = (inner / norms.clamp_min(MINIMUM_NORM_PRODUCT)).clamp(-1.0, 1.0)
    charged = takeover_start & (norms >= MINIMUM_NORM_PRODUCT)
    return (1.0 - cosine).masked_fill(~charged, 0.0)


def constant_takeover_cost(
    action_agent: Tensor, action_mentor: Tensor, takeover_start: Tensor
) -> Tensor:
    """The paper's ablation of eq 23: +1 for the first step of every takeover.

    Args:
        action_agent: what the agent proposed, ``[..., A]``; only its type and device are used.
        action_mentor: what the mentor did, ``[..., A]``; not used.
        takeover_start: whether this is the first step of a takeover, bool, ``[..., 1]``.

    Returns:
        Cost, ``[..., 1]``.
    """
    _check_scalar("takeover_start", takeover_start)
    return takeover_start.to(action_agent.dtype)


def distance_takeover_cost(
    action_agent: Tensor, action_mentor: Tensor, takeover_start: Tensor
) -> Tensor:
    r"""A takeover cost that sees magnitudes, too: the distance between both actions.

    .. math:: \lVert a_{agent} - a_{mentor} \rVert / \sqrt A

    The angle of eq 23 is blind to them: braking gently and fully are one direction, and almost
    opposite tiny corrections cost nearly 2. For actions in [-1, 1] this lies in [0, 2], as eq 23
    does, and it is defined for actions of length zero.

    Args:
        action_agent: what the agent proposed, ``[..., A]``.
        action_mentor: what the mentor did, ``[..., A]``.
        takeover_start: whether this is the first step of a takeover, bool, ``[..., 1]``.

    Returns:
        Cost, ``[..., 1]``.

    Examples:
        >>> import torch
        >>> gentle, full = torch.tensor([0.2, 0.0]), torch.tensor([1.0, 0.0])
        >>> distance_takeover_cost(gentle, full, torch.tensor([True]))
        tensor([0.5657])
        >>> takeover_cost(gentle, full, torch.tensor([True]))
        tensor([0.])
    """
    _check_scalar("takeover_start", takeover_start)
    difference = action_agent - action_mentor
    distance = difference.square().mean(-1, keepdim=True).sqrt()
    return distance.masked_fill(~takeover_start, 0.0)


def actor_objective(
    log_prob: Tensor,
    weighted_values: Iterable[tuple[Tensor | float, Tensor]],
    alpha: Tensor | float,
) -> Tensor:
    r"""What the policy maximises (eq 25).

    .. math:: \sum_k w_k Q_k(s, a) - \alpha \log\pi(a \mid s),\quad a \sim \pi(\cdot \mid s)

    In the paper the signed weights are ψ for the proxy value, −β for the explicit and −φ for the
    implicit intervention value. A term left out is a pair left out.

    Args:
        log_prob: log-density of the fresh action in nats, ``[..., 1]``.
        weighted_values: pairs of a signed weight and a reduced critic ``[..., 1]``.
        alpha: entropy temperature.

    Returns:
        Objective of each transition, to be maximised, ``[..., 1]``.
    """
    _check_scalar("log_prob", log_prob)
    objective = -alpha * log_prob
    for weight, value in weighted_values:
        _check_scalar("value", value)
        objective = objective + weight * value
    return objective


def temperature_loss(log_alpha: Tensor, log_prob: Tensor, target_entropy: float) -> Tensor:
    r"""Loss whose descent drives the policy's entropy to its target.

    .. math:: -\log\alpha \cdot (\log\pi(a \mid s) + \bar{\mathcal H})

    After Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (2018), with log α in
    place of α as most implementations have it: the step then does not vanish with α.

    Args:
        log_alpha: logarithm of the temperature, a scalar with gradient.
        log_prob: log-density of a fresh action in nats, ``[..., 1]``, taken as a constant.
        target_entropy: wanted entropy in nats.

    Returns:
        Loss of each transition, ``[..., 1]``.
    """
    _check_scalar("log_prob", log_prob)
    return -log_alpha * (log_prob.detach() + target_entropy)


def conservative_penalty(
    values: Tensor, log_density: Tensor, value: Tensor, temperature: float = 1.0
) -> Tensor:
    r"""How much higher the values of drawn actions are than that of the data's action: CQL(H).

    .. math:: T \log \sum_k e^{(Q(s, a_k) - \log p(a_k)) / T} - Q(s, a)

    Kumar et al., "Conservative Q-Learning for Offline Reinforcement Learning" (2020), eq 4 and
    appendix F; up to the constant T log K, which has no gradient.

    Args:
        values: of the drawn actions, ``[..., K]``.
        log_density: of these under what they were drawn from, ``[..., K]``.
        value: of the data's action, ``[..., 1]``.
        temperature: T.

    Returns:
        The penalty, ``[..., 1]``.

    Examples:
        >>> import torch
        >>> even = torch.tensor([[2.0, 2.0]])
        >>> conservative_penalty(even, torch.zeros(1, 2), torch.tensor([[2.0]])).exp()
        tensor([[2.]])
    """
    _check_scalar("value", value)
    drawn = ((values - log_density) / temperature).logsumexp(-1, keepdim=True)
    return temperature * drawn - value


def anchor_distance(action: Tensor, action_mentor: Tensor, intervention: Tensor) -> Tensor:
    """Half the squared distance to the mentor's action, where the mentor drove.

    Not in the paper: behaviour cloning of the intervened transitions.

    Args:
        action: of the policy, ``[..., A]``.
        action_mentor: ``[..., A]``.
        intervention: whether the mentor drove, bool, ``[..., 1]``.

    Returns:
        ``I * |a - a_mentor|^2 / 2``, ``[..., 1]``.
    """
    _check_scalar("intervention", intervention)
    distance = 0.5 * (action - action_mentor).square().sum(-1, keepdim=True)
    return distance.masked_fill(~intervention, 0.0)


def ensemble_distance(actions: Tensor, action: Tensor) -> Tensor:
    r"""Mean squared distance of an ensemble's actions to the one that is cloned.

    .. math:: \frac{1}{E A} \sum_e \lVert a_e - a \rVert^2

    The mean action's distance would not do: members that err to either side would not be drawn to
    the action, and their disagreement would say nothing.

    Args:
        actions: of the members, ``[..., E, A]``.
        action: what was done, ``[..., A]``.

    Returns:
        Distance, ``[..., 1]``.

    Raises:
        ValueError: if the shapes do not fit.
    """
    if actions.ndim != action.ndim + 1 or actions.shape[-1] != action.shape[-1]:
        raise ValueError(
            f"actions must have the shape [..., E, A] and action [..., A], got "
            f"{tuple(actions.shape)} and {tuple(action.shape)}."
        )
    return (actions - action.unsqueeze(-2)).square().mean((-2, -1)).unsqueeze(-1)


def shaped_reward(reward: Tensor, cost: Tensor, cost_weight: float) -> Tensor:
    """The reward less what the cost weighs: the paper's reward shaping ("RS").

    Only the baselines that learn from the environment's reward use it.

    Args:
        reward: of the environment, ``[..., 1]``.
        cost: of the environment, +1 for each collision, ``[..., 1]``.
        cost_weight: reward that a cost of 1 takes away.

    Returns:
        ``reward - cost_weight * cost``, ``[..., 1]``.

    Examples:
        >>> import torch
        >>> shaped_reward(torch.tensor([1.5]), torch.tensor([1.0]), cost_weight=5.0)
        tensor([-3.5000])
    """
    _check_scalar("reward", reward)
    _check_scalar("cost", cost)
    return reward - cost_weight * cost


def penalised_value(value: Tensor, cost_value: Tensor, multiplier: Tensor | float) -> Tensor:
    r"""A value under a Lagrange multiplier, :math:`(Q_r - \lambda Q_c) / (1 + \lambda)`.

    The denominator keeps the scale, and with it the step of the policy, whatever the multiplier
    (Stooke et al., "Responsive safety in reinforcement learning by PID Lagrangian methods", ICML
    2020). Values of state and action, or advantages.

    Args:
        value: of the reward, ``[..., 1]``.
        cost_value: of the cost, ``[..., 1]``.
        multiplier: λ ≥ 0, a scalar.

    Returns:
        What the policy maximises, ``[..., 1]``.

    Examples:
        >>> import torch
        >>> penalised_value(torch.tensor([2.0]), torch.tensor([1.0]), 3.0)
        tensor([-0.2500])
    """
    _check_scalar("value", value)
    _check_scalar("cost_value", cost_value)
    return (value - multiplier * cost_value) / (1.0 + multiplier)


def _check_scalar(name: str, tensor: Tensor) -> None:
    if tensor.ndim == 0 or tensor.shape[-1] != 1:
        raise ValueError(
            f"{name} must hold one number per transition, shape [..., 1], got "
            f"{tuple(tensor.shape)}; add the last dimension with .unsqueeze(-1)."
        )
