"""Which modules pytest looks through for examples: not those of an extra that is not installed."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("ray") else ["haim_torchrl/collectors/ray_workers.py"]
