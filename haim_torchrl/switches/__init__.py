"""When the mentor takes over: conditions on a step, their combinations, and timing."""

from haim_torchrl.switches.action import ActionSwitch
from haim_torchrl.switches.combine import (
    AllOf,
    Always,
    AnyOf,
    Delay,
    Hold,
    Never,
    RequestSwitch,
)
from haim_torchrl.switches.lapse import Lapse
from haim_torchrl.switches.probability import ProbabilitySwitch
from haim_torchrl.switches.protocol import (
    Forecast,
    Forecasting,
    Situation,
    Switch,
    SwitchFactory,
)
from haim_torchrl.switches.risk import RiskSwitch

__all__ = [
    "ActionSwitch",
    "AllOf",
    "Always",
    "AnyOf",
    "Delay",
    "Forecast",
    "Forecasting",
    "Hold",
    "Lapse",
    "Never",
    "ProbabilitySwitch",
    "RequestSwitch",
    "RiskSwitch",
    "Situation",
    "Switch",
    "SwitchFactory",
]
