"""The types of a recipe's settings, against which Hydra checks every file and override.

The groups of ``conf/`` are typed by the functions and classes that their ``_target_`` names; here
is what stands outside the groups.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class ScenarioSet:
    """A range of scenario seeds.

    Attributes:
        start: First seed.
        count: Number of scenarios.
    """

    start: int = MISSING
    count: int = MISSING

    def seeds(self) -> range:
        """The seeds."""
        return range(self.start, self.start + self.count)


@dataclass
class ScheduleConfig:
    """How often a training run writes down, saves and validates.

    Attributes:
        log_every: Steps between rows of ``train.csv``.
        checkpoint_every: Steps between checkpoints; the environments are reset at each, so that a
            resumed run sees what the uninterrupted one saw.
        validate_every: Steps between validations; 0 for none.
    """

    log_every: int = 500
    checkpoint_every: int = 5000
    validate_every: int = 5000


@dataclass
class TrainConfig(ScheduleConfig):
    """How collecting and learning alternate.

    Attributes:
        batch_size: Transitions in an update.
        updates_per_step: Updates per environment step; 0.5 is one update every other step.
        learning_starts: Steps before the first update.
        policy_average: Share that the average of the policy keeps at each update; the average
            drives in training, and is validated and kept. 0 keeps the policy of the moment.
        max_grad_norm: Bound of the gradient's norm over all parameters; null for none.
        no_takeover_after: Steps without any takeover after which the run stops (decision 18).
    """

    batch_size: int = 256
    updates_per_step: float = 0.5
    learning_starts: int = 500
    policy_average: float = 0.999
    max_grad_norm: float | None = None
    no_takeover_after: int = 5000


@dataclass
class EvalConfig:
    """Which scenarios measure what.

    Attributes:
        train: Scenarios that training draws from.
        validation: Scenarios for choosing checkpoints and settings, never the test range
            (decision 17).
        test: Held-out scenarios for the final figures.
        set: Which of the three ``recipes/evaluate.py`` drives.
        checkpoint: ``best`` on validation or ``last``: what the final evaluation drives.
        horizon: Steps until an episode of validation or test is cut off; null for as many as in
            training.
        workers: Processes of the final evaluation.
        level: Confidence level of the intervals.
        pictures: Whether to draw pictures and the GIF at the end.
        show: Episodes that a person who was the mentor watches the trained agent drive alone.
    """

    train: ScenarioSet = field(default_factory=ScenarioSet)
    validation: ScenarioSet = field(default_factory=ScenarioSet)
    test: ScenarioSet = field(default_factory=ScenarioSet)
    set: str = "test"
    checkpoint: str = "best"
    horizon: int | None = None
    workers: int = 1
    level: float = 0.95
    pictures: bool = True
    show: int = 3


@dataclass
class BaseConfig:
    """What every recipe needs: a world, who drives in it, and how that is measured.

    Attributes:
        name: Name of the run; its folder is ``runs/<name>/<date>_<time>``.
        seed: Seed of everything random.
        device: ``cpu``, ``cuda`` or ``auto``.
        threads: Threads of torch in this process.
    """

    name: str = MISSING
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    env: dict[str, Any] = field(default_factory=dict)
    mentor: dict[str, Any] = field(default_factory=dict)
    switch: dict[str, Any] = field(default_factory=dict)
    loss: dict[str, Any] = field(default_factory=dict)
    actor: dict[str, Any] = field(default_factory=dict)
    collector: dict[str, Any] = field(default_factory=dict)
    eval: EvalConfig = field(default_factory=EvalConfig)


@dataclass
class ResumableConfig(BaseConfig):
    """What every recipe needs that learns, and that can be interrupted and resumed.

    Attributes:
        resume: Run folder or checkpoint to go on from; null for a new run.
    """

    resume: str | None = None
    critic: dict[str, Any] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    logger: dict[str, Any] = field(default_factory=dict)


@dataclass
class LearningConfig(ResumableConfig):
    """What every recipe needs that trains while it drives.

    Attributes:
        total_frames: Environment steps of training.
        record: Whether to write every step to ``session.jsonl``, from which the run can be driven
            again; false stands for runs from before the setting.
    """

    total_frames: int = 30_000
    record: bool = False


@dataclass
class RunConfig(LearningConfig):
    """Settings of ``recipes/haim.py``.

    Attributes:
        compile: Whether to compile the losses; worth it for long runs only.
        train: How collecting and learning alternate.
    """

    compile: bool = False
    replay: dict[str, Any] = field(default_factory=dict)
    train: TrainConfig = field(default_factory=TrainConfig)


@dataclass
class OffPolicyConfig(RunConfig):
    """Settings of ``recipes/off_policy.py``, the same as those of ``recipes/haim.py``.

    Nobody takes over here: ``train.no_takeover_after`` and ``record`` have no meaning.
    """


@dataclass
class OnPolicyTrainConfig:
    """What is due when in ``recipes/on_policy.py``.

    Attributes:
        log_every: Steps between rows of ``train.csv``.
        checkpoint_every: Steps between checkpoints; see :class:`TrainConfig`.
        validate_every: Steps between validations; 0 for none.
    """

    log_every: int = 2000
    checkpoint_every: int = 20_000
    validate_every: int = 20_000


@dataclass
class OnPolicyRunConfig(LearningConfig):
    """Settings of ``recipes/on_policy.py``.

    Attributes:
        algorithm: Who learns, and by what.
        value: The networks for state values.
        discriminator: The network that tells an expert from the policy.
        cost_limit: Bound of an episode's mean cost, for the algorithms that hold one.
        demonstrations: Minari dataset to imitate, for the algorithm that does; else null.
        train: What is due when.
    """

    algorithm: dict[str, Any] = field(default_factory=dict)
    value: dict[str, Any] = field(default_factory=dict)
    discriminator: dict[str, Any] = field(default_factory=dict)
    cost_limit: float = 0.1
    demonstrations: str | None = None
    train: OnPolicyTrainConfig = field(default_factory=OnPolicyTrainConfig)


@dataclass
class DemonstrateConfig(BaseConfig):
    """Settings of ``recipes/demonstrate.py``.

    Attributes:
        dataset: Id of the Minari dataset to write, ``name-v0`` or ``namespace/name-v0``.
        steps: Steps to record.
        driver: Who drives: ``mentor``, ``policy``, ``random`` or ``straight``.
        checkpoint: Run folder or checkpoint of the policy; null where another one drives.
        author: For the dataset's card; null for none.
    """

    dataset: str = MISSING
    steps: int = 49_000
    driver: str = "mentor"
    checkpoint: str | None = None
    author: str | None = None


@dataclass
class OfflineConfig:
    """How a policy is learned from data alone.

    Attributes:
        updates: Gradient steps.
        bc_updates: Of these, the first ones in which CQL's policy clones the data, before it
            follows the critics.
        batch_size: Transitions in one.
        lr: Learning rate of Adam.
        policy_average: Share that the average of the policy keeps at each update; the average is
            validated and kept. 0 keeps the policy of the moment.
        max_grad_norm: Bound of the gradient's norm over all parameters; null for none.
        log_every: Updates between rows of ``train.csv``.
        checkpoint_every: Updates between checkpoints.
        validate_every: Updates between validations; the best policy is kept.
    """

    updates: int = 20_000
    bc_updates: int = 2000
    batch_size: int = 256
    lr: float = 3e-4
    policy_average: float = 0.999
    max_grad_norm: float | None = None
    log_every: int = 500
    checkpoint_every: int = 5000
    validate_every: int = 5000


@dataclass
class OfflineRunConfig(ResumableConfig):
    """Settings of ``recipes/offline.py``.

    Attributes:
        demonstrations: Minari dataset to learn from, or its folder; null to have the mentor drive.
        steps: Steps that the mentor then drives.
        like: Folder of a run whose number of mentor-driven steps it drives instead, or null.
        cost_weight: Reward that a cost of 1, such as a collision, takes away.
        objective: The loss, a partial that takes ``actor_network``, and ``qvalue_network`` if it
            has critics.
        offline: How it is learned.
    """

    demonstrations: str | None = None
    steps: int = 4000
    like: str | None = None
    cost_weight: float = 5.0
    objective: dict[str, Any] = field(default_factory=dict)
    replay: dict[str, Any] = field(default_factory=dict)
    offline: OfflineConfig = field(default_factory=OfflineConfig)


@dataclass
class DaggerConfig:
    """How demonstrations, rounds of driving and learning alternate.

    Attributes:
        warm_up: Steps of demonstrations; they count as environment steps, driven by the mentor.
        interactions: Steps of a round; ``total_frames`` holds the warm-up and whole rounds.
        updates: Gradient steps after the warm-up and after each round.
        keep: ``mentor`` learns from what the mentor drove alone, ``all`` from the agent's own
            steps, too.
        batch_size: Steps in an update.
        lr: Learning rate of Adam.
        log_every: Steps between rows of ``train.csv``.
    """

    warm_up: int = 10_000
    interactions: int = 5000
    updates: int = 5000
    keep: str = "mentor"
    batch_size: int = 256
    lr: float = 4e-4
    log_every: int = 500


@dataclass
class DaggerRunConfig(LearningConfig):
    """Settings of ``recipes/dagger.py``.

    Attributes:
        demonstrations: Minari dataset of the warm-up; null to have the mentor drive it.
        objective: The loss that clones, a partial that takes ``actor_network``.
        dagger: How demonstrations, rounds of driving and learning alternate.
    """

    demonstrations: str | None = None
    objective: dict[str, Any] = field(default_factory=dict)
    replay: dict[str, Any] = field(default_factory=dict)
    dagger: DaggerConfig = field(default_factory=DaggerConfig)


@dataclass
class EvaluateConfig(BaseConfig):
    """Settings of ``recipes/evaluate.py``.

    Attributes:
        checkpoint: Run folder or checkpoint of the policy; null where no policy drives.
        driver: ``policy``, ``policy+mentor``, ``mentor``, ``random``, ``straight``, or a list.
    """

    checkpoint: str | None = None
    driver: Any = "policy"


@dataclass
class ReportConfig:
    """Settings of ``recipes/report.py``.

    Attributes:
        runs: Run folders or folders of them, and published ``runs.json`` files; one or a list.
        output: Folder that the report is written to.
        reference: Method that the others are compared with.
        level: Confidence level of the intervals.
        resamples: Draws of the bootstrap.
        side_by_side: Methods that drive one test scenario again and are drawn.
        scenario: Its number; null for the first one of the test.
    """

    runs: Any = MISSING
    output: str = "report"
    reference: str = "haim"
    level: float = 0.95
    resamples: int = 2000
    side_by_side: list[str] = field(default_factory=list)
    scenario: int | None = None


def register_schemas() -> None:
    """Make the schemas known to Hydra under the names that ``conf/*.yaml`` begin with."""
    store = ConfigStore.instance()
    store.store(name="run_schema", node=RunConfig)
    store.store(name="dagger_schema", node=DaggerRunConfig)
    store.store(name="demonstrate_schema", node=DemonstrateConfig)
    store.store(name="offline_schema", node=OfflineRunConfig)
    store.store(name="off_policy_schema", node=OffPolicyConfig)
    store.store(name="on_policy_schema", node=OnPolicyRunConfig)
    store.store(name="evaluate_schema", node=EvaluateConfig)
    store.store(name="report_schema", node=ReportConfig)
