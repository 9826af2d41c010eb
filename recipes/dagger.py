"""Dataset aggregation with a mentor who takes over: HG-DAgger and intervention weighted regression.

python recipes/dagger.py                               # HG-DAgger: conf/algorithm/hg_dagger.yaml
python recipes/dagger.py algorithm=iwr                 # IWR
python recipes/dagger.py demonstrations=platoon/expert-v0    # begin with a dataset's
python recipes/dagger.py resume=runs/iwr/<date>        # go on with a run
"""

from __future__ import annotations

from pathlib import Path

import hydra
from omegaconf import DictConfig
from torch.optim import Adam
from torchrl.envs.utils import ExplorationType

from haim_torchrl.collectors import shutting_down
from haim_torchrl.data import Aggregate
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
from haim_torchrl.evaluation.offline import build_objective
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recipe import conclude, leave, run_recipe
from haim_torchrl.evaluation.rounds import Rounds, check_rounds
from haim_torchrl.evaluation.run import Run
from haim_torchrl.evaluation.schema import DaggerRunConfig
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.evaluation.warm_up import warm_up
from haim_torchrl.modules import PolicyAverage, doubt_threshold
from haim_torchrl.objectives import NonFiniteLossError, UpdateStep


def train(config: DictConfig) -> Path:
    """Train, evaluate on held-out scenarios, and write everything to the run's folder."""
    device = prepare(config)
    check_rounds(config)
    world = World.of(config, "train", takeovers=True).recorded(config)
    sizes = Sizes.of_world(world)

    # The parts: one actor (or an ensemble), the loss that clones, the data, who collects.
    actor = build_actor(config, sizes, device)
    loss, _ = build_objective(config, actor)
    optimizer = Adam(loss.parameters(), lr=config.dagger.lr, fused=True)
    update = UpdateStep(loss, optimizer)
    policy = PolicyAverage(actor, 0.0)  # drives: the actor as it was after the last round
    replay = build(
        config.replay,
        batch_size=config.dagger.batch_size,
        keys=loss.in_keys,
        reflection=sizes.reflection,
        device=device,
    )
    data = Aggregate(replay, config.dagger.keep)
    shown = None if config.resume else warm_up(config, config.dagger.warm_up, actor.in_keys)
    folder = open_folder(config)
    log = TrainingLog(folder, build_logger(config), pace=config.collector.get("pace"))
    rounds = Rounds(config.dagger, config.total_frames)
    if shown is not None:
        data.add_demonstrations(shown)
        log.add_demonstrations(shown)
        rounds.advance(len(shown))
    collector = build(
        config.collector,
        world,
        policy.actor,
        total_frames=rounds.driven,
        seed=config.seed,
        exploration_type=ExplorationType.DETERMINISTIC,
    )
    run = Run(
        folder, config, actor=actor, average=policy, collector=collector, log=log,
        schedule=rounds, loss=loss, optimizer=optimizer, data=data,
    )  # fmt: skip
    if config.resume:
        run.load(config.resume)

    with (
        shutting_down(collector),
        InterruptFlag() as interrupt,
        ProgressLine(config.total_frames, rounds.frames, label=job_label()) as progress,
    ):

        def learn() -> None:
            """The updates that the last round still owes; then the new policy drives."""
            if not (left := rounds.owed(log.totals["updates"])):
                return
            progress.note(f"{rounds.frames} steps: {left} updates from {len(data)} samples")
            try:
                while rounds.owed(log.totals["updates"]) and not interrupt:
                    log.add_losses(update(replay.sample()))
            except NonFiniteLossError as error:
                raise RunFailed(f"{error} The last good checkpoint is {run.last()}.") from error
            if rounds.owed(log.totals["updates"]):
                return  # interrupted: who resumes does the rest
            policy.update()
            collector.update_policy_weights_()
            success = run.validate().overall["success"].value
            progress.note(f"{rounds.frames} steps: success {success:.2f} on validation")
            log.write_row()
            if not interrupt:  # who leaves saves
                run.save()

        # The mentor gates: it takes over and hands back, inside the environment, while the policy
        # of the last round drives. Then the policy learns from all that was aggregated.
        learn()
        for batch in () if interrupt else run.batches(interrupt):
            data.add_round(batch)
            log.add_batch(batch)
            if rounds.advance(batch.numel()):
                learn()
            elif rounds.due("log"):
                log.write_row()
            rate = log.takeover_rate
            progress.update(rounds.frames, takeover_rate=rate, success=log.success)
        if interrupt:
            leave(run, "recipes/dagger.py")

    if not log.totals["takeovers"]:
        print("beware: no takeover happened; what was learned is from demonstrations alone")
    conclude(run, {"doubt_threshold": doubt_threshold(data.doubts)})
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="dagger")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    run_recipe(config, train, DaggerRunConfig)


if __name__ == "__main__":
    run_command(main)
