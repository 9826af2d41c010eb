"""What one update of HAIM-DRL costs, against soft actor-critic and against a naive composition.

Run with ``python benchmarks/bench_update.py``. The update is the recipe's, its temperature tuned:
three twin critics, preference, actor, one backward pass, one Adam, all targets. Beside it stand the
update of TorchRL's ``SACLoss``, that of Stable-Baselines3's ``SAC.train``, and three ``SACLoss`` on
one actor, each with a backward pass, an Adam and a ``SoftUpdate`` of its own: what one would write
first for three critics, though it knows no preference. Networks and batches are alike. Nothing
samples a replay: each update gets a batch that was drawn beforehand, that of Stable-Baselines3
from a buffer that hands it out.

All are timed in turn in one process on one thread, in CPU time (on a GPU: in wall time), and the
smallest of several rounds counts, so the printed ratios hold on a busy machine too.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from hydra import compose, initialize_config_dir
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.optim import Adam
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry
from torchrl.modules import MLP
from torchrl.objectives import SACLoss, SoftUpdate

from haim_torchrl.evaluation.assembly import Sizes, build, build_actor
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.modules import make_actor
from haim_torchrl.objectives import UpdateStep

OBSERVATION, ACTION, HIDDEN = 260, 2, (256, 256)
LEARNING_RATE, TAU = 3e-4, 0.005
SB3_GOAL, NAIVE_GOAL = 1.5, 0.6
TOLERANCE = 1e-4
COMPILED = "conservative"
SB3, NAIVE = "SAC, Stable-Baselines3", "naive: three SACLoss"

Update = Callable[[], Any]


def make_batch(size: int, device: torch.device) -> TensorDict:
    """Random transitions; the mentor drove half of them, as in a balanced replay."""
    intervention = torch.arange(size).unsqueeze(-1) % 2 == 0
    agent, mentor = torch.rand(2, size, ACTION) * 2.0 - 1.0
    terminated = torch.rand(size, 1) < 0.02
    following = {
        "observation": torch.rand(size, OBSERVATION),
        "reward": torch.rand(size, 1),
        "takeover_cost": torch.rand(size, 1),
        "disturbance_cost": torch.rand(size, 1),
        "terminated": terminated,
        "done": terminated.clone(),
    }
    data = {
        "observation": torch.rand(size, OBSERVATION),
        "action": torch.where(intervention, mentor, agent),
        "action_agent": agent,
        "action_mentor": mentor * intervention,
        "intervention": intervention,
        "next": following,
    }
    return TensorDict(data, batch_size=[size]).to(device)


def haim_step(preference: str, device: torch.device) -> UpdateStep:
    """The update as ``recipes/haim.py`` puts it together."""
    register()
    folder = Path(__file__).resolve().parent.parent / "conf"
    with initialize_config_dir(str(folder), version_base="1.3"):
        config = compose("haim", [f"loss/preference={preference}", "loss/entropy=auto"])
    actor = build_actor(config, Sizes(OBSERVATION, ACTION), device)
    critic = partial(build, config.critic, OBSERVATION, ACTION, device=device)
    loss = build_loss(config.loss, actor, critic).to(device)
    updater = loss.make_target_updater(config.loss.tau)
    return UpdateStep(loss, build(config.optimizer, loss), updater)


def update_on_copy(step: UpdateStep, batch: TensorDict) -> TensorDictBase:
    """One update with a batch of its own, as a replay hands it out: the loss writes to it."""
    return step(batch.copy())


def sac_updates(count: int, batch: TensorDict) -> Update:
    """TorchRL's update, once for each of several losses on one actor."""
    device = batch.device
    actor = make_actor(OBSERVATION, ACTION, HIDDEN, device=device)
    steps = []
    for _ in range(count):
        network = MLP(OBSERVATION + ACTION, 1, num_cells=HIDDEN, activation_class=nn.ReLU)
        critic = TensorDictModule(
            network.to(device), in_keys=["observation", "action"], out_keys=["state_action_value"]
        )
        loss = SACLoss(actor, critic, num_qvalue_nets=2)
        loss.make_value_estimator(gamma=0.99)
        loss.to(device)
        optimizer = Adam(loss.parameters(), lr=LEARNING_RATE, fused=True)
        steps.append((loss, optimizer, SoftUpdate(loss, tau=TAU)))

    def update() -> None:
        for loss, optimizer, updater in steps:
            losses = loss(batch.copy())
            total = losses["loss_qvalue"] + losses["loss_actor"] + losses["loss_alpha"]
            optimizer.zero_grad()
            total.backward()
            optimizer.step()
            updater.step()

    return update


