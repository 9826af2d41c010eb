"""Cost of causing a takeover (eq 23), and two others to compare it with."""

from __future__ import annotations

from torch import Tensor

from haim_torchrl.objectives.functional.shapes import check_scalar

#: Below this product of norms the angle between two actions is not defined (decision for eq 23).
MINIMUM_NORM_PRODUCT = 1e-6


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
    check_scalar("takeover_start", takeover_start)
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
    check_scalar("takeover_start", takeover_start)
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
    check_scalar("takeover_start", takeover_start)
    difference = action_agent - action_mentor
    distance = difference.square().mean(-1, keepdim=True).sqrt()
    return distance.masked_fill(~takeover_start, 0.0)
