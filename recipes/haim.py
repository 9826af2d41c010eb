"""HAIM-DRL, the paper's Algorithm 2: learn to drive from a mentor's takeovers, without a reward.

python recipes/haim.py                                 # conf/haim.yaml, preset=default
python recipes/haim.py seed=1 loss/implicit=none       # override anything
python recipes/haim.py resume=runs/haim/<date>         # go on with a run
python recipes/haim.py --config-name ablation          # the paper's ablations, side by side
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig

from haim_torchrl.collectors import shutting_down
from haim_torchrl.evaluation.aftermath import say_how_it_was, show_alone
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
from haim_torchrl.evaluation.drivers import PolicyDriver
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recipe import conclude, leave, run_recipe
from haim_torchrl.evaluation.run import Run
from haim_torchrl.evaluation.schedule import Schedule
from haim_torchrl.evaluation.schema import RunConfig
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.modules import PolicyAverage
from haim_torchrl.objectives import NonFiniteLossError, UpdateStep


def train(config: DictConfig) -> Path:
    """Train, evaluate on held-out scenarios, and write everything to the run's folder."""
    device = prepare(config)
    world = World.of(config, "train", takeovers=True).recorded(config)
    sizes = Sizes.of_world(world)

    # The parts: one actor, its critics and losses, the replay, who collects.
    actor = build_actor(config, sizes, device)
    make_critic = partial(build, config.critic, sizes.observation, sizes.action, device=device)
    loss = build_loss(config.loss, actor, make_critic, sizes.entries)
    optimizer = build(config.optimizer, loss)
    update = UpdateStep(
        torch.compile(loss) if config.compile else loss,
        optimizer,
        loss.make_target_updater(config.loss.tau),
        max_grad_norm=config.train.max_grad_norm,
    )
    average = PolicyAverage(actor, config.train.policy_average)  # drives, while the actor learns
    batch_size = config.train.batch_size
    replay = build(
        config.replay,
        batch_size=batch_size,
        keys=loss.in_keys,
        reflection=sizes.reflection,
        device=device,
    )
    collector = build(
        config.collector,
        world,
        average.actor,
        total_frames=config.total_frames,
        seed=config.seed,
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
        # Algorithm 2. The agent proposes, the switch decides, the mentor may act: inside the
        # environment, so that each batch says who drove each step and what it cost.
        for batch in run.batches(interrupt):
            replay.extend(batch)
            log.add_batch(batch)
            try:
                for _ in range(schedule.advance(batch.numel())):
                    log.add_losses(update(replay.sample()))
                    average.update()
            except NonFiniteLossError as error:
                raise RunFailed(f"{error} The last good checkpoint is {run.last()}.") from error
            collector.update_policy_weights_()
            run.check_takeovers()

            progress.update(
                schedule.frames,
                takeover_rate=log.takeover_rate,
                success=log.success,
                violations=log.totals["violations"],
            )
            if schedule.due("log"):
                log.write_row()
            if schedule.due("validate"):
                success = run.validate().overall["success"].value
                progress.note(f"{schedule.frames} steps: success {success:.2f} on validation")
            if schedule.due("checkpoint"):
                run.save()
        if interrupt:
            leave(run, "recipes/haim.py")

    conclude(run)
    say_how_it_was(config, folder, replay, actor)
    show_alone(config, PolicyDriver(actor))
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="haim")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    run_recipe(config, train, RunConfig)


if __name__ == "__main__":
    run_command(main)
