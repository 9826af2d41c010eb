"""A ring of transitions in preallocated tensors, fast to append to and to gather from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor

Columns = Mapping[NestedKey, Tensor]


class TransitionStore:
    """Keeps the latest ``capacity`` transitions.

    One tensor per entry, allocated at the first transition and never moved. Rows are gathered
    with ``index_select``, which costs a fraction of what indexing a tensordict costs.

    Args:
        capacity: number of transitions that fit.
        device: where to keep them.

    Raises:
        ValueError: if the capacity is not positive.
    """

    def __init__(self, capacity: int, *, device: torch.device | str = "cpu") -> None:
        if capacity < 1:
            raise ValueError(f"capacity must be at least 1 transition, got {capacity}.")
        self.capacity = capacity
        self.device = torch.device(device)
        self._columns: dict[NestedKey, Tensor] = {}
        self._size = 0
        self._cursor = 0

    def __len__(self) -> int:
        return self._size

    @property
    def nbytes(self) -> int:
        """Bytes of the rows written so far."""
        return sum(column[: self._size].nbytes for column in self._columns.values())

    def extend(self, rows: Columns) -> None:
        """Appends transitions; the oldest ones give way.

        Args:
            rows: for each entry a tensor ``[N, ...]``.

        Raises:
            ValueError: if an entry has not the shape of its earlier rows.
        """
        count = min(len(next(iter(rows.values()))), self.capacity)
        if count == 0:
            return
        if not self._columns:
            self._columns = {key: self._allocate(value) for key, value in rows.items()}
        positions = torch.arange(self._cursor, self._cursor + count, device=self.device)
        positions %= self.capacity
        for key, column in self._columns.items():
            value = rows[key][-count:].to(self.device, column.dtype)
            if value.shape[1:] != column.shape[1:]:
                raise ValueError(
                    f"The entry {key!r} has shape {tuple(value.shape[1:])} per transition, but "
                    f"the replay holds {tuple(column.shape[1:])}; do not mix environments."
                )
            column.index_copy_(0, positions, value)
        self._cursor = (self._cursor + count) % self.capacity
        self._size = min(self._size + count, self.capacity)

    def gather(self, key: NestedKey, rows: Tensor, out: Tensor) -> None:
        """Copies rows of one entry.

        Args:
            key: the entry.
            rows: indices below ``len(self)``, ``[n]``.
            out: where to, ``[n, ...]``.
        """
        torch.index_select(self._columns[key], 0, rows, out=out)

    def columns(self) -> Columns:
        """The rows written so far, in the order of the ring, without copying."""
        return {key: column[: self._size] for key, column in self._columns.items()}

    def clear(self) -> None:
        """Forgets all transitions and gives their memory back."""
        self._columns, self._size, self._cursor = {}, 0, 0

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to go on: plain numbers, strings and tensors."""
        return {
            "capacity": self.capacity,
            "cursor": self._cursor,
            "columns": [(_path(k), column.clone()) for k, column in self.columns().items()],
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from a saved state.

        Args:
            state: result of :meth:`state_dict`.

        Raises:
            ValueError: if it comes from a store of another capacity.
        """
        if state["capacity"] != self.capacity:
            raise ValueError(
                f"The saved replay holds {state['capacity']} transitions, this one "
                f"{self.capacity}; set the same capacity to resume."
            )
        self.clear()
        for path, saved in state["columns"]:
            column = self._allocate(saved)
            column[: len(saved)].copy_(saved)
            self._columns[_key(path)] = column
            self._size = len(saved)
        self._cursor = int(state["cursor"])

    def _allocate(self, rows: Tensor) -> Tensor:
        # Untouched memory is not resident: an empty ring costs nothing.
        dtype = torch.float32 if rows.dtype == torch.float64 else rows.dtype
        return torch.empty(self.capacity, *rows.shape[1:], dtype=dtype, device=self.device)


def _path(key: NestedKey) -> list[str]:
    return [key] if isinstance(key, str) else list(key)


def _key(path: list[str]) -> NestedKey:
    return path[0] if len(path) == 1 else tuple(path)