class Prepared(ReplayBuffer):
    """A buffer of Stable-Baselines3 that hands out one batch, drawn beforehand, again and again."""

    drawn: ReplayBufferSamples

    def sample(self, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        """The batch."""
        return self.drawn


class Spaces(gym.Env):
    """Only the spaces: nothing here steps an environment."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (OBSERVATION,))
    action_space = gym.spaces.Box(-1.0, 1.0, (ACTION,))


def sb3_update(batch: TensorDict) -> Update:
    """One gradient step of Stable-Baselines3's SAC."""
    model = SAC(
        "MlpPolicy",
        Spaces(),
        learning_rate=LEARNING_RATE,
        tau=TAU,
        policy_kwargs={"net_arch": list(HIDDEN)},
        buffer_size=1,
        replay_buffer_class=Prepared,
        device=batch.device,
    )
    model.set_logger(configure(format_strings=[]))
    following = batch["next"]
    assert isinstance(model.replay_buffer, Prepared)
    model.replay_buffer.drawn = ReplayBufferSamples(
        batch["observation"],
        batch["action"],
        following["observation"],
        following["terminated"].float(),
        following["reward"],
    )
    return partial(model.train, gradient_steps=1, batch_size=batch.shape[0])


def compiled_step(preference: str, device: torch.device) -> UpdateStep:
    """The same update with its loss compiled, on a GPU into CUDA graphs.

    It draws the same random numbers as the eager one, so that both can be compared.
    """
    step = haim_step(preference, device)
    options = {"fallback_random": True, "triton.cudagraphs": device.type == "cuda"}
    step.loss.compile(dynamic=False, options=options)
    return step


@torch.no_grad()
def set_tensors(loss: nn.Module, values: Sequence[Tensor]) -> None:
    """Writes parameters, targets and constants in place."""
    for tensor, value in zip((*loss.parameters(), *loss.buffers()), values, strict=True):
        tensor.copy_(value)


def check_equal(eager: UpdateStep, compiled: UpdateStep, batch: TensorDict) -> None:
    """Compares losses and gradients of both, from the same parameters with the same random numbers.

    Several times, because a CUDA graph is recorded in the second call and replayed from the third.
    """
    start = [tensor.clone() for tensor in (*eager.loss.parameters(), *eager.loss.buffers())]
    for seed in range(4):
        results: list[dict[str, Tensor]] = []
        for step in (eager, compiled):
            set_tensors(step.loss, start)
            torch.manual_seed(seed)
            found = dict(update_on_copy(step, batch).items())
            found |= {n: p.grad for n, p in step.loss.named_parameters() if p.grad is not None}
            results.append({name: tensor.clone() for name, tensor in found.items()})
        for name, value in results[0].items():
            error = (value - results[1][name]).norm() / value.norm().clamp_min(1e-3)
            if not error <= TOLERANCE:
                raise SystemExit(f"{name}: compiled and eager update differ by {error:.1e}")


def seconds(update: Update, repeats: int, device: torch.device) -> float:
    """Seconds of one update: CPU time, on a GPU wall time."""
    cuda = device.type == "cuda"
    clock = time.perf_counter if cuda else time.process_time
    if cuda:
        torch.cuda.synchronize()
    start = clock()
    for _ in range(repeats):
        update()
    if cuda:
        torch.cuda.synchronize()
    return (clock() - start) / repeats


class Products(TorchDispatchMode):
    """Counts the floating-point operations of all matrix products."""

    operations = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        """Runs the function and adds what it counts."""
        result = function(*args, **(kwargs or {}))
        count = flop_registry.get(function._overloadpacket)
        if count is not None:
            self.operations += count(*args, **(kwargs or {}), out_val=result)
        return result


def gflop(update: Update) -> float:
    """Operations of an update's matrix products, in thousand millions."""
    with Products() as products:
        update()
    return products.operations / 1e9


def compare(size: int, device: torch.device, options: argparse.Namespace) -> None:
    """Times all updates at one batch size, and prints them and whether the goals are met."""
    torch.manual_seed(0)
    batch = make_batch(size, device)
    steps = {name: haim_step(name, device) for name in ("conservative", "bounded")}
    updates: dict[str, Update] = {
        f"HAIM, {name} preference": partial(update_on_copy, step, batch)
        for name, step in steps.items()
    }
    goals = list(updates)
    updates["SAC, TorchRL's SACLoss"] = sac_updates(1, batch)
    updates[SB3] = sb3_update(batch)
    updates[NAIVE] = sac_updates(3, batch)
    work = {name: f"{gflop(update):.2f}" for name, update in updates.items()}
    if options.compile or device.type == "cuda":
        compiled = compiled_step(COMPILED, device)
        check_equal(steps[COMPILED], compiled, batch)
        how = "CUDA graphs" if device.type == "cuda" else "compiled"
        updates[f"HAIM, {COMPILED}, {how}"] = partial(update_on_copy, compiled, batch)

    for update in updates.values():
        seconds(update, 3, device)  # warm-up
    times: dict[str, list[float]] = {name: [] for name in updates}
    repeats = max(1, options.repeats * 128 // size)
    for _ in range(options.rounds):
        for name, update in updates.items():
            times[name].append(seconds(update, repeats, device))
    best = {name: min(values) for name, values in times.items()}
    print(f"\nbatch of {size}, {device.type}")
    print(f"{'':34}{'GFLOP':>6}{'ms, least':>11}{'median':>8}{'of SB3':>8}{'of naive':>10}")
    for name, values in times.items():
        shares = f"{best[name] / best[SB3]:8.2f}{best[name] / best[NAIVE]:10.2f}"
        spent = f"{best[name] * 1e3:11.2f}{np.median(values) * 1e3:8.2f}"
        print(f"{name:34}{work.get(name, ''):>6}{spent}{shares}")
    for base, goal in ((SB3, SB3_GOAL), (NAIVE, NAIVE_GOAL)):
        ratio = max(best[name] for name in goals) / best[base]
        verdict = "met" if ratio <= goal else f"MISSED ({ratio:.2f})"
        print(f"goal: at most {goal} of {base}: {verdict}")


def main() -> None:
    """Time the updates and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, nargs="+", default=[128, 1024], help="batch sizes")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--repeats", type=int, default=8, help="updates of 128 in one round")
    parser.add_argument("--compile", action="store_true", help="also compiled: minutes of warm-up")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{OBSERVATION} observations, {ACTION} actions; hidden layers {HIDDEN}; no replay")
    devices = [torch.device("cpu")]
    if torch.cuda.is_available():
        devices.append(torch.device("cuda"))
    for device in devices:
        for size in options.batch:
            compare(size, device, options)
    if len(devices) == 1:
        print("\nno CUDA device: updates on a GPU and CUDA graphs are left out")


if __name__ == "__main__":
    main()
