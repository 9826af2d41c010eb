"""The state of a training run: what is counted, saved, restored and validated around the loop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torchrl.collectors import BaseCollector
from torchrl.modules import ProbabilisticActor

from haim_torchrl.collectors import (
    ClusterError,
    LiveCollector,
    LiveCollectorError,
    resume_collector,
)
from haim_torchrl.data.batches import DatasetBatches
from haim_torchrl.data.session import SessionError
from haim_torchrl.evaluation.assembly import World
from haim_torchrl.evaluation.checkpoint import (
    CheckpointError,
    find_checkpoint,
    load_checkpoint,
    load_module,
    random_state,
    restore_random_state,
    save_checkpoint,
)
from haim_torchrl.evaluation.command import InterruptFlag, RunFailed
from haim_torchrl.evaluation.drivers import PolicyDriver
from haim_torchrl.evaluation.evaluator import evaluate
from haim_torchrl.evaluation.metrics import Summary
from haim_torchrl.evaluation.schedule import Schedule
from haim_torchrl.evaluation.training_log import TrainingLog
from haim_torchrl.human import PersonQuit
from haim_torchrl.modules import PolicyAverage
from haim_torchrl.objectives.resuming import load_learned


class Stateful(Protocol):
    """What can be saved and restored."""

    def state_dict(self) -> dict[str, Any]:
        """Everything that a later run needs."""
        ...

    def load_state_dict(self, state_dict: Any) -> Any:
        """Continue from it."""
        ...


class Run:
    """Saves, restores and validates a training run.

    Args:
        folder: The run's folder.
        config: Its settings.
        actor: Its policy.
        average: The average of its policy, which is validated and kept.
        collector: Its collector, or what stands in for one where nobody drives.
        log: What it writes down.
        schedule: What is due when.
        parts: Loss, optimiser and replay by name.
    """

    def __init__(
        self,
        folder: Path,
        config: DictConfig,
        *,
        actor: ProbabilisticActor,
        average: PolicyAverage,
        collector: BaseCollector | LiveCollector | DatasetBatches,
        log: TrainingLog,
        schedule: Schedule,
        **parts: Stateful,
    ) -> None:
        self.folder, self.config = folder, config
        self.actor, self.collector, self.log, self.schedule = actor, collector, log, schedule
        self.average = average
        self._parts: dict[str, Stateful] = {
            **parts,
            "average": average,
            "log": log,
            "schedule": schedule,
        }
        self._best: tuple[float, float, int] | None = None
        self._choices = _choices()

    def last(self) -> str:
        """Where the last whole state is, for a message."""
        path = self.checkpoints / "last.pt"
        return str(path) if path.exists() else "none: the run had not saved yet"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.folder / "checkpoints"

    def batches(self, interrupt: InterruptFlag) -> Iterator[TensorDictBase]:
        """What the collector collects, until it ends or the run is interrupted.

        Args:
            interrupt: looked at before each batch, and told when the person who drives quits.

        Raises:
            RunFailed: If it drives a session again, and that ends or is departed from, or if a
                live collector or a worker on a cluster cannot go on.
        """
        try:
            for batch in self.collector:
                if batch.batch_size.numel():  # live collectors hand out empty ones in a pause
                    yield batch
                if interrupt:
                    return
        except PersonQuit:
            interrupt.wish()
        except (SessionError, LiveCollectorError, ClusterError) as error:
            raise RunFailed(f"{error}. The last good checkpoint is {self.last()}.") from error

    def save(self) -> Path:
        """Write ``checkpoints/last.pt`` and begin a new episode.

        Simulators cannot save the middle of an episode. A resumed run has to begin a new one, so
        this one does the same, and both see the same from here on; except for a live collector,
        since a person's drive is not cut short.
        """
        path = save_checkpoint(
            self.checkpoints / "last.pt",
            {
                "kind": "run",
                "config": OmegaConf.to_yaml(self.config),
                "choices": self._choices,
                "frames": self.schedule.frames,
                "actor": self.average.actor.state_dict(),
                "learner": self.actor.state_dict(),
                "best": self._best,
                "parts": {name: part.state_dict() for name, part in self._parts.items()},
                "collector": self.collector.state_dict(),
                "random": random_state(),
            },
        )
        if not isinstance(self.collector, LiveCollector) and not self.schedule.finished:
            self._new_episode()
        return path

    def load(self, source: str) -> None:
        """Continue from a checkpoint of a run with the same parts.

        What was learned is the checkpoint's. Settings, such as learning rates, are this run's.

        Raises:
            CheckpointError: If it is missing, foreign, of another kind, or does not fit.
        """
        path = find_checkpoint(source, ("last.pt",))
        contents = load_checkpoint(path)
        if contents.get("kind") != "run":
            raise CheckpointError(
                f"checkpoint {path} holds a policy only; resume from the run's checkpoints/last.pt"
            )
        load_module(self.actor, contents["learner"], "actor", path)
        for name, part in self._parts.items():
            try:
                load_learned(part, contents["parts"][name])
            except (KeyError, RuntimeError, ValueError) as error:
                raise CheckpointError(
                    f"checkpoint {path} does not fit this run's {name}; resume with the settings "
                    f"that it was written with: {' '.join(str(error).split())[:300]}"
                ) from error
        best = contents["best"]
        self._best = None if best is None else (best[0], best[1], int(best[2]))
        if self.schedule.finished and (self.folder / "metrics.json").exists():
            raise CheckpointError(
                f"checkpoint {path} has all its {self.schedule.frames} steps already; give a "
                f"larger {self.schedule.key} to go on, or evaluate it with recipes/evaluate.py"
            )
        try:
            resume_collector(self.collector, contents["collector"])
        except (SessionError, ClusterError) as error:
            raise CheckpointError(f"checkpoint {path} cannot be gone on from: {error}") from error
        self.log.restart_episodes()
        self._choices = dict(contents["choices"])
        restore_random_state(contents["random"])

    def _new_episode(self) -> None:
        state = random_state()
        self.collector.reset()
        self.log.restart_episodes()
        restore_random_state(state)

    def validate(self) -> Summary:
        """Drive the validation scenarios without mentor, and keep the policy if it is the best.

        The best has the highest success; among equals the fewest violations, then the latest.
        """
        world = World.of(self.config, "validation", takeovers=False)
        result = evaluate(PolicyDriver(self.average.actor), world, world.seeds())
        summary = result.summary(self.config.eval.level)
        figures: dict[str, float] = {
            name: summary.overall[name].value
            for name in (
                "success", "violations", "out_of_road", "wrong_way", "timeout", "crash", "return",
                "disturbance_rate", "disturbance_onsets_per_km", "speed", "progress",
            )
        }  # fmt: skip
        success = summary.overall["success"]
        figures |= {"success_low": success.low, "success_high": success.high}
        self.log.write_validation(figures)
        score = (success.value, -summary.overall["violations"].value, self.schedule.frames)
        self._save_policy(f"policy_{self.schedule.frames:07d}.pt", figures)
        if self._best is None or score > self._best:
            self._best = score
            self._save_policy("best.pt", figures)
        return summary

    def _save_policy(self, name: str, figures: Mapping[str, float]) -> None:
        save_checkpoint(
            self.checkpoints / name,
            {
                "kind": "policy",
                "config": OmegaConf.to_yaml(self.config),
                "frames": self.schedule.frames,
                "actor": self.average.actor.state_dict(),
                "totals": dict(self.log.totals),
                "validation": dict(figures),
            },
        )

    def check_takeovers(self) -> None:
        """Stop a run in which nobody ever takes over: there is nothing to learn from (decision 18).

        Raises:
            RunFailed: If no takeover happened within ``train.no_takeover_after`` steps, or in the
                whole run.
        """
        frames, limit = self.schedule.frames, self.config.train.no_takeover_after
        if self.log.totals["mentor_steps"] == 0 and (frames >= limit or self.schedule.finished):
            raise RunFailed(
                f"no takeover happened in the first {frames} steps, so there is nothing to learn "
                "from; choose another switch (switch=shield, switch=dense) or mentor, or raise "
                "train.no_takeover_after"
            )


def _choices() -> dict[str, str]:
    """Members that Hydra chose for each group of this job."""
    settings = HydraConfig.instance().cfg
    chosen = {} if settings is None else OmegaConf.select(settings, "hydra.runtime.choices")  # type: ignore[arg-type]
    return {str(k): str(v) for k, v in chosen.items() if not str(k).startswith("hydra/")}


def load_policy(path: Path, actor: ProbabilisticActor) -> dict[str, Any]:
    """Load the policy of a checkpoint of either kind into an actor.

    Returns:
        The checkpoint's contents.
    """
    contents = load_checkpoint(path)
    load_module(actor, contents["actor"], "actor", path)
    return contents


def peak_memory() -> float:
    """Largest memory that this process has held so far, in MiB; NaN where it is not told."""
    try:
        import resource
    except ImportError:
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
