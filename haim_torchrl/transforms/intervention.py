"""The mentor takes over: one decision before each step, one step, and a record of who drove."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data.tensor_specs import Binary, Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, Transform

from haim_torchrl.mentors.protocol import (
    Mentor,
    MentorFactory,
    ProposingMentor,
    StatefulMentor,
)
from haim_torchrl.objectives.functional import (
    constant_takeover_cost,
    distance_takeover_cost,
    takeover_cost,
)
from haim_torchrl.switches.protocol import Situation, Switch, SwitchFactory
from haim_torchrl.transforms.keys import InterventionKeys
from haim_torchrl.transforms.worker import simulator_of, worker_env

CostFunction: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Takeover cost of ``(action_agent [A], action_mentor [A], takeover_start [1])``, shape ``[1]``."""

_COSTS: dict[str, CostFunction] = {
    "cosine": takeover_cost,
    "constant": constant_takeover_cost,
    "distance": distance_takeover_cost,
}
_ROUNDING = 1e-5


class _Worker(NamedTuple):
    """What a transform holds on to in the process of its simulator."""

    simulator: Any
    mentor: Mentor
    proposing: ProposingMentor | None
    action_spec: TensorSpec
    low: list[float] | None
    high: list[float] | None


class Decision(NamedTuple):
    """Who controls a step, and with what.

    Attributes:
        agent: What the agent proposes, ``[A]``.
        mentor: What the mentor does, ``[A]``; zeros where it does not drive.
        executed: What the simulator executes, ``[A]``.
        intervening: Whether the mentor drives.
        starting: Whether a takeover starts.
    """

    agent: Tensor
    mentor: Tensor
    executed: Tensor
    intervening: bool
    starting: bool


