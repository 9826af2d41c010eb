"""What an update of conservative Q-learning costs, in updates of soft actor-critic.

Run with ``python benchmarks/bench_offline.py``. Beside TorchRL's ``SACLoss`` and ``CQLLoss`` stands
this package's ``ConservativeQLoss`` with several numbers of drawn actions. Networks, batches and
optimisers are alike. All are timed in turn in one process on one thread, in CPU time, and the
smallest of several rounds counts, so that the printed ratios hold on a busy machine too.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch.optim import Adam
from torchrl.objectives import CQLLoss, LossModule, SACLoss

from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import ConservativeQLoss, TargetUpdater, UpdateStep

OBSERVATION, ACTION = 110, 2


def make_batch(size: int) -> TensorDict:
    """Random transitions ``[size]``."""
    terminated = torch.rand(size, 1) < 0.02
    following = {
        "observation": torch.rand(size, OBSERVATION),
        "reward": torch.rand(size, 1),
        "terminated": terminated,
        "done": terminated.clone(),
    }
    action = torch.rand(size, ACTION) * 1.9 - 0.95
    data = {"observation": torch.rand(size, OBSERVATION), "action": action, "next": following}
    return TensorDict(data, batch_size=[size])


def make_update(kind: Callable[..., LossModule], **options: object) -> UpdateStep:
    """An update with a loss of this kind, on fresh networks."""
    critic = make_critic(OBSERVATION, ACTION, ensemble_size=1)
    loss = kind(make_actor(OBSERVATION, ACTION), critic, **options)
    loss.make_value_estimator(gamma=0.99)
    return UpdateStep(loss, Adam(loss.parameters(), lr=3e-4, fused=True), TargetUpdater(loss))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch-size", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=10)
    given = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    warnings.simplefilter("ignore", UserWarning)
    updates = {
        "SAC, TorchRL": make_update(SACLoss),
        "CQL, TorchRL, 10 draws": make_update(CQLLoss),
        "CQL, TorchRL, 4 draws": make_update(CQLLoss, num_random=4),
        **{
            f"CQL, here, {draws} draws": make_update(ConservativeQLoss, num_random=draws)
            for draws in (10, 4, 1)
        },
    }
    best = dict.fromkeys(updates, float("inf"))
    for _ in range(given.rounds + 1):  # the first warms up
        for name, update in updates.items():
            batch = make_batch(given.batch_size)
            start = time.process_time()
            update(batch)
            best[name] = min(best[name], time.process_time() - start)
    reference = best["SAC, TorchRL"]
    for name, seconds in best.items():
        print(f"{name:<26}{1e3 * seconds:7.1f} ms {seconds / reference:6.1f} updates of SAC")


if __name__ == "__main__":
    main()
