"""A recorded session as a Minari dataset: driven again, with what the agent saw."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from tensordict import TensorDict
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.data.minari_format import OUTCOMES, WHO_DROVE, MinariError, Spaces
from haim_torchrl.data.minari_writer import DatasetEpisode, new_folder, write_dataset
from haim_torchrl.data.quality import Quality
from haim_torchrl.data.session import Session, SessionEpisode, read_session


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
    rewards, terminations, truncations, and :data:`~.minari_format.INFOS`. Nothing is written
    before all of it was driven (:func:`~.minari_writer.write_dataset`).

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
    new_folder(dataset_id)
    record = read_session(session)
    if not record.episodes:
        raise MinariError(f"session {record.path} holds no step, and a dataset needs one")
    env = _build(record, make_env, exact)
    try:
        spaces = Spaces.of(env)
        episodes = [
            DatasetEpisode(
                _drive(env, episode),
                episode.scenario,
                np.array([step.device_ok for step in episode.steps]),
            )
            for episode in record.episodes
        ]
    finally:
        env.close()
    card = _card(record, [episode.steps for episode in episodes])
    return write_dataset(
        dataset_id,
        episodes,
        spaces,
        card=card,
        algorithm_name=algorithm_name or _algorithm(record),
        description=description or _description(record, card["statistics"]),
        author=author,
        author_email=author_email,
    )


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


def _card(session: Session, driven: list[TensorDict]) -> dict[str, Any]:
    return {
        "statistics": Quality.of(driven).as_dict(),
        "seed": session.header["seed"],
        "started": session.header["started"],
        "settings": session.header["settings"],
        "versions": session.header["versions"],
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