class InterventionTransform(Transform):
    r"""Lets a mentor take over an environment's steps (the mixed behaviour policy of eq. 6).

    Before each step the switch decides who controls it; then the simulator steps once, with
    :math:`I a_{mentor} + (1 - I) a_{agent}`. (The paper's Algorithm 2 lets the agent act, asks the
    human and steps again: two steps for one transition.) The mentor is asked only when the switch
    wants to know its action or it is in control.

    The transform belongs to the side of the simulator, since mentors look at it: put it in the
    environment that a ``SerialEnv``, ``ParallelEnv`` or collector multiplies, not around them. Put
    ``ActionScaling`` before it, so that agent and mentor speak the same units, and
    :class:`~haim_torchrl.transforms.DisturbanceTransform` after it.

    Written under ``next``, zeros at a reset (names: ``keys``): ``action_agent [A]``,
    ``action_mentor [A]`` (zeros where not intervening), ``behavior_action [A]`` (executed),
    ``intervention [1]`` bool, ``takeover_start [1]`` bool, ``takeover_cost [1]``. The root
    ``action`` stays what the agent proposed;
    :class:`~haim_torchrl.transforms.TakeoverToTransition` makes the documented transition of it.
    ``intervention`` is a state entry too: a step reads the last step's flag from its input, which
    makes ``takeover_start`` exact through partial resets and worker processes.

    A :class:`~haim_torchrl.mentors.ProposingMentor` speaks for the agent, too: what it proposes
    takes the place of the action given, is what the switch sees, and is published as
    ``action_agent``. A :class:`~haim_torchrl.mentors.StatefulMentor` is kept in ``state_dict``.

    Args:
        mentor_factory: builds the mentor, in the process that steps the simulator.
        switch: decides who controls; a switch (copied, as it may have memory) or a factory.
        cost: C^EX, charged on the first step of a takeover only, because it was the action
            rejected there that led to it: ``"cosine"`` (eq. 23), ``"constant"`` (+1, the paper's
            ablation), ``"distance"`` (sees magnitudes, too), or a function of
            ``(action_agent, action_mentor, takeover_start)``.
        keys: names of the entries.
        simulator: finds the simulator in the base environment. By default the unwrapped gym
            environment, or the base environment itself if it wraps none.

    Raises:
        TypeError: a mentor instead of a factory, or something that is no switch.
        ValueError: unknown ``cost``.
        RuntimeError: on first use, if the environment has no single simulator.

    Examples:
        >>> from torchrl.envs import GymEnv, TransformedEnv
        >>> from haim_torchrl.mentors import FunctionMentor
        >>> from haim_torchrl.switches import Always
        >>> def mentor():
        ...     return FunctionMentor(lambda simulator, tensordict: [1.5])
        >>> env = TransformedEnv(GymEnv("Pendulum-v1"), InterventionTransform(mentor, Always()))
        >>> rollout = env.rollout(3)
        >>> rollout["next", "behavior_action"].squeeze(-1).tolist()
        [1.5, 1.5, 1.5]
        >>> rollout["next", "takeover_start"].squeeze(-1).tolist()
        [True, False, False]
    """

    invertible = True

    def __init__(
        self,
        mentor_factory: MentorFactory,
        switch: Switch | SwitchFactory,
        *,
        cost: Literal["cosine", "constant", "distance"] | CostFunction = "cosine",
        keys: InterventionKeys | None = None,
        simulator: Callable[[EnvBase], Any] | None = None,
    ) -> None:
        keys = keys or InterventionKeys()
        super().__init__(
            in_keys=[],
            out_keys=list(keys.published),
            in_keys_inv=[keys.action],
            out_keys_inv=[keys.action],
        )
        if not callable(mentor_factory) or _is_instance_of_mentor(mentor_factory):
            raise TypeError(
                f"mentor_factory is {type(mentor_factory).__name__}: give a function that builds "
                "the mentor (its class, or functools.partial), so that every environment has one "
                "of its own and none has to travel between processes."
            )
        self.keys = keys
        self.mentor_factory = mentor_factory
        self.switch = _own_switch(switch)
        self.cost = _cost_function(cost)
        self.simulator = simulator or simulator_of
        self.random_state: dict[str, Any] | None = None
        """State of the simulator's generator before the present episode was drawn."""
        self._worker: _Worker | None = None
        self._decision: Decision | None = None

    @property
    def mentor(self) -> Mentor:
        """The mentor of this environment, built at first use."""
        return self._get_worker().mentor

    @property
    def decision(self) -> Decision | None:
        """Who controls the present step; None after a reset."""
        return self._decision

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``tensordict`` as it is: without an environment there is nobody to take over."""
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self._worker is None and self.parent is None:
            return tensordict  # in a replay buffer there is nobody to take over
        worker, keys = self._worker or self._get_worker(), self.keys
        flag = tensordict.get(keys.intervention, None)
        if flag is None:
            raise KeyError(
                f"the input of env.step has no entry {keys.intervention!r}, so it is unknown "
                "whether a takeover begins: step on from what reset() and step_mdp() return."
            )
        proposed = tensordict.get(keys.action)
        agent = proposed.detach().cpu()
        if worker.proposing is not None:
            agent = _read_proposal(worker, tensordict)
            tensordict.set(keys.action, agent.to(proposed.device))
        was_intervening = bool(flag)
        situation = Situation(
            worker.simulator,
            tensordict,
            agent,
            worker.mentor,
            was_intervening,
            self._read_mentor,
        )
        if self.switch(situation):
            mentor = executed = situation.mentor_action()
            tensordict.set(keys.action, mentor.to(proposed.device))
            self._decision = Decision(agent, mentor, executed, True, not was_intervening)
        else:
            self._decision = Decision(agent, torch.zeros_like(agent), agent, False, False)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        decision, keys = self._decision, self.keys
        assert decision is not None
        starting = torch.full((1,), decision.starting)
        if decision.starting:
            cost = self.cost(decision.agent, decision.mentor, starting).reshape(1)
        else:
            cost = torch.zeros(1)
        next_tensordict.set(keys.action_agent, decision.agent)
        next_tensordict.set(keys.action_mentor, decision.mentor)
        next_tensordict.set(keys.behavior_action, decision.executed)
        next_tensordict.set(keys.intervention, torch.full((1,), decision.intervening))
        next_tensordict.set(keys.takeover_start, starting)
        next_tensordict.set(keys.takeover_cost, cost)
        return next_tensordict

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase | None:
        tensordict = super()._reset_env_preprocess(tensordict)
        worker = self._worker or self._get_worker()
        if worker.proposing is not None:
            worker.proposing.before_reset(worker.simulator)
        generator = getattr(worker.simulator, "np_random", None)
        if isinstance(generator, np.random.Generator):
            self.random_state = dict(generator.bit_generator.state)
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        worker, keys = self._worker or self._get_worker(), self.keys
        worker.mentor.reset(worker.simulator)
        self.switch.reset()
        self._decision = None
        for key in (keys.action_agent, keys.action_mentor, keys.behavior_action):
            tensordict_reset.set(key, worker.action_spec.zero())
        for key in (keys.intervention, keys.takeover_start):
            tensordict_reset.set(key, torch.zeros(1, dtype=torch.bool))
        tensordict_reset.set(keys.takeover_cost, torch.zeros(1))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the six published entries."""
        keys, action_spec, device = self.keys, self._get_action_spec(), observation_spec.device
        for key in (keys.action_agent, keys.action_mentor, keys.behavior_action):
            # Unbounded: zeros at a reset need not be an action that the environment accepts.
            observation_spec[key] = Unbounded(
                shape=action_spec.shape, dtype=action_spec.dtype, device=device
            )
        for key in (keys.intervention, keys.takeover_start):
            observation_spec[key] = Binary(1, shape=(1,), dtype=torch.bool, device=device)
        observation_spec[keys.takeover_cost] = Unbounded(shape=(1,), device=device)
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Make the last step's flag an input of the step."""
        worker_env(self)
        state_spec[self.keys.intervention] = Binary(
            1, shape=(1,), dtype=torch.bool, device=state_spec.device
        )
        return state_spec

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, and say at once if it is one without a simulator."""
        super().set_container(container)
        self._worker = self._decision = None
        if isinstance(container, EnvBase):
            worker_env(self)

    def clone(self) -> InterventionTransform:
        """A transform like this one, without environment, mentor or memory."""
        twin = super().clone()
        twin._worker = twin._decision = None
        twin.switch = copy.deepcopy(self.switch)
        return twin

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_worker": None, "_decision": None}

    def _save_to_state_dict(
        self, destination: dict[str, Any], prefix: str, keep_vars: bool
    ) -> None:
        super()._save_to_state_dict(destination, prefix, keep_vars)
        if self._worker is not None and isinstance(self._worker.mentor, StatefulMentor):
            destination[f"{prefix}mentor"] = self._worker.mentor.get_state()

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        key = f"{prefix}mentor"
        if key in state_dict:
            mentor = self.mentor
            if isinstance(mentor, StatefulMentor):
                mentor.set_state(state_dict.pop(key))
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def _get_action_spec(self) -> TensorSpec:
        worker_env(self)
        specs = self.parent.full_action_spec
        if self.keys.action not in specs.keys(True, True):
            raise KeyError(
                f"the environment has no action {self.keys.action!r}, only "
                f"{list(specs.keys(True, True))}: name it in InterventionKeys(action=...)."
            )
        return specs[self.keys.action]

    def _get_worker(self) -> _Worker:
        if self._worker is None:
            mentor = self.mentor_factory()
            if not isinstance(mentor, Mentor):
                raise TypeError(
                    f"mentor_factory built {type(mentor).__name__}, which lacks reset(simulator) "
                    "or act(simulator, tensordict)."
                )
            spec = self._get_action_spec()
            low = high = None
            if isinstance(spec, Bounded):
                low = spec.space.low.expand(spec.shape).flatten().tolist()
                high = spec.space.high.expand(spec.shape).flatten().tolist()
            simulator = self.simulator(worker_env(self))
            proposing = mentor if isinstance(mentor, ProposingMentor) else None
            self._worker = _Worker(simulator, mentor, proposing, spec, low, high)
        return self._worker

    def _read_mentor(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The mentor's action, checked: a wrong one would enter the data as a demonstration."""
        worker = self._worker or self._get_worker()
        spec = worker.action_spec
        action = torch.as_tensor(worker.mentor.act(simulator, tensordict)).detach()
        action = action.to(device="cpu", dtype=spec.dtype, copy=True)
        if action.shape != spec.shape:
            raise ValueError(
                f"{type(worker.mentor).__name__}.act returned shape {tuple(action.shape)}, and "
                f"the action has shape {tuple(spec.shape)}."
            )
        values = action.flatten().tolist()
        if worker.low is None or worker.high is None:
            if not all(map(math.isfinite, values)):
                raise ValueError(f"{type(worker.mentor).__name__}.act returned {values}.")
            return action
        if not all(a <= x <= b for a, x, b in zip(worker.low, values, worker.high)):
            if not all(
                a - _ROUNDING <= x <= b + _ROUNDING
                for a, x, b in zip(worker.low, values, worker.high)
            ):
                raise ValueError(
                    f"{type(worker.mentor).__name__}.act returned {values}, outside "
                    f"{worker.low} to {worker.high}: a mentor acts in the agent's units."
                )
            action = torch.minimum(
                torch.maximum(action, torch.tensor(worker.low).view(spec.shape)),
                torch.tensor(worker.high).view(spec.shape),
            )
        return action


