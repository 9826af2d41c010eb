"""Lets a resumed run go on with the sequence of episodes it was in."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import Transform

from haim_torchrl.transforms.worker import simulator_of, worker_env


class SimulatorRandomState(Transform):
    """Keeps the random state of a simulator in the ``state_dict`` of its environment.

    TorchRL's collectors save the states of their environments' transforms, so that this one
    carries the simulator's generator (gymnasium's ``np_random``) into a checkpoint. What no
    simulator here can save is the middle of an episode: after loading, the environment must be
    reset (:func:`~haim_torchrl.collectors.resume_collector` does both), which begins the episode
    that would have come next.

    Args:
        with_torch: also keep the process's torch random state. For worker processes, where the
            policy draws from it; the main process's state belongs to the training checkpoint.
    """

    def __init__(self, with_torch: bool = False) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self.with_torch = with_torch

    def get_extra_state(self) -> Tensor:
        """The state as bytes, which every way of saving a state dict can store."""
        state: dict[str, Any] = {}
        generator = self._generator()
        if generator is not None:
            state["simulator"] = generator.bit_generator.state
        if self.with_torch:
            state["torch"] = torch.get_rng_state().tolist()
        text = json.dumps(state, default=lambda array: array.tolist())
        return torch.frombuffer(bytearray(text.encode()), dtype=torch.uint8)

    def set_extra_state(self, state: Tensor) -> None:
        """Continue from a saved state."""
        saved = json.loads(bytes(state.tolist()).decode())
        generator = self._generator()
        if generator is not None and "simulator" in saved:
            generator.bit_generator.state = saved["simulator"]
        if self.with_torch and "torch" in saved:
            torch.set_rng_state(torch.tensor(saved["torch"], dtype=torch.uint8))

    def _generator(self) -> np.random.Generator | None:
        if self.parent is None:
            return None
        return getattr(simulator_of(worker_env(self)), "np_random", None)
