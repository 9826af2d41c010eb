"""Baselines that learn from what they have just driven: PPO, PPO-Lagrangian, CPO and GAIL.

python recipes/on_policy.py                                # PPO with reward shaping
python recipes/on_policy.py algorithm=cpo cost_limit=0.05  # ppo_rs, ppo_lag, cpo or gail
python recipes/on_policy.py algorithm=gail demonstrations=platoon/expert-v0
python recipes/on_policy.py collector=parallel             # several simulators at once
python recipes/on_policy.py resume=runs/ppo_rs/<date>      # go on with a run
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig
from torch.nn import Identity

from haim_torchrl.collectors import shutting_down
from haim_torchrl.evaluation.assembly import (
    Sizes,
    World,
    build,
    build_actor,
    build_logger,
    prepare,
)
from haim_torchrl.evaluation.command import (
    InterruptFlag,
    RunFailed,
    job_label,
    open_folder,
    register,
    run_command,
)
from haim_torchrl.evaluation.demonstrations import load_mentor_steps
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recipe import conclude, leave, run_recipe
from haim_torchrl.evaluation.run import Run
from haim_torchrl.evaluation.schedule import Schedule
from haim_torchrl.evaluation.schema import OnPolicyRunConfig
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.modules import PolicyAverage
from haim_torchrl.objectives import NonFiniteLossError


def train(config: DictConfig) -> Path:
    """Train, evaluate on held-out scenarios, and write everything to the run's folder."""
    device = prepare(config)
    world = World.of(config, "train", takeovers=False)
    sizes = Sizes.of_world(world)

    # The parts: one actor, who learns it and by what, who collects.
    actor = build_actor(config, sizes, device)
    make_value = partial(build, config.value, sizes.observation, device=device)
    imitation: dict[str, Any] = {}
    if config.demonstrations is not None:
        imitation = {
            "demonstrations": load_mentor_steps(config.demonstrations, world, config),
            "make_discriminator": partial(
                build, config.discriminator, sizes.observation, sizes.action, device=device
            ),
        }
    learner = build(config.algorithm, actor, make_value, **imitation)
    policy = PolicyAverage(actor, 0.0)  # no average: what drives is what learns
    collector = build(
        config.collector,
        world,
        policy.actor,
        total_frames=config.total_frames,
        seed=config.seed,
        postproc=Identity(),  # nobody takes over: transitions are as the world makes them
    )
    logger = build_logger(config)
    folder = open_folder(config)
    log = TrainingLog(folder, logger, pace=config.collector.get("pace"))
    schedule = Schedule(config.train, config.total_frames)
    run = Run(
        folder,
        config,
        actor=actor,
        average=policy,
        collector=collector,
        log=log,
        schedule=schedule,
        learner=learner,
    )
    if config.resume:
        run.load(config.resume)

    with (
        shutting_down(collector),
        InterruptFlag() as interrupt,
        ProgressLine(config.total_frames, schedule.frames, label=job_label()) as progress,
    ):
        for batch in run.batches(interrupt):
            log.add_batch(batch)
            schedule.advance(batch.numel())
            try:
                for losses in learner.learn(batch):
                    log.add_losses(losses)
            except NonFiniteLossError as error:
                raise RunFailed(f"{error} The last good checkpoint is {run.last()}.") from error
            policy.update()
            collector.update_policy_weights_()

            progress.update(
                schedule.frames, success=log.success, violations=log.totals["violations"]
            )
            if schedule.due("log"):
                log.write_row()
            if schedule.due("validate"):
                success = run.validate().overall["success"].value
                progress.note(f"{schedule.frames} steps: success {success:.2f} on validation")
            if schedule.due("checkpoint"):
                run.save()
        if interrupt:
            leave(run, "recipes/on_policy.py")

    demonstrated = imitation.get("demonstrations", ())
    conclude(run, {"demonstrations": len(demonstrated)} if len(demonstrated) else None)
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="on_policy")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    run_recipe(config, train, OnPolicyRunConfig)


if __name__ == "__main__":
    run_command(main)
