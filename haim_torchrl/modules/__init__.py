"""Networks of the agent: the policy, the critics, the entropy temperature."""

from haim_torchrl.modules.actor import ActorMLP, make_actor
from haim_torchrl.modules.average import PolicyAverage
from haim_torchrl.modules.critic import EnsembleLayerNorm, EnsembleMLP, make_critic
from haim_torchrl.modules.encoder import (
    ImageEncoder,
    encoder_of,
    make_image_actor,
    make_image_critic,
    share_encoder,
)
from haim_torchrl.modules.temperature import Temperature, as_temperature

__all__ = [
    "ActorMLP",
    "EnsembleLayerNorm",
    "EnsembleMLP",
    "ImageEncoder",
    "PolicyAverage",
    "Temperature",
    "as_temperature",
    "encoder_of",
    "make_actor",
    "make_critic",
    "make_image_actor",
    "make_image_critic",
    "share_encoder",
]
