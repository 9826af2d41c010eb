"""Random draws of mentors and switches, apart from those of exploration and learning."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import torch

from haim_torchrl.data.session import encode


class EpisodeStream:
    """A random generator of its own that begins anew with each episode.

    Each episode's draws follow from ``seed`` and from the state of the simulator's generator
    (gymnasium's ``np_random``) when the episode first asks for a draw. That state is seeded by the
    run, differs between workers, and is kept by checkpoints
    (:class:`~haim_torchrl.transforms.SimulatorRandomState`): a seeded run repeats its draws, and a
    resumed run draws what the uninterrupted one would have drawn. No draw is taken from the
    simulator, or from torch's global generator.

    Where an episode finds the simulator's generator as the episode before did, or there is none,
    the number of such episodes in a row is counted and makes the difference.

    Args:
        seed: any non-negative whole number.
        purpose: what the draws are for, in a word; streams for different purposes differ though
            their seeds are the same.

    Raises:
        ValueError: if the seed is negative.

    Examples:
        >>> stream, other = EpisodeStream(0), EpisodeStream(0)
        >>> first = torch.rand(2, generator=stream.generator(None))
        >>> bool((torch.rand(2, generator=other.generator(None)) == first).all())
        True
        >>> stream.reset()
        >>> bool((torch.rand(2, generator=stream.generator(None)) == first).all())
        False
    """

    def __init__(self, seed: int = 0, purpose: str = "") -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}: it must not be negative.")
        self.seed = int(seed)
        self._purpose = _number(purpose)
        self._generator = torch.Generator()
        self._begins = True
        self._seen: int | None = None  # digest of the simulator's generator, one episode ago
        self._repeats = 0

    def reset(self) -> None:
        """Begin a new episode with the next draw."""
        self._begins = True

    def generator(self, simulator: Any) -> torch.Generator:
        """The generator of the present episode, on the CPU.

        Args:
            simulator: the unwrapped simulator; its generator is looked at, not drawn from.
        """
        if self._begins:
            seen = _digest(simulator)
            self._repeats = self._repeats + 1 if seen == self._seen else 0
            self._seen, self._begins = seen, False
            sequence = np.random.SeedSequence([self.seed, self._purpose, seen, self._repeats])
            self._generator.manual_seed(int(sequence.generate_state(1, np.uint64)[0]))
        return self._generator

    def get_state(self) -> dict[str, Any]:
        """What tells episodes with the same simulator's generator apart."""
        return {"seen": self._seen, "repeats": self._repeats}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from there with a new episode."""
        self._seen, self._repeats = state["seen"], int(state["repeats"])
        self._begins = True


def _digest(simulator: Any) -> int:
    generator = getattr(simulator, "np_random", None)
    if not isinstance(generator, np.random.Generator):
        return 0
    return _number(encode(dict(generator.bit_generator.state)))


def _number(text: str) -> int:
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=7).digest(), "big")
