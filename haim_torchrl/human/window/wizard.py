"""What a calibration asks for, and what it makes of the answers."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from typing import Literal

from haim_torchrl.human.window.axes import Mapping, Pedal, PedalButton, Steering

MOVED = 0.3
"""Least way of an axis that is being shown, of 2."""
STEADY, SECONDS = 0.03, 0.6
"""An axis that is held stays within this for so long [s]."""
PLACES = 4
"""Places, rounded to 0.05, that an axis passes when it is moved: one that speaks up for the first
time jumps, and shows two."""
SILENCE = 2.0
"""Time without a new button after which there is none to come [s]."""

Step = Literal["rest", "left", "right", "throttle", "throttle off", "brake", "brake off", "buttons"]
STEPS: tuple[Step, ...] = (
    "rest", "left", "right", "throttle", "throttle off", "brake", "brake off", "buttons",
)  # fmt: skip


class Wizard:
    """Asks for one movement after the other.

    Args:
        kind: pad or wheel.
    """

    def __init__(self, kind: Literal["gamepad", "wheel"]) -> None:
        self.kind = kind
        self._step = 0
        self._recent: deque[tuple[float, tuple[float, ...]]] = deque()
        self._places: list[set[int]] = []
        self._base: tuple[float, ...] = ()
        self._base_buttons: set[int] = set()
        self._since: float | None = None
        self._steering: tuple[int, float, float] = (0, -1.0, 0.0)
        self._right = 1.0
        self._ends: dict[str, tuple[int, float] | int] = {}
        self._pedals: dict[str, Pedal | PedalButton] = {}
        self._buttons: list[int] = []

    @property
    def prompt(self) -> str | None:
        """What to do now; None when all is known."""
        if self._step == len(STEPS):
            return None
        wheel = self.kind == "wheel"
        what = "the wheel" if wheel else "the left stick"
        pedals = ("throttle", "brake") if wheel else ("right trigger", "left trigger")
        return {
            "rest": f"Let go of everything; {what} straight.",
            "left": f"Turn {what} fully left and hold it.",
            "right": f"Turn {what} fully right and hold it.",
            "throttle": f"Press the {pedals[0]} fully and hold it.",
            "throttle off": f"Let go of the {pedals[0]}.",
            "brake": f"Press the {pedals[1]} fully and hold it.",
            "brake off": f"Let go of the {pedals[1]}.",
            "buttons": "Press each button or paddle that shall take over, one after the other.",
        }[STEPS[self._step]]

    @property
    def mapping(self) -> Mapping:
        """What was shown, when ``prompt`` is None."""
        axis, left, centre = self._steering
        return Mapping(
            self.kind,
            Steering(axis, left, centre, self._right),
            self._pedals["throttle"],
            self._pedals["brake"],
            tuple(self._buttons),
        )

    def feed(self, now: float, axes: Sequence[float], buttons: Collection[int]) -> None:
        """Look at the device.

        Args:
            now: time [s].
            axes: what the axes report.
            buttons: numbers of the buttons held.
        """
        if self.prompt is None:
            return
        values = tuple(axes)
        if self._since is None:
            self._begin(now, values, buttons)
        for places, value in zip(self._places, values):
            places.add(round(value / 0.05))
        self._recent.append((now, values))
        while len(self._recent) > 1 and now - self._recent[1][0] >= SECONDS:
            self._recent.popleft()
        if self._answer(STEPS[self._step], now, values, set(buttons)):
            self._step += 1
            self._begin(now, values, buttons)

    def _begin(self, now: float, values: tuple[float, ...], buttons: Collection[int]) -> None:
        self._since, self._base, self._base_buttons = now, values, set(buttons)
        self._places = [set() for _ in values]
        self._recent.clear()

    def _answer(self, step: Step, now: float, values: tuple[float, ...], buttons: set[int]) -> bool:
        if step == "rest":
            return all(self._steady(axis) for axis in range(len(values)))
        if step == "left":
            axis = self._moved(values, range(len(values)))
            if axis is not None:
                self._steering = (axis, values[axis], self._base[axis])
            return axis is not None
        if step == "right":
            axis, left, centre = self._steering
            self._right = values[axis]
            across = (self._right - centre) * (left - centre) < 0.0
            return across and abs(self._right - centre) > MOVED and self._steady(axis)
        if step == "buttons":
            return self._collect(now, buttons)
        name = step.split()[0]
        if step == name:
            return self._find_end(name, values, buttons)
        return self._find_rest(name, values, buttons)

    def _find_end(self, name: str, values: tuple[float, ...], buttons: set[int]) -> bool:
        """The pedal that is held; a button counts where no axis moves with it."""
        others = [axis for axis in range(len(values)) if axis != self._steering[0]]
        axis = self._moved(values, others)
        if axis is not None:
            self._ends[name] = (axis, values[axis])
            return True
        pressed = sorted(buttons - self._base_buttons)
        still = all(self._steady(a) and len(self._places[a]) < PLACES for a in others)
        if pressed and still:
            self._ends[name] = pressed[0]
        return bool(pressed) and still

    def _find_rest(self, name: str, values: tuple[float, ...], buttons: set[int]) -> bool:
        end = self._ends[name]
        if isinstance(end, int):
            self._pedals[name] = PedalButton(end)
            return end not in buttons
        axis, value = end
        if abs(values[axis] - value) < MOVED or not self._steady(axis):
            return False
        self._pedals[name] = Pedal(axis, values[axis], value)
        return True

    def _collect(self, now: float, buttons: set[int]) -> bool:
        new = [button for button in sorted(buttons) if button not in self._buttons]
        if new or buttons:
            self._buttons += new
            self._since = now
        return bool(self._buttons) and self._since is not None and now - self._since > SILENCE

    def _moved(self, values: tuple[float, ...], axes: Collection[int]) -> int | None:
        """The axis that was moved and is held now; the one farthest from where it was."""
        moved = [
            axis
            for axis in axes
            if abs(values[axis] - self._base[axis]) > MOVED and len(self._places[axis]) >= PLACES
        ]
        if not moved:
            return None
        axis = max(moved, key=lambda a: abs(values[a] - self._base[a]))
        return axis if self._steady(axis) else None

    def _steady(self, axis: int) -> bool:
        if self._recent[-1][0] - self._recent[0][0] < SECONDS:
            return False
        values = [values[axis] for _, values in self._recent]
        return max(values) - min(values) < STEADY
