"""How unsure an ensemble is, and from where on a person did not trust it (HG-DAgger)."""

from __future__ import annotations

from torch import Tensor


def ensemble_doubt(actions: Tensor) -> Tensor:
    r"""Disagreement of an ensemble: the norm of the variances of its members' actions.

    .. math:: d(s) = \lVert \operatorname{diag} \operatorname{Cov}_e[a_e(s)] \rVert_2

    After Kelly et al., "HG-DAgger: Interactive Imitation Learning with Human Experts" (2019). The
    covariance is that of a sample: it divides by E - 1.

    Args:
        actions: actions of the E members, ``[..., E, A]``.

    Returns:
        Doubt, at least 0, ``[..., 1]``.

    Raises:
        ValueError: if there are fewer than two members, who cannot disagree.

    Examples:
        >>> import torch
        >>> ensemble_doubt(torch.tensor([[0.0, 0.0], [2.0, 0.0]]))
        tensor([2.])
    """
    if actions.ndim < 2 or actions.shape[-2] < 2:
        raise ValueError(
            "actions must have the shape [..., E, A] with at least two members E, got "
            f"{tuple(actions.shape)}."
        )
    return actions.var(-2).norm(dim=-1, keepdim=True)


def doubt_threshold(doubts: Tensor, share: float = 0.25) -> float:
    """The doubt from which on mentors took over: the mean of the last quarter at takeovers.

    Kelly et al. (2019) learn the threshold of their risk estimate so, from the doubts in the order
    of the takeovers; the last ones are those of the best trained policy. The threshold says where
    the policy would be trusted. It decides nothing in the training, in which the mentor decides.

    Args:
        doubts: doubt at each takeover, in their order, ``[N]``.
        share: share of them, from the end, that is taken; at least one is.

    Returns:
        The threshold; NaN without a takeover.

    Raises:
        ValueError: if the share is not in (0, 1].

    Examples:
        >>> import torch
        >>> doubt_threshold(torch.tensor([9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 1.0, 3.0]))
        2.0
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"share must lie in (0, 1], got {share}.")
    if not doubts.numel():
        return float("nan")
    return doubts[min(int((1.0 - share) * len(doubts)), len(doubts) - 1) :].mean().item()
