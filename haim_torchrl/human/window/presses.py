"""Keys and buttons over time: what is held, and what was touched too briefly to be seen."""

from __future__ import annotations

MEMORY = 0.25
"""How long a tap is remembered where no step is shown [s]."""


class Presses:
    """Which keys or buttons count as held.

    One that was pressed and released between two looks would be lost to a reader of states. Here
    it is held until a step that could have used it has been shown, so that it counts in one step,
    however often a step looks.
    """

    def __init__(self) -> None:
        self._down: set[int] = set()
        self._state: set[int] = set()
        self._taps: dict[int, float | None] = {}

    def press(self, code: int) -> None:
        """One was pressed."""
        self._down.add(code)
        self._taps[code] = None

    def release(self, code: int) -> None:
        """One was released."""
        self._down.discard(code)

    def release_all(self) -> None:
        """All are released, taps included: the device or the focus has gone."""
        self._down.clear()
        self._state.clear()
        self._taps.clear()

    def agree(self, state: set[int]) -> None:
        """Take over what the system says is held: an event may have gone to somebody else."""
        self._down -= self._state - state
        self._down |= state
        self._state = state

    def look(self, now: float) -> set[int]:
        """What counts as held.

        Args:
            now: time of the look [s].
        """
        for code, seen in list(self._taps.items()):
            if seen is None:
                self._taps[code] = now
            elif now - seen > MEMORY:
                del self._taps[code]
        return self._down | self._taps.keys()

    def shown(self) -> None:
        """A step has been shown: taps seen before it have had their effect."""
        self._taps = {code: seen for code, seen in self._taps.items() if seen is None}
