"""Behaviour cloning: the same actor, trained on what the mentor does when it drives alone.

python recipes/clone.py clone.steps=10000
python recipes/clone.py clone.like=runs/haim/<date>    # as many mentor steps as that run had
"""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.objectives import BCLoss

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.evaluation.assembly import Sizes, World, build, build_actor, prepare
from haim_torchrl.evaluation.checkpoint import find_checkpoint, load_checkpoint, save_checkpoint
from haim_torchrl.evaluation.command import open_folder, register, reporting, run_command
from haim_torchrl.evaluation.drivers import PolicyDriver
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.report import drive_set, final_report
from haim_torchrl.evaluation.run import load_policy, peak_memory
from haim_torchrl.objectives import check_finite


def clone(config: DictConfig) -> Path:
    """Record the mentor, fit the actor, evaluate it on held-out scenarios without the mentor."""
    device = prepare(config)
    settings = config.clone
    world = World.of(config, "train", takeovers=False)
    sizes = Sizes.of_world(world)
    actor = build_actor(config, sizes, device)
    steps = settings.steps
    if settings.like is not None:
        path = find_checkpoint(settings.like, ("last.pt",))
        steps = int(load_checkpoint(path)["parts"]["log"]["totals"]["mentor_steps"])
    folder = open_folder(config)

    with ProgressLine(steps, unit="mentor steps") as progress:
        data = record_demonstrations(
            world,
            build(config.mentor),
            steps,
            world.seeds(),
            seed=config.seed,
            observation_keys=actor.in_keys,
            on_step=partial(ProgressLine.update, progress),
        ).to(device)

    distance = "l2" if settings.loss_function == "l2" else None
    if distance is None:  # a density of squashed actions is not defined at their bounds
        data["action"] = data["action"].clamp(-0.99, 0.99)
    with warnings.catch_warnings():  # about a target network, which this loss has none of
        warnings.simplefilter("ignore", UserWarning)
        loss = BCLoss(actor, loss_function=distance)
    optimizer = torch.optim.Adam(actor.parameters(), lr=settings.lr, fused=True)
    best = -1.0
    with ProgressLine(settings.updates, unit="updates") as progress:
        for update in range(1, settings.updates + 1):
            rows = torch.randint(len(data), (settings.batch_size,), device=device)
            batch = data[rows]
            if sizes.reflection is not None and settings.mirrored:
                sizes.reflection(batch, settings.mirrored)
            losses = loss(batch)
            check_finite(losses)
            optimizer.zero_grad()
            losses["loss_bc"].backward()
            optimizer.step()
            progress.update(update, loss=losses["loss_bc"].item())
            if update % settings.validate_every and update != settings.updates:
                continue
            validation = World.of(config, "validation", takeovers=False)
            summary = drive_set(PolicyDriver(actor), validation, label="validation").summary()
            success = summary.overall["success"].value
            progress.note(f"{update} updates: success {success:.2f} on validation")
            if success >= best:
                best = success
                contents = {
                    "kind": "policy",
                    "config": OmegaConf.to_yaml(config),
                    "frames": steps,
                    "actor": actor.state_dict(),
                    "totals": {"frames": steps, "mentor_steps": steps, "violations": 0.0},
                    "validation": {"success": success},
                }
                save_checkpoint(folder / "checkpoints" / "best.pt", contents)

    chosen = load_policy(folder / "checkpoints" / "best.pt", actor)
    training = {**chosen["totals"], "peak_memory_mib": peak_memory()}
    final_report(folder, config, PolicyDriver(actor), training, chosen["validation"])
    print(f"everything is in {folder}")
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="clone")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    with reporting():
        clone(config)


if __name__ == "__main__":
    run_command(main)
