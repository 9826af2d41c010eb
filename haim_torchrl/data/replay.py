"""Replay of takeover data: intervened and free transitions apart, sampled half and half."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.data.store import TransitionStore

Sampling = Literal["balanced", "uniform"]

#: What the losses of this package read; of these, what the first batch has is stored.
TRANSITION_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "pixels",
    "state",
    "action",
    "action_agent",
    "action_mentor",
    "intervention",
    "takeover_start",
    ("next", "observation"),
    ("next", "pixels"),
    ("next", "state"),
    ("next", "terminated"),
    ("next", "takeover_cost"),
    ("next", "disturbance_cost"),
)

_FILE = "replay.pt"


class TakeoverReplayBuffer:
    """Stores transitions by who drove, and samples a fixed share of each kind.

    Takeovers become rare as the agent learns; sampled uniformly their share of a batch falls with
    them, and with it the only signal that there is. So a batch takes half of each kind while both
    exist, and everything from the one that exists otherwise (without it lane following was not
    learned in prototypes, with it, it was). ``"uniform"`` is the ablation.

    Sampling is with replacement from torch's global generator: the same seed gives the same
    batches. It has the interface of TorchRL's buffers as far as training needs it, but is not
    made of them: gathering 256 transitions of 540 numbers takes about half of their time.

    Args:
        capacity: transitions that fit in the store of free ones.
        batch_size: transitions per batch, unless ``sample`` is told otherwise.
        sampling: ``"balanced"`` or ``"uniform"`` (each kind in proportion to its number).
        share: share of intervened transitions in a balanced batch, in (0, 1).
        mentor_capacity: transitions that fit in the store of intervened ones; ``capacity`` by
            default.
        keys: entries to keep, such as ``loss.in_keys``; everything else is dropped.
            ``TRANSITION_KEYS`` by default.
        reflection: how transitions look in a mirror, if the world has a left-right symmetry.
        mirrored: share of a batch's transitions that are mirrored, in [0, 1]; needs a reflection.
            None: half of them, if there is one.
        intervention_key: entry that says who drove; None where nobody takes over, and all
            transitions are of one kind.
        device: where to keep the transitions.

    Raises:
        ValueError: if a size is not positive, the sampling unknown, a share out of range, or
            nobody said how the world looks in a mirror.

    Examples:
        >>> replay = TakeoverReplayBuffer(capacity=1000, batch_size=4)
        >>> flags = torch.tensor([[True], [False], [False], [False]])
        >>> replay.extend(
        ...     TensorDict(
        ...         {
        ...             "observation": torch.zeros(4, 3),
        ...             "intervention": flags,
        ...             "next": {"observation": torch.zeros(4, 3)},
        ...         },
        ...         batch_size=[4],
        ...     )
        ... )
        >>> replay.sample()["intervention"].sum().item()
        2
    """

    def __init__(
        self,
        capacity: int,
        batch_size: int = 256,
        *,
        sampling: Sampling = "balanced",
        share: float = 0.5,
        mentor_capacity: int | None = None,
        keys: Sequence[NestedKey] | None = None,
        reflection: Reflection | None = None,
        mirrored: float | None = 0.0,
        intervention_key: NestedKey | None = "intervention",
        device: torch.device | str = "cpu",
    ) -> None:
        if batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {batch_size}.")
        if sampling not in ("balanced", "uniform"):
            raise ValueError(f"sampling must be 'balanced' or 'uniform', got {sampling!r}.")
        if not 0.0 < share < 1.0:
            raise ValueError(f"share must lie in (0, 1), got {share}.")
        if mirrored is None:
            mirrored = 0.0 if reflection is None else 0.5
        if not 0.0 <= mirrored <= 1.0:
            raise ValueError(f"mirrored must lie in [0, 1], got {mirrored}.")
        if mirrored and reflection is None:
            raise ValueError(
                f"mirrored is {mirrored}, but this world does not say how it looks in a mirror; "
                "set it to 0."
            )
        self.batch_size = batch_size
        self.sampling = sampling
        self.share = share
        self.reflection = reflection
        self.mirrored = mirrored
        self.intervention_key = intervention_key
        self.free = TransitionStore(capacity, device=device)
        self.intervened = TransitionStore(
            capacity if mentor_capacity is None else mentor_capacity, device=device
        )
        self._wanted = None if keys is None else self._with_flag(keys)
        self._keys: list[NestedKey] = []
        self._shapes: dict[NestedKey, tuple[torch.Size, torch.dtype]] = {}

    def __len__(self) -> int:
        return len(self.free) + len(self.intervened)

    @property
    def nbytes(self) -> int:
        """Bytes of all stored transitions."""
        return self.free.nbytes + self.intervened.nbytes

    def extend(self, tensordict: TensorDictBase) -> None:
        """Stores a batch of transitions, each with those of its kind.

        Args:
            tensordict: transitions of any batch shape; it is flattened.

        Raises:
            KeyError: if an entry to keep is missing.
        """
        if not tensordict.numel():
            return
        flat = tensordict if tensordict.batch_dims == 1 else tensordict.reshape(-1)
        if not self._keys:
            self._keys = self._choose_keys(flat)
        rows = {key: self._read(flat, key) for key in self._keys}
        if self.intervention_key is None:
            self.free.extend(rows)
            return
        flags = rows[self.intervention_key].reshape(len(flat)).bool()
        for store, chosen in ((self.intervened, flags), (self.free, ~flags)):
            index = chosen.nonzero().squeeze(-1)
            if len(index) == len(flat):
                store.extend(rows)
            elif len(index):
                store.extend({key: value.index_select(0, index) for key, value in rows.items()})

    def add(self, tensordict: TensorDictBase) -> None:
        """Stores one transition.

        Args:
            tensordict: a transition without batch dimensions.
        """
        self.extend(tensordict.unsqueeze(0))

    def sample(self, batch_size: int | None = None) -> TensorDict:
        """Draws a batch.

        Args:
            batch_size: number of transitions B; as given to the constructor by default.

        Returns:
            Transitions, batch size ``[B]``, the intervened ones first.

        Raises:
            RuntimeError: if nothing has been stored yet.
        """
        size = self.batch_size if batch_size is None else batch_size
        if not len(self):
            raise RuntimeError("The replay is empty; store transitions before sampling.")
        mentor, free = self._draw(size)
        split = len(mentor)
        source = (self.intervened if len(self.intervened) else self.free).columns()
        batch: dict[str, Any] = {}
        for key, column in source.items():
            out = torch.empty(size, *column.shape[1:], dtype=column.dtype, device=column.device)
            if split:
                self.intervened.gather(key, mentor, out[:split])
            if split < size:
                self.free.gather(key, free, out[split:])
            _set(batch, key, out)
        drawn = TensorDict(batch, batch_size=[size], device=self.free.device)
        if self.reflection is not None and self.mirrored:
            self.reflection(drawn, self.mirrored)
        return drawn

    def empty(self) -> None:
        """Forgets all transitions."""
        self.free.clear()
        self.intervened.clear()
        self._keys = []

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to go on: plain numbers, strings and tensors."""
        return {"free": self.free.state_dict(), "intervened": self.intervened.state_dict()}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Goes on from a saved state.

        Args:
            state_dict: result of :meth:`state_dict`.
        """
        self.free.load_state_dict(state_dict["free"])
        self.intervened.load_state_dict(state_dict["intervened"])
        self._keys = list(self.free.columns() or self.intervened.columns())

    def dumps(self, path: str | Path) -> None:
        """Saves all transitions in a folder.

        Args:
            path: the folder; it is made if need be.
        """
        folder = Path(path)
        folder.mkdir(parents=True, exist_ok=True)
        torch.save(self.state_dict(), folder / _FILE)

    def loads(self, path: str | Path) -> None:
        """Goes on from what :meth:`dumps` saved.

        Args:
            path: the folder.

        Raises:
            FileNotFoundError: if the folder holds no replay.
        """
        file = Path(path) / _FILE
        if not file.is_file():
            raise FileNotFoundError(f"There is no replay in {str(path)!r}: {_FILE} is missing.")
        self.load_state_dict(torch.load(file, weights_only=True))

    def _draw(self, size: int) -> tuple[Tensor, Tensor]:
        """Rows of the intervened and of the free store that make up a batch."""
        mentor, free = len(self.intervened), len(self.free)
        device = self.free.device
        if self.sampling == "uniform":
            rows = torch.randint(mentor + free, (size,), device=device)
            return rows[rows < mentor], rows[rows >= mentor] - mentor
        split = int(size * self.share)
        split = 0 if not mentor else size if not free else split
        return (
            torch.randint(max(mentor, 1), (split,), device=device),
            torch.randint(max(free, 1), (size - split,), device=device),
        )

    def _choose_keys(self, tensordict: TensorDictBase) -> list[NestedKey]:
        if self._wanted is not None:
            return self._wanted
        present = set(tensordict.keys(True, True))
        chosen = [key for key in TRANSITION_KEYS if key in present]
        return self._with_flag(chosen)

    def _with_flag(self, keys: Sequence[NestedKey]) -> list[NestedKey]:
        flag = [] if self.intervention_key is None else [self.intervention_key]
        return list(dict.fromkeys([*keys, *flag]))

    def _read(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        value = tensordict.get(key, default=None)
        if value is None:
            raise KeyError(
                f"The replay keeps the entry {key!r}, which the transitions lack; they have "
                f"{sorted(map(str, tensordict.keys(True, True)))}."
            )
        return value


def _set(batch: dict[str, Any], key: NestedKey, value: Tensor) -> None:
    *path, name = (key,) if isinstance(key, str) else key
    for part in path:
        batch = batch.setdefault(part, {})
    batch[name] = value


def make_replay_buffer(
    capacity: int,
    batch_size: int = 256,
    *,
    sampling: Sampling = "balanced",
    share: float = 0.5,
    mentor_capacity: int | None = None,
    keys: Sequence[NestedKey] | None = None,
    reflection: Reflection | None = None,
    mirrored: float | None = 0.0,
    intervention_key: NestedKey | None = "intervention",
    device: torch.device | str = "cpu",
) -> TakeoverReplayBuffer:
    """Makes the replay buffer; see :class:`TakeoverReplayBuffer` for the arguments.

    Args:
        capacity: transitions that fit in the store of free ones.
        batch_size: transitions per batch.
        sampling: ``"balanced"`` or ``"uniform"``.
        share: share of intervened transitions in a balanced batch.
        mentor_capacity: transitions that fit in the store of intervened ones.
        keys: entries to keep.
        reflection: how transitions look in a mirror.
        mirrored: share of a batch's transitions that are mirrored; None: half, where possible.
        intervention_key: entry that says who drove; None where nobody takes over.
        device: where to keep them.

    Returns:
        The buffer.
    """
    return TakeoverReplayBuffer(
        capacity,
        batch_size,
        sampling=sampling,
        share=share,
        mentor_capacity=mentor_capacity,
        keys=keys,
        reflection=reflection,
        mirrored=mirrored,
        intervention_key=intervention_key,
        device=device,
    )
