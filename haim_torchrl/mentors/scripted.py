"""A mentor made of one function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor


class FunctionMentor:
    """Turns a function of simulator and observation into a mentor without memory.

    Args:
        function: called with the unwrapped simulator and the root tensordict of the step; returns
            the action, shape ``[A]``, as a tensor, an array or a list.

    Examples:
        >>> import torch
        >>> mentor = FunctionMentor(lambda simulator, tensordict: [0.0, -1.0])
        >>> mentor.act(None, None)
        tensor([ 0., -1.])
    """

    def __init__(self, function: Callable[[Any, TensorDictBase], Any]) -> None:
        if not callable(function):
            raise TypeError(
                f"function is {type(function).__name__}: FunctionMentor wraps a function "
                "of (simulator, tensordict)."
            )
        self.function = function

    def reset(self, simulator: Any) -> None:
        """Nothing to forget."""

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """What the function returns, as a float tensor of shape ``[A]``."""
        return torch.as_tensor(
            self.function(simulator, tensordict), dtype=torch.get_default_dtype()
        )
