"""Python and its packages: versions, bounds, and two that exclude each other."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from collections.abc import Iterable
from importlib import metadata

from haim_torchrl.doctor.check import Check

PACKAGE = "haim-torchrl"
HEAVY = ("numpy", "torch", "tensordict", "torchrl", "numba", "highway_env")
"""Modules that other packages can break."""
OPTIONAL = (
    ("starlette", "mentor=browser", "haim-torchrl[browser]"),
    ("uvicorn", "mentor=browser", "haim-torchrl[browser]"),
    ("websockets", "mentor=browser", "haim-torchrl[browser]"),
    ("minari", "demonstrations in Minari's format", "minari"),
    ("metadrive-simulator", "env=metadrive", "haim-torchrl[metadrive]"),
    ("carla", "env=carla", "haim-torchrl[carla]"),
    ("ray", "collector=ray", "haim-torchrl[ray]"),
    ("hydra-submitit-launcher", "hydra/launcher=submitit_slurm", "haim-torchrl[submitit]"),
    ("wandb", "logger=wandb", "haim-torchrl[wandb]"),
    ("stable-baselines3", "the benchmark against it", "haim-torchrl[bench]"),
)
"""Distribution, what needs it, what to install."""


def python_version(required: str | None = None) -> Check:
    """Python is new enough.

    Args:
        required: such as ``">=3.10"``; what this package asks for if None.
    """
    from packaging.specifiers import SpecifierSet

    if required is None:
        known = version_of(PACKAGE) is not None
        required = str(metadata.metadata(PACKAGE)["Requires-Python"]) if known else ""
    version = platform.python_version()
    if not SpecifierSet(required).contains(version, prereleases=True):
        detail = f"{version} ({sys.executable}); {required} is needed"
        return Check("python", "fail", detail, f"make a virtual environment of Python {required}")
    return Check("python", "ok", f"{version} ({sys.executable})")


def version_of(distribution: str) -> str | None:
    """The installed version; None if it is not installed."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def required_packages(requirements: Iterable[str] | None = None) -> list[Check]:
    """Each package that is needed is there, in a version that was tested.

    Args:
        requirements: such as ``"torch>=2.7"``; those of this package if None.
    """
    if requirements is None:
        if version_of(PACKAGE) is None:
            return [Check(PACKAGE, "fail", "not installed", "pip install -e . in its folder")]
        requirements = metadata.requires(PACKAGE) or []
    return [check for text in requirements if (check := _requirement(text)) is not None]


def _requirement(text: str) -> Check | None:
    from packaging.requirements import Requirement

    wanted = Requirement(text)
    if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
        return None
    version, bounds = version_of(wanted.name), str(wanted.specifier)
    fix = f'pip install "{wanted.name}{bounds}"'
    if version is None:
        return Check(wanted.name, "fail", f"not installed; {bounds} is needed", fix)
    if not wanted.specifier.contains(version, prereleases=True):
        return Check(wanted.name, "fail", f"{version} is installed; {bounds} is needed", fix)
    return Check(wanted.name, "ok", f"{version} ({bounds})" if bounds else version)


def imports(modules: Iterable[str] = HEAVY) -> list[Check]:
    """Packages with compiled parts can be imported, which their versions do not tell.

    Args:
        modules: what to import.
    """
    found = []
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:  # half installed packages fail in many ways
            first = (str(error).splitlines() or [""])[0]
            detail = f"cannot be imported: {type(error).__name__}: {first}"
            fix = f"pip install --force-reinstall {module.replace('_', '-')}"
            found.append(Check(f"import {module}", "fail", detail, fix))
    names = ", ".join(modules)
    return found or [Check("imports", "ok", f"{names} can be imported")]


def optional_packages() -> list[Check]:
    """Which packages that only parts of the project need are there."""
    found = []
    for name, purpose, install in OPTIONAL:
        version = version_of(name)
        if version is None:
            lack = f"not installed; only {purpose} needs it"
            found.append(Check(name, "info", lack, f'pip install "{install}"'))
        else:
            found.append(Check(name, "ok", f"{version}, for {purpose}"))
    return found


def pygame() -> Check:
    """pygame and pygame-ce share a folder: the one installed last has overwritten the other."""
    names = ("pygame-ce", "pygame")
    versions = {name: version for name in names if (version := version_of(name)) is not None}
    if not versions:
        return Check("pygame", "fail", "not installed", "pip install pygame-ce")
    both = " and ".join(f"{name} {version}" for name, version in versions.items())
    mend = (
        "pip uninstall --yes pygame, then pip install --force-reinstall --no-deps pygame-ce; "
        "metadrive-simulator, which asks for pygame, is content with it"
    )
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        importlib.import_module("pygame.display")
    except Exception as error:  # half overwritten packages fail in many ways
        return Check("pygame", "fail", f"{both}: import fails ({error})", mend)
    if len(versions) > 1:
        detail = f"{both} are both installed and overwrite each other's files"
        return Check("pygame", "warn", detail, mend)
    return Check("pygame", "ok", both)
