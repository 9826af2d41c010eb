"""Formulas of the on-policy baselines, as pure functions of tensors (only torch is imported).

Whatever is one number per transition has the shape ``[..., 1]``, a Gaussian's mean and spread
``[..., A]``.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import softplus


def imitation_reward(logits: Tensor) -> Tensor:
    r"""Reward of looking like an expert, :math:`-\log(1 - D(s, a))`.

    D is the probability that the pair is an expert's (1 for the expert, 0 for the policy; Ho and
    Ermon, "Generative Adversarial Imitation Learning", NeurIPS 2016, print the labels the other
    way round). Its sign is a bias of its own where episodes end (Kostrikov et al.,
    "Discriminator-Actor-Critic", ICLR 2019). This form is positive: a policy never gains by ending
    an episode early, be it in a collision. But arriving ends the episode as well, and forfeits what
    driving on would still have paid. The log-odds themselves, :math:`\log D - \log(1 - D)` (Fu,
    Luo and Levine, AIRL, ICLR 2018), have either sign, and about 0 where both look the same.

    Args:
        logits: log-odds of D, ``[..., 1]``.

    Returns:
        Reward, ``[..., 1]``, never negative.

    Examples:
        >>> import torch
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
        >>> import torch
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
