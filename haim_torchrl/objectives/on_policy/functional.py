"""The formulas of the on-policy baselines, as pure functions of tensors (only torch is imported).

Whatever is one number per transition has the shape ``[..., 1]``, a Gaussian's mean and spread
``[..., A]``.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import softplus


def shaped_reward(reward: Tensor, cost: Tensor, weight: float) -> Tensor:
    """The reward less what the cost weighs: the paper's "reward shaping".

    Args:
        reward: of the environment, ``[..., 1]``.
        cost: +1 for each collision, ``[..., 1]``.
        weight: reward that a cost of 1 takes away.

    Returns:
        ``reward - weight * cost``, ``[..., 1]``.
    """
    return reward - weight * cost


def penalised_advantage(advantage: Tensor, cost_advantage: Tensor, multiplier: Tensor) -> Tensor:
    r"""Advantage under a Lagrange multiplier, :math:`(A_r - \lambda A_c) / (1 + \lambda)`.

    The denominator keeps the scale, and with it the step, whatever the multiplier (Stooke et al.,
    "Responsive Safety in Reinforcement Learning by PID Lagrangian Methods", ICML 2020, eq 9).

    Args:
        advantage: of the reward, ``[..., 1]``.
        cost_advantage: of the cost, ``[..., 1]``.
        multiplier: λ ≥ 0, a scalar.

    Returns:
        Advantage, ``[..., 1]``.

    Examples:
        >>> penalised_advantage(torch.tensor([2.0]), torch.tensor([1.0]), torch.tensor(3.0))
        tensor([-0.2500])
    """
    return (advantage - multiplier * cost_advantage) / (1.0 + multiplier)


def imitation_reward(logits: Tensor) -> Tensor:
    r"""Reward of looking like an expert, :math:`-\log(1 - D(s, a))`.

    D is the probability that the pair is an expert's (1 for the expert, 0 for the policy; Ho and
    Ermon, "Generative Adversarial Imitation Learning", NeurIPS 2016, print the labels the other
    way round). This form is positive: a policy never gains by ending an episode early.

    Args:
        logits: log-odds of D, ``[..., 1]``.

    Returns:
        Reward, ``[..., 1]``, never negative.

    Examples:
        >>> imitation_reward(torch.tensor([0.0]))
        tensor([0.6931])
    """
    return softplus(logits)


def gaussian_kl(loc: Tensor, scale: Tensor, new_loc: Tensor, new_scale: Tensor) -> Tensor:
    r"""Divergence of a diagonal Gaussian from another one, :math:`KL(old \| new)`, in nats.

    Squashing both by the same one-to-one function leaves it as it is, so that it is also that of
    the squashed Gaussians which a policy acts with.

    Args:
        loc: mean of the first, ``[..., A]``.
        scale: spread of the first, ``[..., A]``.
        new_loc: mean of the second, ``[..., A]``.
        new_scale: spread of the second, ``[..., A]``.

    Returns:
        Divergence, ``[..., 1]``, summed over the dimensions of the action.
    """
    moved = (scale.square() + (loc - new_loc).square()) / (2.0 * new_scale.square())
    return (new_scale.log() - scale.log() + moved - 0.5).sum(-1, keepdim=True)


class EpisodeMean(NamedTuple):
    """What a batch says of whole episodes.

    Attributes:
        cost: cost of an episode, undiscounted, a scalar.
        length: steps of an episode, a scalar.
    """

    cost: Tensor
    length: Tensor


def episode_mean(cost: Tensor, done: Tensor) -> EpisodeMean:
    """Mean cost and length of an episode, estimated from a batch of consecutive steps.

    All cost of the batch over the number of episodes that ended in it: what reaches over the edge
    of a batch is neither lost nor counted twice in the long run. A batch in which none ended counts
    as one.

    Args:
        cost: of each step, ``[..., 1]``.
        done: whether the step ended its episode, bool, ``[..., 1]``.

    Returns:
        The means.

    Examples:
        >>> done = torch.tensor([[False], [True], [False], [True]])
        >>> mean = episode_mean(torch.tensor([[0.0], [1.0], [0.0], [0.0]]), done)
        >>> float(mean.cost), float(mean.length)
        (0.5, 2.0)
    """
    ended = done.sum().clamp_min(1)
    return EpisodeMean(cost.sum() / ended, done.numel() / ended)


def standardised(values: Tensor) -> Tensor:
    """The same with mean 0 and standard deviation 1; with mean 0 alone where all are equal."""
    centred = values - values.mean()
    return centred / centred.square().mean().sqrt().clamp_min(1e-8)
