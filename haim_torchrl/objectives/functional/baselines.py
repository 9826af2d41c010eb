"""What only the methods that HAIM-DRL is compared with need."""

from __future__ import annotations

from torch import Tensor

from haim_torchrl.objectives.functional.shapes import check_scalar


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
    check_scalar("value", value)
    drawn = ((values - log_density) / temperature).logsumexp(-1, keepdim=True)
    return temperature * drawn - value


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
    check_scalar("reward", reward)
    check_scalar("cost", cost)
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
    check_scalar("value", value)
    check_scalar("cost_value", cost_value)
    return (value - multiplier * cost_value) / (1.0 + multiplier)
