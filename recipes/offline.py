"""Learn from demonstrations alone: behaviour cloning (BC) and conservative Q-learning (CQL).

python recipes/offline.py                              # BC of 4 000 steps that the mentor drives
python recipes/offline.py demonstrations=platoon/expert-v0      # of recipes/demonstrate.py
python recipes/offline.py algorithm=cql demonstrations=platoon/expert-v0
python recipes/offline.py like=runs/haim/<date>        # as many mentor steps as that run had
python recipes/offline.py resume=runs/bc/<date>        # go on with a run
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import hydra
from omegaconf import DictConfig
from torch.optim import Adam

from haim_torchrl.data.batches import DatasetBatches
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
from haim_torchrl.evaluation.offline import build_objective, check_offline, offline_data
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recipe import conclude, leave, run_recipe
from haim_torchrl.evaluation.run import Run
from haim_torchrl.evaluation.schedule import UpdateSchedule
from haim_torchrl.evaluation.schema import OfflineRunConfig
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.modules import PolicyAverage
from haim_torchrl.objectives import NonFiniteLossError, UpdateStep


def train(config: DictConfig) -> Path:
    """Learn, evaluate on held-out scenarios, and write everything to the run's folder."""
    device = prepare(config)
    check_offline(config)
    settings = config.offline
    world = World.of(config, "train", takeovers=False)
    sizes = Sizes.of_world(world)

    # The parts: one actor, the loss with its critics if it has any, the data.
    actor = build_actor(config, sizes, device)
    make_critic = partial(
        build, config.critic, sizes.observation, sizes.action, ensemble_size=1, device=device
    )
    loss, targets = build_objective(config, actor, make_critic)
    optimizer = Adam(loss.parameters(), lr=settings.lr, fused=True)
    update = UpdateStep(loss, optimizer, targets, max_grad_norm=settings.max_grad_norm)
    average = PolicyAverage(actor, settings.policy_average)
    data = offline_data(config, world, actor, imitates=targets is None)
    replay = build(
        config.replay,
        capacity=len(data),
        batch_size=settings.batch_size,
        keys=loss.in_keys,
        reflection=sizes.reflection,
        device=device,
    )
    replay.extend(data)
    folder = open_folder(config)
    log = TrainingLog(folder, build_logger(config))
    log.add_demonstrations(data)
    schedule = UpdateSchedule(settings)
    batches = DatasetBatches(replay, settings.updates)
    run = Run(
        folder, config, actor=actor, average=average, collector=batches, log=log,
        schedule=schedule, loss=loss, optimizer=optimizer,
    )  # fmt: skip
    if config.resume:
        run.load(config.resume)

    with (
        InterruptFlag() as interrupt,
        ProgressLine(
            settings.updates, schedule.frames, unit="updates", label=job_label()
        ) as progress,
    ):
        for batch in run.batches(interrupt):
            loss.cloning = schedule.frames < settings.bc_updates  # CQL's policy; BC's always does
            try:
                log.add_losses(update(batch))
            except NonFiniteLossError as error:
                raise RunFailed(f"{error} The last good checkpoint is {run.last()}.") from error
            average.update()
            schedule.advance(1)
            progress.update(schedule.frames)
            if schedule.due("log"):
                log.write_row()
            if schedule.due("validate"):
                success = run.validate().overall["success"].value
                progress.note(f"{schedule.frames} updates: success {success:.2f} on validation")
            if schedule.due("checkpoint"):
                run.save()
        if interrupt and not schedule.finished:
            leave(run, "recipes/offline.py")

    conclude(run)
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="offline")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    run_recipe(config, train, OfflineRunConfig)


if __name__ == "__main__":
    run_command(main)
