"""Targets of the critics (eq 18, 22, 24) and their error (eq 17)."""

from __future__ import annotations

from typing import Literal

from torch import Tensor

from haim_torchrl.objectives.functional.shapes import check_scalar

Reduction = Literal["min", "max", "mean"]


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
    check_scalar("next_log_prob", next_log_prob)
    check_scalar("terminated", terminated)
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
    check_scalar("cost", cost)
    check_scalar("terminated", terminated)
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
    check_scalar("target", target)
    return 0.5 * (values - target).square().sum(-1, keepdim=True)
