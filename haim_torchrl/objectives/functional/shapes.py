"""The shape that the formulas ask for."""

from __future__ import annotations

from torch import Tensor


def check_scalar(name: str, tensor: Tensor) -> None:
    """Raise a ValueError unless the tensor holds one number per transition, ``[..., 1]``."""
    if tensor.ndim == 0 or tensor.shape[-1] != 1:
        raise ValueError(
            f"{name} must hold one number per transition, shape [..., 1], got "
            f"{tuple(tensor.shape)}; add the last dimension with .unsqueeze(-1)."
        )
