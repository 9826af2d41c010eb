"""Switches made of switches, and the two constant ones."""

from __future__ import annotations

from haim_torchrl.switches.protocol import Situation, Switch


class Never:
    """The agent always controls: evaluation without a mentor."""

    memoryless = True

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """``False``."""
        return False


class Always:
    """The mentor always controls: evaluation of the mentor, and recording of demonstrations."""

    memoryless = True

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """``True``."""
        return True


class RequestSwitch:
    """The mentor controls when it asks to: a person who presses a key or turns the wheel."""

    memoryless = True

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """Whatever :meth:`RequestingMentor.requests_control` says."""
        request = getattr(situation.mentor, "requests_control", None)
        if request is None:
            raise TypeError(
                f"RequestSwitch needs a mentor with requests_control(simulator, action_agent), and "
                f"{type(situation.mentor).__name__} has none: use another switch."
            )
        return bool(request(situation.simulator, situation.action_agent))


def _is_memoryless(switch: Switch) -> bool:
    return bool(getattr(switch, "memoryless", False))


class _Combination:
    """Several switches, one decision.

    Members are asked in order. One whose answer can no longer matter is left out if it has no
    memory (attribute ``memoryless``), which saves a mentor's action; one with memory, such as
    :class:`Hold`, sees every step, or its count would be wrong.
    """

    _deciding: bool

    def __init__(self, *switches: Switch) -> None:
        if not switches:
            raise ValueError(f"{type(self).__name__} needs at least one switch.")
        for switch in switches:
            if not isinstance(switch, Switch):
                raise TypeError(
                    f"{type(self).__name__} combines switches, got {type(switch).__name__}."
                )
        self.switches = switches
        self._ordered = tuple((switch, _is_memoryless(switch)) for switch in switches)
        self.memoryless = all(memoryless for _, memoryless in self._ordered)

    def reset(self) -> None:
        """Reset every member."""
        for switch in self.switches:
            switch.reset()

    def __call__(self, situation: Situation) -> bool:
        decided = False
        for switch, memoryless in self._ordered:
            if decided and memoryless:
                continue
            if bool(switch(situation)) is self._deciding:
                decided = True
        return decided is self._deciding


class AnyOf(_Combination):
    """The mentor controls when at least one of the switches says so."""

    _deciding = True


class AllOf(_Combination):
    """The mentor controls only when all of the switches say so."""

    _deciding = False


class Hold:
    """Once given, control stays with the mentor for a least number of steps.

    The count starts at, and includes, the step on which ``switch`` last fired; each firing starts
    it anew. Counting from the last firing, not from the start of the takeover, keeps the mentor
    from handing back a situation that was dangerous a moment ago. ``Hold(switch, 1)`` is
    ``switch``.

    Args:
        switch: what triggers.
        steps: least number of steps of mentor control, the triggering one included.
    """

    memoryless = False

    def __init__(self, switch: Switch, steps: int = 5) -> None:
        if steps < 1:
            raise ValueError(f"steps is {steps}: Hold keeps control for at least 1 step.")
        self.switch = switch
        self.steps = int(steps)
        self._left = 0

    def reset(self) -> None:
        """Give control back and reset the trigger."""
        self.switch.reset()
        self._left = 0

    def __call__(self, situation: Situation) -> bool:
        """``True`` for ``steps`` steps from each firing on."""
        if self.switch(situation):
            self._left = self.steps
        if self._left == 0:
            return False
        self._left -= 1
        return True


class Delay:
    """Reaction time: control passes only after the trigger has persisted for some steps.

    ``switch`` must have fired on the ``steps`` steps before, without a break, and fire now. A
    danger that passes sooner is one that a person would not have reacted to. While the mentor
    controls there is nothing left to react to, so the delay applies to taking over only: control
    ends on the step on which ``switch`` falls silent (put :class:`Hold` around for more).
    ``Delay(switch, 0)`` is ``switch``.

    Args:
        switch: what triggers.
        steps: reaction time in environment steps (at 10 Hz, 5 are half a second).
    """

    memoryless = False

    def __init__(self, switch: Switch, steps: int = 5) -> None:
        if steps < 0:
            raise ValueError(f"steps is {steps}: a reaction time cannot be negative.")
        self.switch = switch
        self.steps = int(steps)
        self._fired = 0

    def reset(self) -> None:
        """Forget what was seen and reset the trigger."""
        self.switch.reset()
        self._fired = 0

    def __call__(self, situation: Situation) -> bool:
        """``True`` once ``switch`` has fired on more than ``steps`` steps in a row."""
        if not self.switch(situation):
            self._fired = 0
            return False
        self._fired += 1
        return self._fired > self.steps or situation.was_intervening
