"""Soft actor-critic on the environment's reward and cost: SAC-RS and SAC-Lag of the paper.

python recipes/off_policy.py                           # conf/off_policy.yaml, reward shaping
python recipes/off_policy.py algorithm=sac_lag         # a limit on collisions per episode
python recipes/off_policy.py collector=parallel        # several simulator processes
python recipes/off_policy.py resume=runs/sac_rs/<date> # go on with a run
python recipes/off_policy.py -m algorithm=sac_rs,sac_lag seed=0,1,2
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from statistics import mean

import hydra
import torch
from omegaconf import DictConfig

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
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recipe import conclude, leave, run_recipe
from haim_torchrl.evaluation.run import Run
from haim_torchrl.evaluation.schedule import Schedule
from haim_torchrl.evaluation.schema import OffPolicyConfig
from haim_torchrl.evaluation.soft_actor_critic import build_sac, check_off_policy
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.modules import PolicyAverage
from haim_torchrl.objectives import NonFiniteLossError, TargetUpdater, UpdateStep
from haim_torchrl.transforms import ShapedReward


def train(config: DictConfig) -> Path:
    """Train, evaluate on held-out scenarios, and write everything to the run's folder."""
    check_off_policy(config)
    device = prepare(config)
    world = World.of(config, "train", takeovers=False)
    sizes = Sizes.of_world(world)

    # The parts: one actor, its critics and loss, the replay, who collects.
    actor = build_actor(config, sizes, device)
    make_critic = partial(build, config.critic, sizes.observation, sizes.action, device=device)
    loss = build_sac(config.loss, actor, make_critic)
    multiplier = getattr(loss, "multiplier", None)  # price of the cost, where it has a limit
    optimizer = build(config.optimizer, loss)
    update = UpdateStep(
        torch.compile(loss) if config.compile else loss,
        optimizer,
        TargetUpdater(loss, config.loss.tau),
        max_grad_norm=config.train.max_grad_norm,
    )
    average = PolicyAverage(actor, config.train.policy_average)  # drives, while the actor learns
    replay = build(
        config.replay,
        batch_size=config.train.batch_size,
        keys=loss.in_keys,
        intervention_key=None,
        reflection=sizes.reflection,
        device=device,
    )
    collector = build(
        config.collector,
        world,
        average.actor,
        total_frames=config.total_frames,
        seed=config.seed,
        postproc=ShapedReward(config.loss.cost_weight),
    )
    logger = build_logger(config)
    folder = open_folder(config)
    log = TrainingLog(folder, logger, pace=config.collector.get("pace"))
    schedule = Schedule(config.train, config.total_frames)
    run = Run(
        folder,
        config,
        actor=actor,
        average=average,
        collector=collector,
        log=log,
        schedule=schedule,
        loss=loss,
        optimizer=optimizer,
        replay=replay,
    )
    if config.resume:
        run.load(config.resume)

    with (
        shutting_down(collector),
        InterruptFlag() as interrupt,
        ProgressLine(config.total_frames, schedule.frames, label=job_label()) as progress,
    ):
        for batch in run.batches(interrupt):
            replay.extend(batch)
            finished = log.add_batch(batch)
            due = schedule.advance(batch.numel())
            if multiplier is not None and finished and schedule.learning:
                multiplier.update(mean(episode.violations for episode in finished))
            try:
                for _ in range(due):
                    log.add_losses(update(replay.sample()))
                    average.update()
            except NonFiniteLossError as error:
                raise RunFailed(f"{error} The last good checkpoint is {run.last()}.") from error
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
            leave(run, "recipes/off_policy.py")

    conclude(run)
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="off_policy")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    run_recipe(config, train, OffPolicyConfig)


if __name__ == "__main__":
    run_command(main)
