"""Swing up a pendulum without a reward: all that is learned comes from a mentor's takeovers.

Nothing in here has to do with cars. The mentor knows the physics and corrects the agent, which in
the end does without it; the reward only measures that. Options: ``--frames 5000 --seed 0``.
"""

import argparse
import math

import torch
from torchrl.envs import GymEnv, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from haim_torchrl import collectors, data, mentors, modules, switches, transforms
from haim_torchrl import objectives as obj


def swing_up(simulator, tensordict):
    """The mentor: gives the pendulum the energy of standing upright, and catches it there."""
    angle, speed = simulator.state  # [rad] from upright, [rad/s]
    angle = math.remainder(angle, 2.0 * math.pi)
    if abs(angle) < 0.5 and abs(speed) < 3.0:
        torque = -8.0 * angle - 2.0 * speed
    else:
        missing_energy = 15.0 * (1.0 - math.cos(angle)) - speed**2 / 2.0
        torque = 0.4 * missing_energy * speed
    return [max(-2.0, min(2.0, torque))]  # [N m]


def make_env(switch=None):
    """Pendulum in which the mentor takes over where the agent is more than 0.5 N m off."""
    switch = switch or switches.ActionSwitch(threshold=0.5)
    takeover = transforms.InterventionTransform(lambda: mentors.FunctionMentor(swing_up), switch)
    return TransformedEnv(GymEnv("Pendulum-v1"), takeover)


def make_loss(actor):
    """Values without a reward, the preference for the mentor, and the cost of takeovers."""
    q, q_explicit = (modules.make_critic(3, 1, hidden=(128, 128)) for _ in range(2))
    critics = {"proxy": (q, 1.0, "min"), "explicit": (q_explicit, -1.0, "max")}
    terms = {
        "proxy": obj.ProxyQLoss(actor, q, temperature=0.01),
        "preference": obj.ConservativePreferenceLoss(actor, q),
        "explicit": obj.ExplicitInterventionLoss(actor, q_explicit, target_reduction="min"),
        "actor": obj.ActorLoss(actor, critics, temperature=0.01),
    }
    return obj.HAIMLoss(terms).make_value_estimator(gamma=0.99)


def train(frames, seed):
    """Agent and mentor act together; the agent's spread keeps it trying what is corrected then."""
    spec = make_env().action_spec
    actor = modules.make_actor(3, hidden=(128, 128), action_spec=spec, minimum_std=0.3)
    loss = make_loss(actor)
    update = obj.UpdateStep(loss, obj.make_optimizer(loss, lr=1e-3), loss.make_target_updater())
    average = modules.PolicyAverage(actor, decay=0.99)  # steadier than the policy of the moment
    replay = data.make_replay_buffer(50_000, batch_size=256, keys=loss.in_keys)
    for batch in collectors.make_collector(
        make_env, average.actor, frames_per_batch=100, total_frames=frames, seed=seed
    ):
        replay.extend(batch)
        for _ in range(len(batch) // 2):
            update(replay.sample())
            average.update()
        if len(replay) % 1000 == 0:
            print(f"{len(replay):5d} steps, {len(replay.intervened):5d} of them the mentor's")
    return average.actor, replay


def evaluate(switch, policy=None, episodes=20):
    """Mean return of episodes that training has not seen; without a policy actions are random."""
    env = make_env(switch)
    env.set_seed(1_000_000)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollouts = [env.rollout(200, policy) for _ in range(episodes)]
    return torch.stack(rollouts)["next", "reward"].sum(1).mean().item()


def main(arguments=None):
    """Train, then compare. Returns the mean returns by driver, and the replay."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=5000, help="steps of training")
    parser.add_argument("--seed", type=int, default=0, help="of networks, exploration and episodes")
    options = parser.parse_args(arguments)
    torch.manual_seed(options.seed)
    policy, replay = train(options.frames, options.seed)
    returns = {
        "policy alone": evaluate(switches.Never(), policy),
        "mentor": evaluate(switches.Always()),
        "random actions": evaluate(switches.Never()),
    }
    for driver, value in returns.items():
        print(f"{driver:14s}  mean return {value:6.0f}")
    return returns, replay


if __name__ == "__main__":
    torch.set_num_threads(1)  # with networks this small more threads are slower
    main()
