"""What the mentor's two error rates promise about failures in training (the paper's Theorem 1)."""

from __future__ import annotations

import math
from numbers import Real
from typing import overload

import torch
from torch import Tensor


@overload
def failure_bound(
    epsilon: float, kappa: float, tolerance: float, gamma: float, *, literal: bool = False
) -> float: ...


@overload
def failure_bound(
    epsilon: float | Tensor,
    kappa: float | Tensor,
    tolerance: float | Tensor,
    gamma: float | Tensor,
    *,
    literal: bool = False,
) -> float | Tensor: ...


def failure_bound(
    epsilon: float | Tensor,
    kappa: float | Tensor,
    tolerance: float | Tensor,
    gamma: float | Tensor,
    *,
    literal: bool = False,
) -> float | Tensor:
    r"""Most failures, discounted, that training with a mentor may cost (Theorem 1, decision 20).

    .. math:: V_{mix}(s) \le \frac{1}{1-\gamma}
        \left[\epsilon + \kappa + \frac{\gamma\,\epsilon}{1-\gamma}\,K'\right]

    from any state :math:`s`, for any agent. :math:`V_{mix}(s) = E \sum_t \gamma^t C(s_t, a_t)` is
    the discounted expected number of failures. It is not multiplied by :math:`1-\gamma`, so it
    lies in :math:`[0, 1/(1-\gamma)]` and a larger bound says nothing; where a failure ends the
    episode V is at most 1. :math:`C(s, a)` is 1 if the action leads to an unsafe state, or the
    probability of that. At each step the agent proposes a, the mentor takes over with probability
    :math:`I(s, a)`, and if so its own action, a fresh draw from its policy, is executed for this
    one step; then the switch decides anew. All rates are those of the worst state, not averages.

    The proof sums :math:`C` over the tolerated actions without the agent's probabilities, since
    :math:`\pi(a \mid s) \le 1`. That is right for a finite set of actions. A density can exceed 1,
    and then neither form need hold: for densities of at most m, m >= 1, pass :math:`m \kappa` and
    :math:`m K'`.

    The factor :math:`\epsilon^2` of the printed theorem does not follow from the proof's last line
    but one, which has :math:`\epsilon`. It is no false bound, though. A step fails only by a
    tolerated action, with at most :math:`\kappa`, or by the mentor, with at most :math:`\epsilon`
    times the probability of a takeover. Hence :math:`V_{mix} \le (\epsilon + \kappa - \epsilon
    \kappa) / (1-\gamma)`, which is attained, and ``tolerance=0`` gives a valid bound whatever the
    mentor tolerates.

    Args:
        epsilon: Probability that an action of the mentor is unsafe, per step, in [0, 1]
            (assumption 1).
        kappa: Unsafe actions that the mentor lets pass, :math:`\max_s \sum_a (1 - I) C`, in [0, 1]
            (assumption 2); in units of the action's volume for continuous actions.
        tolerance: :math:`K' = \max_s \sum_a (1 - I)`, not negative: for a finite set the number of
            tolerated actions, for continuous ones their volume, in units of the action. Since
            probabilities sum to 1, the smaller of this and 1 also holds for a finite set.
        gamma: Discount factor per step, in [0, 1).
        literal: The theorem as printed, with :math:`\epsilon^2` in place of :math:`\epsilon` in
            the last term.

    Returns:
        The bound, in failures. A float for numbers; a tensor of the broadcast shape as soon as one
        argument is a tensor, and then differentiable.

    Raises:
        TypeError: An argument is neither a number nor a tensor.
        ValueError: A value out of its range, or shapes that do not broadcast.

    Examples:
        >>> round(failure_bound(epsilon=0.01, kappa=0.02, tolerance=1, gamma=0.9), 3)
        1.2
        >>> round(failure_bound(epsilon=0.01, kappa=0.02, tolerance=1, gamma=0.9, literal=True), 3)
        0.309
        >>> round(failure_bound(epsilon=0.01, kappa=0.02, tolerance=0, gamma=0.9), 3)
        0.3
        >>> failure_bound(torch.tensor([0.0, 0.5]), 0.0, 0.0, 0.5)
        tensor([0., 1.])
    """
    _check("epsilon", epsilon, 1.0, "a probability and must lie in [0, 1]")
    _check("kappa", kappa, 1.0, "the rate of unsafe actions let pass and must lie in [0, 1]")
    _check("tolerance", tolerance, math.inf, "an amount of actions and must be finite, 0 or more")
    _check("gamma", gamma, 1.0, "a discount factor and must lie in [0, 1)", open_end=True)
    shapes = [x.shape for x in (epsilon, kappa, tolerance, gamma) if isinstance(x, Tensor)]
    try:
        torch.broadcast_shapes(*shapes)
    except RuntimeError:
        sizes = ", ".join(str(tuple(shape)) for shape in shapes)
        raise ValueError(f"the tensors' shapes {sizes} do not broadcast to one.") from None
    horizon = 1.0 / (1.0 - gamma)
    repeated = epsilon * epsilon if literal else epsilon
    bound = horizon * (epsilon + kappa + gamma * horizon * repeated * tolerance)
    return bound if shapes else float(bound)


def _check(
    name: str, value: float | Tensor, upper: float, rule: str, *, open_end: bool = False
) -> None:
    """Refuse what is no number or lies out of ``[0, upper]`` (NaN and infinity as well)."""
    if not isinstance(value, (Real, Tensor)):
        raise TypeError(f"{name} is a {type(value).__name__}: give a number or a tensor.")
    numbers = torch.tensor(float(value), dtype=torch.float64) if isinstance(value, Real) else value
    numbers = numbers.detach()
    below = numbers < upper if open_end else numbers <= upper
    wrong = ~((numbers >= 0) & below & torch.isfinite(numbers))
    if wrong.any():
        worst = value if isinstance(value, Real) else numbers[wrong][0].item()
        raise ValueError(f"{name} is {worst}: it is {rule}.")
