"""From what an environment publishes to the transition that is stored."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torchrl.data import Composite
from torchrl.envs import Transform

from haim_torchrl.transforms.keys import DisturbanceKeys, InterventionKeys

_NO_STEP = (
    "TakeoverToTransition needs finished steps, with an entry 'next': make it the postproc of a "
    "collector or a transform of a replay buffer, not of an environment."
)


class TakeoverToTransition(Transform):
    """Makes the documented transition of collected steps.

    An environment can publish who drove only under ``next``, and its root ``action`` stays what
    the agent proposed (see :mod:`haim_torchrl.transforms.keys`). Here the entries that belong to
    the action move beside it: ``action`` becomes what was executed, which is what a critic must
    learn from, and ``action_agent``, ``action_mentor``, ``intervention`` and ``takeover_start``
    come to the root. Costs stay under ``next``, as a reward does. Root copies of the last step's
    flags and costs are dropped: they would only be mistaken for this step's.

    Use it as ``postproc`` of a collector, as a transform of a replay buffer (it acts on
    ``extend``), or call it. A transition that already has this form passes unchanged, so using it
    twice does no harm. Any batch shape; the input is not modified.

    Args:
        keep: entries of the result to keep, e.g.
            :data:`~haim_torchrl.transforms.keys.REPLAY_KEYS`; ``None`` keeps all. Entries that the
            environment does not offer are passed over.
        keys: names of the entries of the intervention.
        disturbance_keys: names of the entries of the disturbance.

    Raises:
        KeyError: the data come from no environment with an intervention transform.
    """

    def __init__(
        self,
        keep: Sequence[NestedKey] | None = None,
        *,
        keys: InterventionKeys | None = None,
        disturbance_keys: DisturbanceKeys | None = None,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self.keys = keys or InterventionKeys()
        self.disturbance_keys = disturbance_keys or DisturbanceKeys()
        self.keep = None if keep is None else [unravel_key(key) for key in keep]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Transition form of ``tensordict``."""
        return self._inv_call(tensordict)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Refuses an environment, whose steps are not finished when they pass here."""
        raise RuntimeError(_NO_STEP)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.keys
        following = tensordict.get("next", None)
        if following is None:
            raise KeyError(_NO_STEP)
        executed = following.get(keys.behavior_action, None)
        if executed is not None:
            following = following.copy()
            result = tensordict.exclude(*keys.published, *self.disturbance_keys.published, "next")
            result.set(keys.action, executed)
            for key in (
                keys.action_agent,
                keys.action_mentor,
                keys.intervention,
                keys.takeover_start,
            ):
                result.set(key, following.get(key))
                del following[key]
            del following[keys.behavior_action]
            result.set("next", following)
        elif tensordict.get(keys.action_agent, None) is None:
            raise KeyError(
                f"no entry ('next', {keys.behavior_action!r}): these steps do not say who drove. "
                "Collect them from an environment with an InterventionTransform."
            )
        else:
            result = tensordict
        return result if self.keep is None else result.select(*self.keep, strict=False)
