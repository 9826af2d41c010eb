"""Episodes as a Minari dataset, written whole or not at all."""

from __future__ import annotations

import dataclasses
import importlib
import shutil
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from haim_torchrl.data.minari_format import (
    CARD,
    INFOS,
    OUTCOMES,
    WHO_DROVE,
    MinariError,
    Spaces,
    check_ranges,
    find_minari,
)


@dataclasses.dataclass(frozen=True)
class DatasetEpisode:
    """One episode to write.

    Attributes:
        steps: Its transitions, ``[T]``, in the form of the replay: ``observation``, ``action``,
            :data:`WHO_DROVE`, and under ``next`` ``observation``, ``reward``, ``done``,
            ``terminated``, ``truncated`` and those of :data:`OUTCOMES` that there are.
        scenario: Seed of its scenario; None where the simulator has none.
        device_ok: Whether the mentor's input device worked, ``[T]``; None for machines.
    """

    steps: TensorDictBase
    scenario: int | None = None
    device_ok: np.ndarray | None = None


def write_dataset(
    dataset_id: str,
    episodes: Sequence[DatasetEpisode],
    spaces: Spaces,
    *,
    card: Mapping[str, Any],
    algorithm_name: str,
    description: str,
    author: str | None = None,
    author_email: str | None = None,
) -> Path:
    """Write a whole dataset, or nothing. Nothing is sent anywhere.

    The format is HDF5, Minari's default and that of most published datasets: one file, lossless,
    with h5py as the only further dependency.

    Args:
        dataset_id: ``name-v0`` or ``namespace/name-v0``. The dataset goes to the folder that
            ``MINARI_DATASETS_PATH`` names, by default ``~/.minari/datasets``.
        episodes: What it holds, at least one.
        spaces: What they were driven in.
        card: What Minari has no name for; ``versions`` become the requirements.
        algorithm_name: Who drove.
        description: What the data are.
        author: Left out if None.
        author_email: Left out if None.

    Returns:
        Its folder.

    Raises:
        MinariError: If minari is missing, the id is malformed or taken, or the data are not finite
            or out of range.
    """
    folder = new_folder(dataset_id)
    for number, episode in enumerate(episodes):
        where = f"episode {number} of dataset {dataset_id}"
        check_ranges(episode.steps, spaces.observation, spaces.action, where)
    held = [key for key in OUTCOMES if all(("next", key) in e.steps for e in episodes)]
    versions = card["versions"]
    infos = {k: v for k, v in INFOS.items() if k not in OUTCOMES or k in held}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about what is left out on purpose
            dataset = find_minari().create_dataset_from_buffers(
                dataset_id,
                [_buffer(episode) for episode in episodes],
                env=spaces.spec,
                observation_space=spaces.observation,
                action_space=spaces.action,
                algorithm_name=algorithm_name,
                author=author,
                author_email=author_email,
                description=description,
                requirements=[f"{n.replace('_', '-')}=={v}" for n, v in versions.items()],
                data_format="hdf5",
                jpeg_encoding=False,
            )
            dataset.storage.update_metadata({CARD: {**card, "infos": infos}})
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)  # which did not exist before
        raise
    return folder


def new_folder(dataset_id: str) -> Path:
    """The folder that a new dataset would have.

    Args:
        dataset_id: ``name-v0`` or ``namespace/name-v0``.

    Raises:
        MinariError: If minari is missing, or the id is malformed or taken.
    """
    find_minari()
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


def _buffer(episode: DatasetEpisode) -> Any:
    buffers = importlib.import_module("minari.data_collector")
    steps, after, count = episode.steps, episode.steps["next"], len(episode.steps)
    terminated = after["terminated"].squeeze(-1).numpy()
    truncated = after["truncated"].squeeze(-1).numpy().copy()
    cut = np.zeros(count, dtype=bool)
    cut[-1] = not (terminated[-1] or truncated[-1])
    infos = {key: steps[key].numpy() for key in WHO_DROVE}
    infos |= {key: after[key].numpy() for key in OUTCOMES if key in after}
    infos = {k: v if k.startswith("action") else v.reshape(count) for k, v in infos.items()}
    worked = np.ones(count, dtype=bool) if episode.device_ok is None else episode.device_ok
    infos["device_ok"] = worked
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
