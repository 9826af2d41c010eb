"""Loss modules, one per term of HAIM-DRL, and the formulas that they stand on."""

from haim_torchrl.objectives.actor import ActorLoss, WeightedCritic
from haim_torchrl.objectives.anchor import CloningAnchorLoss
from haim_torchrl.objectives.composite import HAIMLoss
from haim_torchrl.objectives.conservative import ConservativeQLoss
from haim_torchrl.objectives.cost import (
    CostCriticLoss,
    ExplicitInterventionLoss,
    ImplicitInterventionLoss,
)
from haim_torchrl.objectives.ensemble_cloning import EnsembleCloningLoss
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.lagrange import LagrangeMultiplier
from haim_torchrl.objectives.optimization import (
    NonFiniteLossError,
    UpdateStep,
    check_finite,
    make_optimizer,
)
from haim_torchrl.objectives.preference import (
    BoundedPreferenceLoss,
    ConservativePreferenceLoss,
    LinearPreferenceLoss,
    PreferenceTerm,
)
from haim_torchrl.objectives.proxy import ProxyQLoss
from haim_torchrl.objectives.sac_lagrangian import SACLagrangianLoss
from haim_torchrl.objectives.target import TargetUpdater
from haim_torchrl.objectives.temperature import TemperatureLoss
from haim_torchrl.objectives.temporal_difference import TemporalDifferenceTerm
from haim_torchrl.objectives.term import CriticTerm, LossTerm, PolicyTerm

__all__ = [
    "ActorLoss",
    "BoundedPreferenceLoss",
    "CloningAnchorLoss",
    "ConservativePreferenceLoss",
    "ConservativeQLoss",
    "CostCriticLoss",
    "CriticTerm",
    "EnsembleCloningLoss",
    "ExplicitInterventionLoss",
    "ForwardPass",
    "HAIMLoss",
    "ImplicitInterventionLoss",
    "LagrangeMultiplier",
    "LinearPreferenceLoss",
    "LossTerm",
    "NonFiniteLossError",
    "PolicyTerm",
    "PreferenceTerm",
    "ProxyQLoss",
    "SACLagrangianLoss",
    "TargetUpdater",
    "TemperatureLoss",
    "TemporalDifferenceTerm",
    "UpdateStep",
    "WeightedCritic",
    "check_finite",
    "make_optimizer",
]
