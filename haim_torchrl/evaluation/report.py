"""The end of a run: held-out evaluation, tables, ``metrics.json`` and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from haim_torchrl.evaluation.assembly import World
from haim_torchrl.evaluation.command import job_label
from haim_torchrl.evaluation.curves import draw_curves
from haim_torchrl.evaluation.drivers import Driver
from haim_torchrl.evaluation.evaluator import Evaluation, evaluate
from haim_torchrl.evaluation.pictures import animate, platoon_figure, top_view
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.recording import Episode
from haim_torchrl.evaluation.tables import main_table, print_tables, split_table, write_metrics


def drive_set(
    driver: Driver,
    world: World,
    *,
    workers: int = 1,
    record: Sequence[int] = (),
    label: str = "",
) -> Evaluation:
    """Drive a scenario set with a progress line.

    Args:
        driver: Who drives.
        world: Builds the environment and names the scenarios.
        workers: Processes.
        record: Scenarios to record.
        label: Written before the progress line.
    """
    seeds = world.seeds()
    arrived = done = 0
    unit = f"episodes {label}".strip()
    with ProgressLine(len(seeds), unit=unit, label=job_label()) as progress:

        def show(record: Any) -> None:
            nonlocal arrived, done
            done += 1
            arrived += record.success
            progress.update(done, success=arrived / done)

        return evaluate(driver, world, seeds, workers=workers, record=record, on_episode=show)


def draw_episode(episode: Episode, folder: Path, brake_limit: float) -> list[Path]:
    """Top view, platoon diagram and GIF of one episode."""
    index = episode.labels.index
    return [
        top_view(episode, folder / "top_view.png"),
        platoon_figure([(f"scenario {index}", episode)], folder / "platoon.png", brake_limit),
        animate(episode, folder / "episode.gif"),
    ]


def training_headings(totals: Mapping[str, float] | None) -> dict[str, str]:
    """Training columns of the paper's Table 1 as text; empty for who was not trained."""
    if totals is None:
        return {}
    headings = {
        "training safety violation": f"{totals['violations']:.0f}",
        "training data usage": f"{totals['frames']:.0f}",
        "mentor-driven steps": f"{totals['mentor_steps']:.0f}",
    }
    if "takeover_rate_first_fifth" in totals:
        first, last = totals["takeover_rate_first_fifth"], totals["takeover_rate_last_fifth"]
        headings["takeover rate first/last fifth"] = f"{first:.3f} / {last:.3f}"
    return headings


def final_report(
    folder: Path,
    config: DictConfig,
    driver: Driver,
    training: Mapping[str, float],
    chosen: Mapping[str, Any],
) -> dict[str, Any]:
    """Evaluate on the held-out scenarios without mentor and write everything down.

    Args:
        folder: The run's folder.
        config: Its settings.
        driver: The chosen policy.
        training: Totals of the training, by name.
        chosen: Which checkpoint the policy is of, and why.

    Returns:
        What went into ``metrics.json``.
    """
    world = World.of(config, "test", takeovers=False)
    # The first scenario is drawn, fixed in advance: the picture is an example, not a selection.
    recorded = [world.seeds()[0]] if config.eval.pictures else []
    result = drive_set(driver, world, workers=config.eval.workers, record=recorded, label="test")
    summary = result.summary(config.eval.level)
    headings = training_headings(training)
    rows = {config.name: summary}
    title = f"{len(result.records)} held-out scenarios, no mentor"
    print_tables(main_table(rows, title, {config.name: headings}), split_table(rows))
    contents = {
        "name": config.name,
        "seed": config.seed,
        "training": dict(training),
        "checkpoint": dict(chosen),
        "test": summary.as_dict(),
        "episodes": [record.as_dict() for record in result.records],
    }
    path = folder / "metrics.json"
    if path.exists():  # of the shorter run that this one went on with
        path = folder / f"metrics_{training['frames']:.0f}.json"
    write_metrics(path, contents)
    if (folder / "train.csv").exists() and config.eval.pictures:
        draw_curves(folder, folder / "curves.png")
    for episode in result.episodes:
        draw_episode(episode, folder, config.loss.implicit.cost.threshold)
    return contents
