"""Drives a recorded session again, step by step as it was."""

from __future__ import annotations

import os
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from haim_torchrl.data.session import (
    Session,
    SessionEpisode,
    SessionError,
    SessionStep,
    fingerprint,
    read_session,
    scenario_of,
)


class ReplayMentor:
    """The mentor of a recorded session, and its agent: both do again what they did.

    With :class:`~haim_torchrl.switches.RequestSwitch` (``switch=request``) the environment then
    yields the recorded transitions, whatever policy proposes and whatever it is trained with, so
    that losses can be compared on one person's driving without that person. Nothing is driven that
    was not recorded: where the simulator departs from the record a :class:`SessionError` says so.

    Before each reset the simulator's generator (gymnasium's ``np_random``) is put into its recorded
    state, which makes the episode the recorded one. A checkpoint keeps the position.

    Args:
        session: A session file, or the folder of a run that holds one. It is read at first use.
        exact: Whether the agent must see, bit by bit, what it saw in the record. Without, the
            scenario and the length of each episode must agree only: for an agent that observes
            something else, or another machine that rounds otherwise.
        observation_key: What the agent sees.

    Raises:
        SessionError: On first use if the session cannot be read, and at the step where the
            simulator departs from it, or it ends.
    """

    def __init__(
        self,
        session: str | os.PathLike[str],
        *,
        exact: bool = True,
        observation_key: NestedKey = "observation",
    ) -> None:
        self.path = session
        self.exact = exact
        self.observation_key = observation_key
        self._session: Session | None = None
        self._begun = 0  # episodes of the record that were begun again
        self._episode: SessionEpisode | None = None
        self._at = 0  # steps of the episode that were driven again
        self._step: SessionStep | None = None
        self._was_reset = True

    @property
    def session(self) -> Session:
        """The session, read at first use."""
        if self._session is None:
            self._session = read_session(self.path)
        return self._session

    @property
    def device_ok(self) -> bool:
        """Whether the mentor's device worked in the recorded step."""
        return self._step is None or self._step.device_ok

    @property
    def latency_ms(self) -> float | None:
        """Delay of the mentor's input in the recorded step [ms]."""
        return None if self._step is None else self._step.latency_ms

    def before_reset(self, simulator: Any) -> None:
        """Let the simulator draw the episode that comes next in the record."""
        episodes = self.session.episodes
        if self._begun < len(episodes):
            state = episodes[self._begun].random_state
            generator = getattr(simulator, "np_random", None)
            if state is not None and generator is not None:
                generator.bit_generator.state = state

    def reset(self, simulator: Any) -> None:
        """Begin the next recorded episode with the next step."""
        self._was_reset, self._step = True, None

    def proposal(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """What the agent proposed in the recorded step, ``[A]``."""
        if self._was_reset:
            self._begin_episode(simulator)
        episode = self._episode
        assert episode is not None
        if self._at == len(episode.steps):
            raise self._at_the_end(episode)
        step = episode.steps[self._at]
        if self.exact and step.observation is not None:
            seen = tensordict.get(self.observation_key, None)
            if seen is None or fingerprint(seen.numpy(force=True)) != step.observation:
                raise self._departs(
                    "the agent sees something else than it did",
                    "; mentor.exact=false is for other observations of the same episodes",
                )
        self._at += 1
        self._step = step
        return torch.tensor(step.action_agent, dtype=torch.float64)

    def requests_control(self, simulator: Any, action_agent: Tensor) -> bool:
        """Whether the mentor drove the recorded step."""
        return self._present().intervention

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """What the mentor did in the recorded step, ``[A]``."""
        step = self._present()
        if not step.intervention:
            raise SessionError(
                f"session {self.session.path}: the mentor did not drive step {step.step} of "
                f"episode {step.episode}, and what it would have done was not recorded; "
                "use switch=request, which asks the record who drove"
            )
        return torch.tensor(step.action_mentor, dtype=torch.float64)

    def get_state(self) -> dict[str, Any]:
        """How many episodes were begun."""
        return {"episodes": self._begun}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on with the episode that comes after them."""
        self._begun = int(state["episodes"])
        self._episode, self._was_reset = None, True

    def _present(self) -> SessionStep:
        if self._step is None:
            raise SessionError(
                "a session is driven again by an InterventionTransform only, which lets it "
                "propose the agent's actions, too"
            )
        return self._step

    def _begin_episode(self, simulator: Any) -> None:
        before = self._episode
        if before is not None and self._at < len(before.steps):
            raise self._departs("the episode ends here, and the record goes on")
        if self._begun == len(self.session.episodes):
            raise self._exhausted()
        self._episode = self.session.episodes[self._begun]
        self._begun += 1
        self._at, self._was_reset = 0, False
        scenario = scenario_of(simulator)
        if scenario != self._episode.scenario:
            raise self._departs(
                f"the simulator is in scenario {scenario}, and the record in "
                f"{self._episode.scenario}"
            )

    def _at_the_end(self, episode: SessionEpisode) -> SessionError:
        if episode.steps[-1].done:
            return self._departs("the episode goes on, and in the record it had ended")
        if self._begun == len(self.session.episodes):
            return self._exhausted()
        return self._departs(
            "the episode goes on, and the recorded run began another one here, as at a checkpoint"
        )

    def _exhausted(self) -> SessionError:
        return SessionError(
            f"session {self.session.path} ends after {len(self.session)} steps, and there is "
            "nothing more to drive again; use total_frames of at most that"
        )

    def _departs(self, reason: str, hint: str = "") -> SessionError:
        number = "?" if self._episode is None else self._episode.number
        return SessionError(
            f"session {self.session.path}, episode {number}, step {self._at}: {reason}; a session "
            "is driven again with the env, eval.train, collector and train.checkpoint_every that "
            f"stand in its header, and the same package versions{hint}"
        )
