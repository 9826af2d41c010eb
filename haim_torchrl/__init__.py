"""Human as AI Mentor reinforcement learning (HAIM-DRL) as interchangeable TorchRL parts.

Importing the package loads nothing heavy: import the room that you need, such as
``haim_torchrl.traffic``, ``haim_torchrl.objectives`` or ``haim_torchrl.envs``.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
