"""What the mentor's action is preferred by (eq 16), and its bounded form."""

from __future__ import annotations

from torch import Tensor

from haim_torchrl.objectives.functional.shapes import check_scalar


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
    check_scalar("intervention", intervention)
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
    check_scalar("intervention", intervention)
    squares = (values_mentor - bound).square() + (values_agent + bound).square()
    return 0.5 * squares.sum(-1, keepdim=True).masked_fill(~intervention, 0.0)
