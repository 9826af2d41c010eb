"""What the agent's braking costs the traffic behind it, step by step."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.tensor_specs import Binary, Composite, Unbounded
from torchrl.envs import Transform

from haim_torchrl.traffic import (
    HARD_BRAKE_THRESHOLD,
    DisturbanceReference,
    disturbance_cost,
    hard_brake,
    hard_brake_onset,
)
from haim_torchrl.transforms.keys import DisturbanceKeys


class DisturbanceTransform(Transform):
    r"""Charges the agent for hard braking by what the followers lose (C^IM, eq. 20 and 21).

    The cost is charged on the step on which a hard brake begins, :math:`a_t \le \lambda` and
    :math:`a_{t-1} > \lambda`: eq. 21 as printed fires when the brake is released. The followers
    are predicted from the state before that step. While the mentor drives flag and cost are zero,
    since the motion is then the mentor's and the agent must not pay for it.

    Reads the root ``speed``, ``follower_gaps``, ``follower_speeds`` and ``acceleration`` (of the
    last step), ``next.acceleration`` (measured over this step, m/s²) and, if it is there,
    ``next.intervention``: the transform goes after
    :class:`~haim_torchrl.transforms.InterventionTransform`. Writes under ``next``, zeros at a
    reset: ``disturbance [1]`` bool, ``disturbance_onset [1]`` bool, ``disturbance_cost [1]``.
    Any batch shape. A collision stops a vehicle without braking; the environment must report
    acceleration 0 in such a frame.

    Args:
        threshold: λ, m/s², negative.
        reference: what the predicted mean speed is compared with; see
            :func:`~haim_torchrl.traffic.disturbance_cost`.
        hold: for how long the prediction holds the measured acceleration, s; ``None`` is all of
            ``duration``, as in the paper.
        duration: horizon of the prediction, s.
        min_acceleration: the hardest braking the vehicle is capable of, m/s², to be told at once
            if it can never reach ``threshold``.
        literal_onset: use eq. 21 as printed.
        keys: names of the entries.
        options: passed on to :func:`~haim_torchrl.traffic.disturbance_cost` (``time_step``,
            ``model``, ``max_speed``).

    Raises:
        ValueError: ``threshold`` not negative or out of the vehicle's reach, or a bad option.
        KeyError: on first use, if the environment lacks an entry.
        RuntimeError: on first use, if it stands before the intervention transform.
    """

    def __init__(
        self,
        threshold: float = HARD_BRAKE_THRESHOLD,
        *,
        reference: DisturbanceReference = "counterfactual",
        hold: float | None = None,
        duration: float = 10.0,
        min_acceleration: float | None = None,
        literal_onset: bool = False,
        keys: DisturbanceKeys | None = None,
        **options: Any,
    ) -> None:
        keys = keys or DisturbanceKeys()
        super().__init__(in_keys=[], out_keys=list(keys.published))
        if min_acceleration is not None and min_acceleration > threshold:
            raise ValueError(
                f"threshold is {threshold} m/s², but the vehicle brakes with no more than "
                f"{min_acceleration} m/s²: no disturbance could ever be seen. Raise the threshold "
                "or widen the vehicle's acceleration range."
            )
        self.keys = keys
        self.threshold = float(threshold)
        self.literal_onset = literal_onset
        self.options = {"reference": reference, "hold": hold, "duration": duration, **options}
        # One prediction now: it names a bad option here instead of in the middle of training, and
        # the compiled loop is loaded before the first step has to wait for it.
        standing = torch.full((1,), 10.0)
        disturbance_cost(standing, standing, 10.0, 0.0, **self.options)
        hard_brake(standing, self.threshold)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``tensordict`` as it is: costs are charged while an environment steps."""
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.keys
        acceleration = next_tensordict.get(keys.acceleration)
        previous = tensordict.get(keys.acceleration)
        if min(acceleration.min().item(), previous.min().item()) <= self.threshold:
            hard, onset, cost = self._charge(tensordict, next_tensordict, acceleration, previous)
        else:  # nobody brakes: nearly every step
            hard = torch.zeros_like(acceleration, dtype=torch.bool)
            onset, cost = torch.zeros_like(hard), torch.zeros_like(acceleration)
        next_tensordict.set(keys.disturbance, hard)
        next_tensordict.set(keys.disturbance_onset, onset)
        next_tensordict.set(keys.disturbance_cost, cost)
        return next_tensordict

    def _charge(
        self,
        tensordict: TensorDictBase,
        next_tensordict: TensorDictBase,
        acceleration: Tensor,
        previous: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        keys = self.keys
        hard = hard_brake(acceleration, self.threshold)
        onset = hard_brake_onset(acceleration, previous, self.threshold, literal=self.literal_onset)
        flag = next_tensordict.get(keys.intervention, None)
        if flag is not None:
            hard, onset = hard & ~flag, onset & ~flag
        elif tensordict.get(keys.intervention, None) is not None:
            raise RuntimeError(
                "DisturbanceTransform stands before InterventionTransform and cannot see who "
                "drives: put it after."
            )
        cost = torch.zeros_like(acceleration)
        if onset.any():
            predicted = disturbance_cost(
                tensordict.get(keys.follower_gaps),
                tensordict.get(keys.follower_speeds),
                tensordict.get(keys.speed),
                acceleration,
                **self.options,
            )
            cost = torch.where(onset, predicted.to(cost.dtype), cost)
        return hard, onset, cost

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        keys = self.keys
        self._check_entries(tensordict_reset.keys(True, True))
        like = tensordict_reset.get(keys.acceleration)
        tensordict_reset.set(keys.disturbance, torch.zeros_like(like, dtype=torch.bool))
        tensordict_reset.set(keys.disturbance_onset, torch.zeros_like(like, dtype=torch.bool))
        tensordict_reset.set(keys.disturbance_cost, torch.zeros_like(like))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the three published entries, after a look whether those read are there."""
        keys = self.keys
        self._check_entries(observation_spec.keys(True, True))
        if observation_spec[keys.follower_gaps].shape[-1] < 1:
            raise ValueError("follower_gaps has no follower: there is nobody to disturb.")
        like = observation_spec[keys.acceleration]
        for key in (keys.disturbance, keys.disturbance_onset):
            observation_spec[key] = Binary(
                like.shape[-1], shape=like.shape, dtype=torch.bool, device=like.device
            )
        observation_spec[keys.disturbance_cost] = Unbounded(
            shape=like.shape, dtype=like.dtype, device=like.device
        )
        return observation_spec

    def _check_entries(self, present: Iterable[NestedKey]) -> None:
        missing = set(self.keys.read) - set(present)
        if missing:
            raise KeyError(
                f"the environment offers no {', '.join(sorted(map(str, missing)))}: "
                "DisturbanceTransform needs the AV's speed and acceleration and its followers' "
                "gaps and speeds; name them in DisturbanceKeys(...)."
            )
