"""A small policy for the one-step problem."""

from __future__ import annotations

import pytest
import torch
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import make_actor


@pytest.fixture
def actor() -> ProbabilisticActor:
    """A policy that sees one number and does one."""
    torch.manual_seed(0)
    return make_actor(1, 1, (8,), initial_std=0.5, minimum_std=0.05)
