"""Learners that drive, learn from what they drove, and forget it: the baselines with a reward.

PPO with reward shaping, PPO with a Lagrange multiplier, CPO and GAIL, on TorchRL's losses and
advantages where it has them.
"""

from haim_torchrl.objectives.on_policy.cpo import CPOLearner
from haim_torchrl.objectives.on_policy.divergence import PolicyDivergenceLoss
from haim_torchrl.objectives.on_policy.gail import GAILLearner
from haim_torchrl.objectives.on_policy.learner import JointLoss, OnPolicyLearner
from haim_torchrl.objectives.on_policy.ppo import PPOLearner, ProximalLearner
from haim_torchrl.objectives.on_policy.ppo_lagrangian import PPOLagrangianLearner
from haim_torchrl.objectives.on_policy.value import StateValueLoss

__all__ = [
    "CPOLearner",
    "GAILLearner",
    "JointLoss",
    "OnPolicyLearner",
    "PPOLagrangianLearner",
    "PPOLearner",
    "PolicyDivergenceLoss",
    "ProximalLearner",
    "StateValueLoss",
]
