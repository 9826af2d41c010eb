"""Minari datasets read as transitions."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import EnvBase

from haim_torchrl.data.minari_format import (
    CARD,
    OUTCOMES,
    WHO_DROVE,
    MinariError,
    check_ranges,
    find_minari,
)


def load_minari(dataset: str | os.PathLike[str], env: EnvBase | None = None) -> TensorDict:
    """Read a Minari dataset as transitions.

    Any dataset of continuous observations and actions can be read. One that was written here says
    in its infos who drove, and yields what was collected. Another one counts as demonstrations:
    each step was driven by the mentor, and ``action_agent`` is ``action``.

    Args:
        dataset: Id of a dataset below ``MINARI_DATASETS_PATH``, or its folder. Nothing is
            downloaded.
        env: If given, the dataset's spaces must be this environment's.

    Returns:
        Transitions ``[N]``, episode after episode: ``observation``, ``action``, ``action_agent``,
        ``action_mentor``, ``intervention [N, 1]``, ``takeover_start [N, 1]``, and under ``next``
        ``observation``, ``reward [N, 1]``, ``done``, ``terminated``, ``truncated`` and those of
        ``takeover_cost``, ``disturbance_cost``, ``cost`` and ``success`` that it holds.

    Raises:
        MinariError: In one sentence that names the field, if the dataset is missing, of spaces
            that cannot be used or are not the environment's, incomplete, not finite or out of
            range.
    """
    return TensorDict.cat(load_episodes(dataset, env))


def load_episodes(dataset: str | os.PathLike[str], env: EnvBase | None = None) -> list[TensorDict]:
    """Read a Minari dataset episode by episode.

    Args:
        dataset: As of :func:`load_minari`.
        env: As of :func:`load_minari`.

    Returns:
        Transitions ``[T]`` of each episode, with the entries of :func:`load_minari`.

    Raises:
        MinariError: As :func:`load_minari`.
    """
    found = open_dataset(dataset)
    spaces = importlib.import_module("gymnasium.spaces")
    for name in ("observation", "action"):
        space = getattr(found, f"{name}_space")
        if not isinstance(space, spaces.Box):
            raise MinariError(
                f"{name} of dataset {found.id} is {type(space).__name__}, and only Box can be read"
            )
    if env is not None:
        if "observation" not in env.observation_spec.keys(True, True):
            raise MinariError("the environment has no entry observation to hold the dataset's to")
        _check_spec(env.observation_spec["observation"], found.observation_space, "observation")
        _check_spec(env.action_spec, found.action_space, "action")
    episodes = []
    for number, episode in enumerate(found.iterate_episodes()):
        where = f"episode {number} of dataset {found.id}"
        steps = _transitions(episode, found, where)
        check_ranges(steps, found.observation_space, found.action_space, where)
        episodes.append(steps)
    if not episodes:
        raise MinariError(f"dataset {found.id} holds no episode")
    return episodes


def card_of(dataset: str | os.PathLike[str]) -> dict[str, Any]:
    """What a dataset says of itself beyond Minari's own entries.

    Args:
        dataset: As of :func:`load_minari`.

    Returns:
        Of ``settings`` (YAML), ``statistics``, ``versions``, ``seed``, ``started`` and ``infos``
        those that it has, and ``scenarios``: the seeds of its episodes, in order; empty where
        nobody says.

    Raises:
        MinariError: If it is missing.
    """
    found = open_dataset(dataset)
    about = found.storage.get_episode_metadata(range(found.total_episodes))
    seeds = [episode.get("seed") for episode in about]
    known = [int(seed) for seed in seeds if seed is not None]
    return {**found.storage.metadata.get(CARD, {}), "scenarios": known}


def open_dataset(dataset: str | os.PathLike[str]) -> Any:
    """Minari's dataset of this id, or in this folder.

    Raises:
        MinariError: If it is missing, or cannot be read.
    """
    minari = find_minari()
    folder = Path(dataset).expanduser()
    data = folder / "data" if (folder / "data").is_dir() else folder
    try:
        if (data / "metadata.json").is_file():
            return minari.MinariDataset(data)
        return minari.load_dataset(str(dataset), download=False)
    except FileNotFoundError as error:
        root = os.environ.get("MINARI_DATASETS_PATH", "~/.minari/datasets")
        raise MinariError(
            f"dataset {dataset} is not in {root}; set MINARI_DATASETS_PATH, or give its folder"
        ) from error
    except (ImportError, ValueError, KeyError, AssertionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MinariError(f"dataset {dataset} cannot be read: {reason}") from error


def _check_spec(spec: TensorSpec, space: Any, name: str) -> None:
    dtype = torch.from_numpy(np.empty(0, space.dtype)).dtype
    given = (tuple(space.shape), dtype)
    wanted = (tuple(spec.shape), spec.dtype)
    for what, theirs, ours in zip(("shape", "dtype"), given, wanted):
        if theirs != ours:
            raise MinariError(
                f"{name} has {what} {theirs} in the dataset and {ours} in the environment"
            )
    if isinstance(spec, Bounded):
        for what, edge, expected in (
            ("lower", space.low, spec.space.low),
            ("upper", space.high, spec.space.high),
        ):
            wanted_edge = expected.expand(spec.shape).numpy(force=True)
            if not np.allclose(edge, wanted_edge):
                raise MinariError(
                    f"{name} has the {what} bound {edge.tolist()} in the dataset and "
                    f"{wanted_edge.tolist()} in the environment"
                )


def _transitions(episode: Any, dataset: Any, where: str) -> TensorDict:
    count = len(episode.rewards)
    observations = _tensor(episode.observations, dataset.observation_space)
    action = _tensor(episode.actions, dataset.action_space)
    for name, values, length in (
        ("observations", observations, count + 1),
        ("actions", action, count),
        ("terminations", episode.terminations, count),
        ("truncations", episode.truncations, count),
    ):
        if len(values) != length:
            raise MinariError(f"{where}: {name} has {len(values)} entries, not {length}")
    infos = _infos(episode.infos or {}, count, where)
    terminated = _column(episode.terminations).bool()
    truncated = _column(episode.truncations).bool() & ~infos.pop("cut", torch.tensor(False))
    after = {
        "observation": observations[1:],
        "reward": _column(episode.rewards).float(),
        "done": terminated | truncated,
        "terminated": terminated,
        "truncated": truncated,
        **{key: infos.pop(key) for key in OUTCOMES if key in infos},
    }
    if not infos:  # demonstrations
        start = torch.zeros(count, 1, dtype=torch.bool)
        start[:1] = True
        who: Sequence[torch.Tensor] = (action, action, torch.ones_like(start), start)
        infos = dict(zip(WHO_DROVE, who))
    for key in ("action_agent", "action_mentor"):
        if infos[key].shape != action.shape:
            raise MinariError(
                f"{where}: {key} has shape {tuple(infos[key].shape)}, and the actions have "
                f"{tuple(action.shape)}"
            )
    root = {"observation": observations[:-1], "action": action, **infos}
    return TensorDict({**root, "next": TensorDict(after, batch_size=[count])}, batch_size=[count])


def _infos(infos: dict[str, Any], count: int, where: str) -> dict[str, torch.Tensor]:
    """The infos that are known here, one entry for each step; empty where nobody says who drove."""
    missing = [key for key in WHO_DROVE if key not in infos]
    if len(missing) == len(WHO_DROVE):
        return {}
    if missing:
        raise MinariError(f"{where}: infos hold no {missing[0]}, which the others need")
    known: dict[str, torch.Tensor] = {}
    for key in (*WHO_DROVE, *OUTCOMES, "cut"):
        if key not in infos:
            continue
        values = np.asarray(infos[key])
        if len(values) not in (count, count + 1):
            raise MinariError(f"{where}: info {key} has {len(values)} entries, not {count + 1}")
        tensor = torch.from_numpy(values[-count:].copy())
        known[key] = tensor if key.startswith("action") else tensor.reshape(count, 1)
        if key in ("intervention", "takeover_start", "success", "cut"):
            known[key] = known[key].bool()
    return known


def _tensor(values: Any, space: Any) -> torch.Tensor:
    return torch.from_numpy(np.array(values, dtype=space.dtype))


def _column(values: Any) -> torch.Tensor:
    return torch.from_numpy(np.array(values)).reshape(-1, 1)
