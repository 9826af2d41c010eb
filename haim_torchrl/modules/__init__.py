"""Networks of the agent: the policy, the critics, the entropy temperature."""

from haim_torchrl.modules.actor import ActorMLP, make_actor
from haim_torchrl.modules.average import PolicyAverage
from haim_torchrl.modules.critic import EnsembleLayerNorm, EnsembleMLP, make_critic
from haim_torchrl.modules.discriminator import make_discriminator
from haim_torchrl.modules.doubt import doubt_threshold, ensemble_doubt
from haim_torchrl.modules.encoder import (
    ImageEncoder,
    encoder_of,
    make_image_actor,
    make_image_critic,
    share_encoder,
)
from haim_torchrl.modules.ensemble import EnsembleActor, make_ensemble_actor
from haim_torchrl.modules.temperature import Temperature, as_temperature
from haim_torchrl.modules.value import make_value

__all__ = [
    "ActorMLP",
    "EnsembleActor",
    "EnsembleLayerNorm",
    "EnsembleMLP",
    "ImageEncoder",
    "PolicyAverage",
    "Temperature",
    "as_temperature",
    "doubt_threshold",
    "encoder_of",
    "ensemble_doubt",
    "make_actor",
    "make_critic",
    "make_discriminator",
    "make_ensemble_actor",
    "make_image_actor",
    "make_image_critic",
    "make_value",
    "share_encoder",
]
