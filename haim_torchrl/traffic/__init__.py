"""Car following, platoon prediction and the disturbance cost, as pure functions on tensors.

Everything takes and returns torch tensors in SI units, works for any batch shape, follows the
device of its inputs and keeps no state. Nothing here knows a simulator.
"""

from haim_torchrl.traffic.car_following import (
    CarFollowingModel,
    IDMParameters,
    OVMParameters,
    idm_acceleration,
    ovm_acceleration,
)
from haim_torchrl.traffic.disturbance import (
    HARD_BRAKE_THRESHOLD,
    DisturbanceReference,
    disturbance_cost,
    hard_brake,
    hard_brake_onset,
    mean_follower_speed,
)
from haim_torchrl.traffic.platoon import PlatoonTrajectory, rollout_platoon

__all__ = [
    "HARD_BRAKE_THRESHOLD",
    "CarFollowingModel",
    "DisturbanceReference",
    "IDMParameters",
    "OVMParameters",
    "PlatoonTrajectory",
    "disturbance_cost",
    "hard_brake",
    "hard_brake_onset",
    "idm_acceleration",
    "mean_follower_speed",
    "ovm_acceleration",
    "rollout_platoon",
]
