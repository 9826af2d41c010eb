"""HAIM-DRL's objective: named terms, evaluated on one forward pass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, cast

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import dispatch
from torch import nn
from torchrl.envs.utils import ExplorationType
from torchrl.objectives import LossModule, ValueEstimators

from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.target import TargetUpdater
from haim_torchrl.objectives.temporal_difference import TemporalDifferenceTerm
from haim_torchrl.objectives.term import LossTerm


class HAIMLoss(LossModule):
    """The sum of named terms (eq 15), with everything that they share computed once.

    The terms decide what the method is: all of them are HAIM-DRL, without the implicit one it is
    HACO, with the bounded preference and without both interventions PVP. There is no switch in
    here: a term left out is absent. Each loss reaches its own parameters only, so one backward
    pass of the sum of all entries ``loss_*`` serves all.

    Args:
        terms: the terms by name, in the order of evaluation.

    Raises:
        ValueError: if there is no term, two terms write the same entry, or the terms follow
            different actors.

    Examples:
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> from haim_torchrl.objectives import ActorLoss, LinearPreferenceLoss, ProxyQLoss
        >>> actor, critic = make_actor(3, 2), make_critic(3, 2)
        >>> loss = HAIMLoss(
        ...     {
        ...         "proxy": ProxyQLoss(actor, critic, 0.1),
        ...         "preference": LinearPreferenceLoss(critic),
        ...         "actor": ActorLoss(actor, {"proxy": (critic, 1.0, "min")}, 0.1),
        ...     }
        ... )
        >>> [key for key in loss.out_keys if key.startswith("loss_")]
        ['loss_proxy_q', 'loss_preference', 'loss_actor']
    """

    deterministic_sampling_mode = ExplorationType.RANDOM
    default_value_estimator = ValueEstimators.TD0

    def __init__(self, terms: Mapping[str, LossTerm]) -> None:
        super().__init__()
        if not terms:
            raise ValueError("terms must name at least one loss term.")
        written: dict[str, str] = {}
        for name, term in terms.items():
            for key in term.out_keys:
                if key in written:
                    raise ValueError(
                        f"The terms {written[key]!r} and {name!r} both write {key!r}; give one of "
                        "them another label."
                    )
                written[str(key)] = name
        actors = {id(t.actor_network): n for n, t in terms.items() if hasattr(t, "actor_network")}
        if len(actors) > 1:
            raise ValueError(
                f"The terms {' and '.join(map(repr, actors.values()))} follow different actors; "
                "hand the same actor to all of them."
            )
        self.terms = nn.ModuleDict(terms)
        self._in_keys: list[NestedKey] | None = None
        self._out_keys: list[NestedKey] | None = None

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes all losses of a batch.

        Args:
            tensordict: a batch of transitions.

        Returns:
            The losses ``loss_*`` and the diagnostics of all terms.
        """
        batch = ForwardPass(tensordict)
        result = TensorDict()
        for _, term in self.named_terms():
            result.update(term.compute(batch))
        self._clear_weakrefs(tensordict, result)
        return result

    def named_terms(self) -> Iterator[tuple[str, LossTerm]]:
        """The terms with their names, in the order of evaluation."""
        return cast(Iterator[tuple[str, LossTerm]], iter(self.terms.items()))

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries of the batch that the terms read, each once."""
        if self._in_keys is not None:
            return self._in_keys
        # Not kept: a term's keys may be set at any time.
        return list(dict.fromkeys(key for _, term in self.named_terms() for key in term.in_keys))

    @in_keys.setter
    def in_keys(self, keys: list[NestedKey]) -> None:
        self._in_keys = keys

    @property
    def out_keys(self) -> list[NestedKey]:
        """Entries of the result."""
        if self._out_keys is None:
            self._out_keys = [key for _, term in self.named_terms() for key in term.out_keys]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, keys: list[NestedKey]) -> None:
        self._out_keys = keys

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """Renames entries in every term that knows them.

        Args:
            **kwargs: role of an entry, as in the terms' ``set_keys``, and its new name; ``None``
                is the default name.

        Raises:
            ValueError: if no term knows a role.
        """
        roles = {n: {f.name for f in fields(t._AcceptedKeys)} for n, t in self.named_terms()}
        for role, key in kwargs.items():
            readers = [name for name, known in roles.items() if role in known]
            if not readers:
                accepted = sorted({role for known in roles.values() for role in known})
                raise ValueError(
                    f"{role} is not an accepted tensordict key of any term; accepted are "
                    f"{accepted}."
                )
            for name in readers:
                cast(LossTerm, self.terms[name]).set_keys(**{role: key})
        self._in_keys = None

    def make_value_estimator(
        self, value_type: ValueEstimators | str | None = None, **hyperparams: Any
    ) -> HAIMLoss:
        """Sets the discount factor of every critic.

        Args:
            value_type: only ``ValueEstimators.TD0``.
            **hyperparams: ``gamma``, in [0, 1].

        Returns:
            This loss.
        """
        for _, term in self.named_terms():
            if isinstance(term, TemporalDifferenceTerm):
                term.make_value_estimator(value_type, **hyperparams)
        return self

    def make_target_updater(self, tau: float = 0.005) -> TargetUpdater:
        """Makes the updater of all critics' targets.

        Args:
            tau: share of the online parameters that each step mixes into the targets.

        Returns:
            The updater.
        """
        return TargetUpdater(self, tau)

    def parameter_groups(
        self, lr: float = 1e-4, **overrides: Mapping[str, Any]
    ) -> list[dict[str, Any]]:
        """Groups the trained parameters by role, for an optimiser.

        Args:
            lr: learning rate (1e-4 in the paper).
            **overrides: by role (``actor``, ``critic``, ``temperature``), options that differ.

        Returns:
            Parameter groups, each parameter once, with the role as ``name``.

        Raises:
            ValueError: if an override names a role that no term has.
        """
        groups: dict[str, dict[int, nn.Parameter]] = {}
        for _, term in self.named_terms():
            group = groups.setdefault(term.role, {})
            group.update((id(p), p) for p in term.trained_parameters())
        unknown = sorted(set(overrides) - set(groups))
        if unknown:
            raise ValueError(f"No term has the role {unknown[0]!r}; roles are {sorted(groups)}.")
        return [
            {"params": list(group.values()), "name": role, "lr": lr, **overrides.get(role, {})}
            for role, group in groups.items()
        ]

    def reset_parameters_recursive(self) -> None:
        """Draws the parameters of all terms anew."""
        for _, term in self.named_terms():
            term.reset_parameters_recursive()
        for _, term in self.named_terms():
            term.synchronise_targets()

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        self._in_keys = None


def losses_of(result: TensorDictBase) -> Sequence[str]:
    """Names of the entries of a result that are losses."""
    return [name for name in map(str, result.keys()) if name.startswith("loss_")]