def _read_proposal(worker: _Worker, tensordict: TensorDictBase) -> Tensor:
    """What a proposing mentor says in the agent's place; as an agent's, its bounds are its own."""
    assert worker.proposing is not None
    action = torch.as_tensor(worker.proposing.proposal(worker.simulator, tensordict)).detach()
    spec = worker.action_spec
    if action.shape != spec.shape:
        raise ValueError(
            f"{type(worker.mentor).__name__}.proposal returned shape {tuple(action.shape)}, and "
            f"the action has shape {tuple(spec.shape)}."
        )
    return action.to(device="cpu", dtype=spec.dtype, copy=True)


def _is_instance_of_mentor(candidate: object) -> bool:
    return not isinstance(candidate, type) and isinstance(candidate, Mentor)


def _own_switch(switch: Switch | SwitchFactory) -> Switch:
    if not isinstance(switch, type) and isinstance(switch, Switch):
        return copy.deepcopy(switch)
    built = switch() if callable(switch) else switch
    if not isinstance(built, Switch):
        raise TypeError(
            f"switch is {type(built).__name__}: give a switch (with reset() and a call that takes "
            "a Situation) or a function that builds one."
        )
    return built


def _cost_function(cost: str | CostFunction) -> CostFunction:
    if callable(cost):
        return cost
    if cost not in _COSTS:
        raise ValueError(f"cost is {cost!r}: choose one of {sorted(_COSTS)}, or give a function.")
    return _COSTS[cost]
