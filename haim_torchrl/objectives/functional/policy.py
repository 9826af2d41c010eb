"""What the policy maximises (eq 25), its entropy's temperature, and a pull to the mentor."""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor

from haim_torchrl.objectives.functional.shapes import check_scalar


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
    check_scalar("log_prob", log_prob)
    objective = -alpha * log_prob
    for weight, value in weighted_values:
        check_scalar("value", value)
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
    check_scalar("log_prob", log_prob)
    return -log_alpha * (log_prob.detach() + target_entropy)


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
    check_scalar("intervention", intervention)
    distance = 0.5 * (action - action_mentor).square().sum(-1, keepdim=True)
    return distance.masked_fill(~intervention, 0.0)
