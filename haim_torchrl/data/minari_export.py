"""A recorded session as a Minari dataset: driven again, with what the agent saw."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import os
import shutil
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.data.session import Session, SessionEpisode, read_session

CARD = "haim_torchrl"
"""Entry of a dataset's metadata that holds what Minari has no name for."""
WHO_DROVE = ("action_agent", "action_mentor", "intervention", "takeover_start")
OUTCOMES = ("takeover_cost", "disturbance_cost", "cost", "success")
"""Entries under ``next`` that are kept, too, where the environment has them."""
INFOS = {
    "action_agent": "what the agent proposed",
    "action_mentor": "what the mentor did, zeros where it did not drive",
    "intervention": "the mentor drove the step",
    "takeover_start": "first step of a takeover",
    "takeover_cost": "cost of that start",
    "disturbance_cost": "cost of the disturbance of followers",
    "cost": "cost of the environment, such as a collision",
    "success": "the destination was reached",
    "device_ok": "the mentor's input device worked; true for machines",
    "scenario": "seed of the scenario; -1 where the simulator has none",
    "cut": "the record ends here though the episode went on; Minari has it as a truncation",
}
"""Meaning of the infos. Entry 0 belongs to the reset, entry t + 1 to step t, as in Minari."""


class MinariError(ValueError):
    """A dataset that cannot be written or read; the message says why and what to do."""


def find_minari() -> ModuleType:
    """The module minari, which only datasets need.

    Raises:
        MinariError: If it, or the library of its file format, is not installed.
    """
    try:
        importlib.import_module("h5py")
        return importlib.import_module("minari")
    except ImportError as error:
        raise MinariError(
            f"Minari datasets need {error.name}, which is not installed: install "
            "haim-torchrl[minari], with Python 3.11 or newer"
        ) from error


def export_session(
    session: str | os.PathLike[str],
    dataset_id: str,
    *,
    make_env: Callable[[], EnvBase] | None = None,
    author: str | None = None,
    author_email: str | None = None,
    description: str | None = None,
    algorithm_name: str | None = None,
    exact: bool = True,
) -> Path:
    """Write a session as a Minari dataset.

    A session holds actions and checksums of observations, not observations. So it is driven again
    (:class:`~haim_torchrl.mentors.ReplayMentor`), which yields what was collected, bit by bit, or
    an error. Each recorded episode becomes one of the dataset: observations, executed actions,
    rewards, terminations, truncations, and :data:`INFOS`. Nothing is written before all of it was
    driven, and nothing is sent anywhere.

    The format is HDF5, Minari's default and that of most published datasets: one file, lossless,
    with h5py as the only further dependency.

    Args:
        session: A session file, or the folder of a run that holds one.
        dataset_id: ``name-v0`` or ``namespace/name-v0``. The dataset goes to the folder that
            ``MINARI_DATASETS_PATH`` names, by default ``~/.minari/datasets``.
        make_env: Builds the environment that was recorded, without its mentor. By default it is
            built from the settings in the session's header.
        author: For the card; left out if None.
        author_email: For the card; left out if None.
        description: For the card; by default it says what the data are.
        algorithm_name: For the card; by default it names the mentor.
        exact: Whether the agent must see, bit by bit, what it saw in the record.

    Returns:
        Folder of the dataset.

    Raises:
        MinariError: If minari is missing, the id is malformed or taken, the session carries no
            settings, or its data are not finite or out of range.
        SessionError: If the session cannot be read or driven again.
    """
    minari = find_minari()
    folder = _new_folder(dataset_id)
    record = read_session(session)
    if not record.episodes:
        raise MinariError(f"session {record.path} holds no step, and a dataset needs one")
    env = _build(record, make_env, exact)
    try:
        driven = [_drive(env, episode) for episode in record.episodes]
        seen = _box(env.observation_spec["observation"], "observation")
        acted = _box(env.action_spec, "action")
        spec = _env_spec(env)
    finally:
        env.close()
    for number, steps in enumerate(driven):
        check_ranges(steps, seen, acted, f"episode {number} of session {record.path}")
    card = _card(record, driven)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about what is left out on purpose
            dataset = minari.create_dataset_from_buffers(
                dataset_id,
                [_buffer(steps, episode) for steps, episode in zip(driven, record.episodes)],
                env=spec,
                observation_space=seen,
                action_space=acted,
                algorithm_name=algorithm_name or _algorithm(record),
                author=author,
                author_email=author_email,
                description=description or _description(record, card["statistics"]),
                requirements=[f"{n}=={v}" for n, v in card["versions"].items()],
                data_format="hdf5",
                jpeg_encoding=False,
            )
            dataset.storage.update_metadata({CARD: card})
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)  # which did not exist before
        raise
    return folder


