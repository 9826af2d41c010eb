"""The optional Python client of CARLA, imported where it is first needed."""

from __future__ import annotations

from types import ModuleType


def carla_package() -> ModuleType:
    """The module ``carla``.

    Raises:
        RuntimeError: if it is not installed.
    """
    try:
        import carla
    except ImportError as error:
        raise RuntimeError(
            "env=carla needs CARLA's Python client, which is not installed here; "
            'pip install "haim-torchrl[carla]" (Python 3.10 to 3.12)'
        ) from error
    return carla
