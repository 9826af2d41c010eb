r"""Steps in a trust region: the best one under a linear constraint, and a search along it.

The region is :math:`\frac12 x^T H x \le \delta`, H the Fisher matrix of the policy, which is known
by its products with vectors only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import torch
from torch import Tensor, nn

Product = Callable[[Tensor], Tensor]
"""Product of a symmetric positive definite matrix with a vector ``[P]``."""

#: Share of a squared length below which a vector counts as zero.
NEGLIGIBLE = 1e-8


def conjugate_gradient(
    product: Product, right: Tensor, *, iterations: int = 10, tolerance: float = 1e-10
) -> Tensor:
    """Solves H x = b by products with H alone.

    Hestenes and Stiefel (1952).

    Args:
        product: of H with a vector.
        right: b, ``[P]``.
        iterations: most products to form; P of them solve it exactly but for rounding.
        tolerance: squared length of the residual, relative to that of b, that is good enough.

    Returns:
        x, ``[P]``.

    Examples:
        >>> matrix = torch.tensor([[2.0, 0.0], [0.0, 4.0]])
        >>> conjugate_gradient(lambda vector: matrix @ vector, torch.tensor([2.0, 2.0]))
        tensor([1.0000, 0.5000])
    """
    solution = torch.zeros_like(right)
    residual, direction = right.clone(), right.clone()
    squared = residual @ residual
    enough = tolerance * squared
    for _ in range(iterations):
        if squared <= enough:
            break
        image = product(direction)
        length = squared / (direction @ image)
        solution += length * direction
        residual -= length * image
        before, squared = squared, residual @ residual
        direction = residual + squared / before * direction
    return solution


class Step(NamedTuple):
    """A step in a trust region.

    Attributes:
        vector: change of the parameters, ``[P]``.
        price: multiplier ν of the constraint; 0 where it does not bind.
        recovery: whether nothing in the region is feasible, and the step only lowers the cost.
    """

    vector: Tensor
    price: Tensor
    recovery: bool


def constrained_step(
    gradient: Tensor,
    cost_gradient: Tensor,
    excess: Tensor,
    solve: Callable[[Tensor], Tensor],
    radius: float,
) -> Step:
    r"""Best step in a trust region under one linear constraint.

    .. math:: \max_x g^T x \quad \text{with} \quad c + b^T x \le 0, \quad
              \tfrac12 x^T H x \le \delta

    The three cases of Achiam et al., "Constrained Policy Optimization" (ICML 2017, section 6.1 and
    appendix), in closed form. If the best step without the constraint (that of TRPO) is feasible
    it is the best. Else, if the constraint's edge passes through the region, the best step lies on
    both edges: :math:`-\frac{c}{s} H^{-1} b + \sqrt{(2\delta - c^2 / s) / A}\, H^{-1} g_\perp` with
    :math:`s = b^T H^{-1} b`, :math:`g_\perp = g - \frac{r}{s} b`, :math:`r = g^T H^{-1} b` and
    :math:`A = g_\perp^T H^{-1} g_\perp`; that is the solution of their dual. Else no step is
    feasible, and the cost is lowered as far as the region reaches:
    :math:`-\sqrt{2\delta / s}\, H^{-1} b`.

    Args:
        gradient: g of the objective, ``[P]``.
        cost_gradient: b of the cost, ``[P]``.
        excess: c, cost above its limit, a scalar.
        solve: H⁻¹ times a vector.
        radius: δ, positive.

    Returns:
        The step.
    """
    natural = solve(gradient)
    q = (gradient @ natural).clamp_min(0.0)
    free = (2.0 * radius / q.clamp_min(torch.finfo(q.dtype).tiny)).sqrt() * natural
    price = torch.zeros_like(q)
    natural_cost = solve(cost_gradient)
    s = cost_gradient @ natural_cost
    # A cost that no step changes cannot be met; a feasible best step needs no price.
    if s <= torch.finfo(s.dtype).tiny or excess + cost_gradient @ free <= 0.0:
        return Step(free, price, recovery=False)
    room = 2.0 * radius - excess.square() / s
    if room < 0.0:
        if excess < 0.0:  # all of the region is feasible; s of an inexact solve said otherwise
            return Step(free, price, recovery=False)
        return Step(-(2.0 * radius / s).sqrt() * natural_cost, price, recovery=True)
    r = gradient @ natural_cost
    across = q - r.square() / s
    vector = -(excess / s) * natural_cost
    if across > NEGLIGIBLE * q:
        pace = (room / across).sqrt()
        vector = vector + pace * (natural - (r / s) * natural_cost)
        price = ((excess / pace + r) / s).clamp_min(0.0)
    return Step(vector, price, recovery=False)


def backtrack(
    vector: Tensor, accept: Callable[[Tensor], bool], *, shrink: float = 0.8, tries: int = 10
) -> tuple[Tensor, float]:
    """The longest of ever shorter steps that is accepted.

    Args:
        vector: the full step, ``[P]``.
        accept: whether a step will do.
        shrink: factor from one to the next, in (0, 1).
        tries: most steps to try.

    Returns:
        The step, and its share of the full one; zeros and 0 if none will do.
    """
    share = 1.0
    for _ in range(tries):
        if accept(share * vector):
            return share * vector, share
        share *= shrink
    return torch.zeros_like(vector), 0.0


def flat(tensors: Iterable[Tensor]) -> Tensor:
    """All numbers of some tensors in one vector ``[P]``."""
    return torch.cat([tensor.reshape(-1) for tensor in tensors])


@torch.no_grad()
def assign(parameters: Iterable[nn.Parameter], vector: Tensor) -> None:
    """Writes the numbers of a vector into parameters, in place, in the order of :func:`flat`.

    Args:
        parameters: P numbers in all.
        vector: ``[P]``.
    """
    start = 0
    for parameter in parameters:
        parameter.copy_(vector[start : start + parameter.numel()].view_as(parameter))
        start += parameter.numel()