def check_ranges(steps: TensorDictBase, observation: Any, action: Any, where: str) -> None:
    """Refuse values that are not finite, or outside of their space.

    Args:
        steps: Transitions, ``[T]``.
        observation: Gymnasium's box of observations.
        action: Gymnasium's box of actions.
        where: What they are of, for the message.

    Raises:
        MinariError: With the name of the field.
    """
    for key, box in (
        ("observation", observation),
        (("next", "observation"), observation),
        ("action", action),
        ("action_agent", action),
        ("action_mentor", None),  # zeros, where it did not drive, need not be an action
        (("next", "reward"), None),
    ):
        name = key if isinstance(key, str) else "next." + key[1]
        values = steps[key].numpy()
        if not np.isfinite(values).all():
            raise MinariError(f"{where}: {name} holds values that are not finite")
        if box is not None and ((values < box.low - 1e-5) | (values > box.high + 1e-5)).any():
            raise MinariError(
                f"{where}: {name} holds values from {values.min():.6g} to {values.max():.6g}, "
                f"outside of its space {box}"
            )


def _new_folder(dataset_id: str) -> Path:
    storage = importlib.import_module("minari.storage.datasets_root_dir")
    names = importlib.import_module("minari.dataset.minari_dataset")
    try:
        names.parse_dataset_id(dataset_id)
    except (ValueError, TypeError) as error:
        raise MinariError(
            f"dataset id {dataset_id!r} is malformed; use name-v0 or namespace/name-v0"
        ) from error
    folder = Path(storage.get_dataset_path(dataset_id))
    if folder.exists():
        raise MinariError(
            f"dataset {dataset_id} exists in {folder}, and nothing is overwritten; choose another "
            "name or version"
        )
    return folder


def _build(session: Session, make_env: Callable[[], EnvBase] | None, exact: bool) -> EnvBase:
    """The recorded world, with the record in the place of agent and mentor."""
    from haim_torchrl.evaluation.assembly import World  # all of what data are made with
    from haim_torchrl.mentors.replay import ReplayMentor
    from haim_torchrl.switches import RequestSwitch
    from haim_torchrl.transforms.intervention import InterventionTransform

    if make_env is not None:
        mentor = partial(ReplayMentor, session.path, exact=exact)
        env = make_env()
        env = env if isinstance(env, TransformedEnv) else TransformedEnv(env)
        return env.append_transform(InterventionTransform(mentor, RequestSwitch()))
    if not session.header["settings"]:
        raise MinariError(
            f"session {session.path} carries no settings from which its environment could be "
            "built; give make_env"
        )
    settings = OmegaConf.create(session.header["settings"])
    assert isinstance(settings, DictConfig)
    try:
        world = World.of(settings, "train", takeovers=True)
    except (AttributeError, ValueError, OmegaConfBaseException) as error:
        raise MinariError(
            f"the settings that session {session.path} carries describe no environment of this "
            "project; give make_env"
        ) from error
    replay = {
        "_target_": "haim_torchrl.mentors.ReplayMentor",
        "session": str(session.path),
        "exact": exact,
    }
    request = {"_target_": "haim_torchrl.switches.RequestSwitch"}
    return dataclasses.replace(world, mentor=replay, switch=request)()


def _drive(env: EnvBase, episode: SessionEpisode) -> TensorDict:
    """Drive a recorded episode again.

    Returns:
        Its transitions, ``[T]``, and what the record alone knows.
    """
    from haim_torchrl.transforms.transition import TakeoverToTransition

    state, steps = env.reset(), []
    for _ in episode.steps:
        step = env.step(state.set("action", env.action_spec.zero()))
        steps.append(step.clone(False))
        state = step_mdp(step)
    following = [*WHO_DROVE, "observation", "reward", "done", "terminated", "truncated", *OUTCOMES]
    driven = TakeoverToTransition(
        ["observation", "action", *WHO_DROVE, *(("next", key) for key in following)]
    )(torch.stack(steps))
    return TensorDict(driven, batch_size=[len(steps)])


