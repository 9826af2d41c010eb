"""The multiplier of a cost limit: a plain one, and one that is controlled (PID)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class LagrangeMultiplier(nn.Module):
    r"""Price λ of a cost in the policy's objective, moved until the cost meets its limit.

    After episodes of mean cost :math:`J`, which exceeds the limit :math:`d` by
    :math:`\Delta = J - d`:

    .. math:: I \leftarrow [I + K_I \Delta]_+, \quad
              \lambda \leftarrow [P \Delta + I + D\,(J - J_{before})_+]_+

    That is the controlled multiplier of Stooke, Achiam and Abbeel, "Responsive safety in
    reinforcement learning by PID Lagrangian methods" (ICML 2020), algorithm 2. Without gains it is
    the plain one, gradient ascent on λ with a projection to λ ≥ 0: the same formula with
    :math:`P = D = 0` and :math:`K_I` the learning rate. The integral starts at ``initial`` and has
    λ's unit; the first update knows no earlier cost, and has no derivative.

    Everything that changes is a buffer, and nothing else is: ``state_dict`` is what was learned,
    and a multiplier that goes on from it holds the limit that it was made with.

    Args:
        limit: bound d of the mean cost per episode, a sum without discount, ≥ 0. A cost of one
            for each collision makes it collisions per episode.
        initial: λ at the start, ≥ 0.
        lr: step of the plain multiplier, [λ per unit of cost], > 0; not used with gains.
        gains: (P, K_I, D), each ≥ 0 and one of them > 0; None for the plain multiplier.
        smoothing: J is an average in which the earlier ones keep this share at each update, in
            [0, 1). A collision is rare and counts one: P and D, which act on J itself, need it.

    Raises:
        ValueError: if a number is out of range or not finite.

    Examples:
        >>> multiplier = LagrangeMultiplier(limit=1.0, lr=0.5)
        >>> multiplier.update(3.0)
        tensor(1.)
        >>> multiplier.update(0.0)
        tensor(0.5000)
    """

    value: Tensor
    integral: Tensor
    previous_cost: Tensor

    def __init__(
        self,
        limit: float,
        *,
        initial: float = 0.0,
        lr: float = 0.05,
        gains: Sequence[float] | None = None,
        smoothing: float = 0.0,
    ) -> None:
        super().__init__()
        for name, number in (("limit", limit), ("initial", initial)):
            if not 0.0 <= number < math.inf:
                raise ValueError(f"{name} must be a number of at least 0, got {number}.")
        if not 0.0 < lr < math.inf:
            raise ValueError(f"lr must be a positive number, got {lr}.")
        if gains is not None and (
            len(gains) != 3 or not all(0.0 <= gain < math.inf for gain in gains) or not any(gains)
        ):
            raise ValueError(
                "gains must be three numbers (P, I, D) of at least 0, not all of them 0, or None; "
                f"got {tuple(gains)}."
            )
        if not 0.0 <= smoothing < 1.0:
            raise ValueError(f"smoothing must lie in [0, 1), got {smoothing}.")
        self.limit = float(limit)
        self.smoothing = float(smoothing)
        self.gains = (0.0, float(lr), 0.0) if gains is None else tuple(map(float, gains))
        self.register_buffer("value", torch.tensor(float(initial)))
        self.register_buffer("integral", torch.tensor(float(initial)))
        self.register_buffer("previous_cost", torch.tensor(math.inf))  # from there all is a fall

    @torch.no_grad()
    def update(self, mean_episode_cost: Tensor | float) -> Tensor:
        """Moves λ after some episodes.

        Args:
            mean_episode_cost: J, the mean of their costs, each a sum without discount; a scalar.

        Returns:
            λ, a scalar ≥ 0 without gradient (the buffer ``value``, changed in place).

        Raises:
            ValueError: if the cost is not a finite number; nothing has been changed then.
        """
        cost = torch.as_tensor(mean_episode_cost, dtype=torch.float32, device=self.value.device)
        if cost.numel() != 1 or not torch.isfinite(cost).all():
            raise ValueError(f"mean_episode_cost must be a finite number, got {mean_episode_cost}.")
        cost = cost.detach().reshape(())
        if torch.isfinite(self.previous_cost):
            cost = torch.lerp(cost, self.previous_cost, self.smoothing)
        proportional, integral, derivative = self.gains
        excess = cost - self.limit
        rise = (cost - self.previous_cost).clamp_min(0.0)
        self.integral.add_(integral * excess).clamp_min_(0.0)
        self.value.copy_(proportional * excess + self.integral + derivative * rise)
        self.value.clamp_min_(0.0)
        self.previous_cost.copy_(cost)
        return self.value
