"""Definition 1 of the paper: take over when the agent's action is unlikely for the mentor."""

from __future__ import annotations

import math
from collections.abc import Sequence

from haim_torchrl.switches.protocol import Situation


class ProbabilitySwitch:
    r"""Mentor controls unless its density at the agent's action reaches ``eta`` (eq. 4).

    The agent keeps control while its action lies in the confident set
    :math:`\{a : \pi_{mentor}(a \mid s) \ge \eta\}`. The density is relative to the mentor's own
    action, in ``[0, 1]``, because the scale of a density over continuous actions is arbitrary and
    a threshold on it would mean nothing. A mentor with a distribution is asked for its density
    (:class:`~haim_torchrl.mentors.protocol.DensityMentor`); around the action of any other one a
    Gaussian kernel is laid, :math:`\exp(-\tfrac12 \sum_i ((a_i - m_i) / \sigma_i)^2)`.

    Args:
        eta: least relative density of an acceptable action, in ``(0, 1]``.
        sigma: width of the kernel for each action dimension, in units of the action, or one
            number for all. The default is for ``[acceleration, steering]``: a steering error
            matters earlier than an equal one of the pedals.
        kernel_only: lay the kernel around the mentor's action even if the mentor has a density.

    Raises:
        ValueError: ``eta`` outside ``(0, 1]`` or a ``sigma`` that is not positive.

    Examples:
        >>> import torch
        >>> from haim_torchrl.mentors import FunctionMentor
        >>> from haim_torchrl.switches import ProbabilitySwitch, Situation
        >>> mentor = FunctionMentor(lambda simulator, tensordict: torch.zeros(2))
        >>> switch = ProbabilitySwitch(eta=0.2, sigma=(0.35, 0.25))
        >>> switch(Situation(None, None, torch.tensor([0.35, 0.0]), mentor, False))  # exp(-1/2)
        False
        >>> switch(Situation(None, None, torch.tensor([0.0, 0.5]), mentor, False))  # exp(-2)
        True
    """

    memoryless = True

    def __init__(
        self,
        eta: float = 0.2,
        sigma: float | Sequence[float] = (0.35, 0.25),
        *,
        kernel_only: bool = False,
    ) -> None:
        if not 0.0 < eta <= 1.0:
            raise ValueError(
                f"eta is {eta}: it is a relative density and must lie in (0, 1]; "
                "use Never() or Always() for a switch that does not look at the action."
            )
        self.eta = float(eta)
        self.sigma: float | tuple[float, ...]
        if isinstance(sigma, (int, float)):
            self.sigma = float(sigma)
            widths: tuple[float, ...] = (self.sigma,)
        else:
            self.sigma = widths = tuple(float(width) for width in sigma)
        if not widths or not all(width > 0.0 for width in widths):
            raise ValueError(f"sigma is {sigma}: every kernel width must be positive.")
        self.kernel_only = kernel_only

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """``True`` when the agent's action is too unlikely."""
        return self.density(situation) < self.eta

    def density(self, situation: Situation) -> float:
        """Relative density in ``[0, 1]`` of the agent's action under the mentor."""
        density = getattr(situation.mentor, "density", None)
        if density is not None and not self.kernel_only:
            return density(situation.simulator, situation.tensordict, situation.action_agent)
        agent = situation.action_agent.tolist()
        widths = self.sigma
        if isinstance(widths, float):
            widths = (widths,) * len(agent)
        elif len(widths) != len(agent):
            raise ValueError(
                f"sigma has {len(widths)} widths but the action has {len(agent)} dimensions: "
                "give one width for each dimension, or one number."
            )
        squares = (
            ((a - m) / width) ** 2
            for a, m, width in zip(agent, situation.mentor_action().tolist(), widths)
        )
        return math.exp(-0.5 * sum(squares))