def _buffer(steps: TensorDictBase, episode: SessionEpisode) -> Any:
    buffers = importlib.import_module("minari.data_collector")
    after, count = steps["next"], len(episode.steps)
    terminated = after["terminated"].squeeze(-1).numpy()
    truncated = after["truncated"].squeeze(-1).numpy().copy()
    cut = np.zeros(count, dtype=bool)
    cut[-1] = not (terminated[-1] or truncated[-1])
    infos = {key: steps[key].numpy() for key in WHO_DROVE}
    infos |= {key: after[key].numpy() for key in OUTCOMES if key in after}
    infos = {k: v if k.startswith("action") else v.reshape(count) for k, v in infos.items()}
    infos["device_ok"] = np.array([step.device_ok for step in episode.steps])
    scenario = -1 if episode.scenario is None else episode.scenario
    infos["scenario"] = np.full(count, scenario, dtype=np.int64)
    infos["cut"] = cut
    first, last = steps["observation"][:1].numpy(), after["observation"].numpy()
    return buffers.EpisodeBuffer(
        seed=episode.scenario,
        observations=np.concatenate([first, last]),
        actions=steps["action"].numpy(),
        rewards=after["reward"].reshape(count).numpy(),
        terminations=terminated,
        truncations=truncated | cut,
        infos={key: np.concatenate([_at_reset(key, v), v]) for key, v in infos.items()},
    )


def _at_reset(key: str, values: np.ndarray) -> np.ndarray:
    """The entry that belongs to the reset, in which nothing was done yet, ``[1, ...]``."""
    return values[:1] if key in ("scenario", "device_ok") else np.zeros_like(values[:1])


def _box(spec: TensorSpec, name: str) -> Any:
    spaces = importlib.import_module("gymnasium.spaces")
    if not spec.dtype.is_floating_point:
        raise MinariError(f"{name} is {spec.dtype}, and only continuous values can be exported")
    low, high = -np.inf, np.inf
    if isinstance(spec, Bounded):
        low, high = (edge.expand(spec.shape).numpy() for edge in (spec.space.low, spec.space.high))
    dtype = torch.empty(0, dtype=spec.dtype).numpy().dtype
    return spaces.Box(low, high, tuple(spec.shape), dtype.type)


def _env_spec(env: EnvBase) -> Any:
    """What gymnasium makes the simulator from; None where that is not known."""
    from haim_torchrl.envs.platoon_env import PlatoonEnv
    from haim_torchrl.evaluation.drivers import simulator_of

    gym = importlib.import_module("gymnasium")
    simulator = simulator_of(env)
    if isinstance(simulator, PlatoonEnv):
        spec = copy.deepcopy(gym.spec("haim_torchrl/Platoon-v0"))
        spec.kwargs = {"config": dataclasses.asdict(simulator.settings)}
        return spec
    return getattr(simulator, "spec", None)


def _card(session: Session, driven: list[TensorDict]) -> dict[str, Any]:
    steps = TensorDict.cat(driven)
    finished = [episode for episode in driven if episode["next", "done"][-1]]
    success = [bool(e["next", "success"][-1]) for e in finished if ("next", "success") in e]
    versions = session.header["versions"]
    return {
        "statistics": {
            "episodes": len(driven),
            "steps": len(steps),
            "mentor_share": steps["intervention"].float().mean().item(),
            "takeovers": int(steps["takeover_start"].sum()),
            "mean_return": steps["next", "reward"].sum().item() / len(driven),
            "finished": len(finished),
            "success": sum(success) / len(success) if success else None,
        },
        "infos": {k: v for k, v in INFOS.items() if k not in OUTCOMES or ("next", k) in steps},
        "seed": session.header["seed"],
        "started": session.header["started"],
        "settings": session.header["settings"],
        "versions": {name.replace("_", "-"): version for name, version in versions.items()},
    }


def _algorithm(session: Session) -> str:
    settings = OmegaConf.create(session.header["settings"] or "")
    mentor = str(OmegaConf.select(settings, "mentor._target_") or "a mentor")
    return f"haim_torchrl: an agent that learns, with takeovers by {mentor.rpartition('.')[2]}"


def _description(session: Session, figures: dict[str, Any]) -> str:
    return (
        "Takeover data: an agent drove, and a mentor took over. The actions are those that were "
        "executed; the infos say who drove and what either wanted (entry t + 1 belongs to step t). "
        f"{figures['episodes']} episodes, {figures['steps']} steps, of which the mentor drove "
        f"{figures['mentor_share']:.0%} in {figures['takeovers']} takeovers."
    )
