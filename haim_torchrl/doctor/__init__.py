"""``python -m haim_torchrl.doctor``: what works here, what would fail, and how to mend it."""

from haim_torchrl.doctor.check import Check, Status, run_checks

__all__ = ["Check", "Status", "run_checks"]
