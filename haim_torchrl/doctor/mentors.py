"""Which mentors could drive here now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PERSONS: Mapping[str, Mapping[str, Any]] = {
    "keyboard": {"_target_": "WindowConsole", "device": "keyboard"},
    "gamepad": {"_target_": "WindowConsole", "device": "gamepad"},
    "wheel": {"_target_": "WindowConsole", "device": "wheel"},
    "browser": {"_target_": "BrowserConsole", "host": "127.0.0.1", "port": 8765},
}
"""Console settings of the mentors who are persons, where there is no ``conf/``."""
MENTORS = (*PERSONS, "expert")


@dataclass(frozen=True)
class Row:
    """Whether a mentor could drive.

    Attributes:
        mentor: its name, as in ``mentor=wheel``.
        works: whether it could drive here now.
        why: why not; empty if it could.
        fix: what to do about it.
    """

    mentor: str
    works: bool
    why: str = ""
    fix: str = ""


def find_conf(start: Path | None = None) -> Path | None:
    """The folder of the settings: in the working folder, or beside the package.

    Args:
        start: working folder; the present one if None.
    """
    for root in (start or Path.cwd(), Path(__file__).parents[2]):
        if (root / "conf" / "base.yaml").is_file():
            return root.absolute() / "conf"
    return None


def settings_of(
    mentor: str, overrides: Sequence[str] = (), conf: Path | None = None
) -> Mapping[str, Any]:
    """The settings that a recipe would give a mentor.

    Args:
        mentor: its name, as in ``mentor=wheel``.
        overrides: further ones in Hydra's notation, such as ``mentor.console.port=9000``.
        conf: folder of the settings; without one, those of :data:`PERSONS`.
    """
    if conf is None:
        return {"console": PERSONS[mentor]} if mentor in PERSONS else {}
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    from haim_torchrl.evaluation.command import register

    register()
    with initialize_config_dir(str(conf), version_base="1.3"):
        config = compose("haim", [f"mentor={mentor}", *overrides])
    settings = OmegaConf.to_container(config.mentor, resolve=True)
    assert isinstance(settings, dict)
    return {str(key): value for key, value in settings.items()}


def page_address(overrides: Sequence[str] = (), conf: Path | None = None) -> tuple[str, int]:
    """Host and port of the page; the usual ones where the settings cannot be read.

    Args:
        overrides: further settings, in Hydra's notation.
        conf: folder of the settings, if there is one.
    """
    usual = PERSONS["browser"]
    try:
        console = settings_of("browser", overrides, conf)["console"]
    except Exception:  # said by check_mentor
        console = usual
    return str(console.get("host", usual["host"])), int(console.get("port", usual["port"]))


def check_mentor(mentor: str, overrides: Sequence[str] = (), conf: Path | None = None) -> Row:
    """Whether a mentor could drive here now; nothing stays open.

    Args:
        mentor: its name, as in ``mentor=wheel``.
        overrides: further settings, in Hydra's notation.
        conf: folder of the settings, if there is one.
    """
    try:
        from haim_torchrl.human.availability import Unavailable, check_console
        from haim_torchrl.mentors import Mentor
    except Exception as error:  # whatever breaks an import breaks every run
        return Row(mentor, False, _short(error), "mend the packages first; see above")
    try:
        settings = settings_of(mentor, overrides, conf)
    except Exception as error:  # Hydra's errors have many types
        return Row(
            mentor, False, _short(error), "mend the settings in conf/ or on the command line"
        )
    try:
        check_console(settings)
    except Unavailable as error:
        return Row(mentor, False, f"{error.setting}: {error.why}", error.fix)
    if "console" not in settings and "_target_" in settings:
        from hydra.utils import instantiate

        try:
            built = instantiate(dict(settings))
        except Exception as error:  # whatever a mentor's constructor raises
            return Row(mentor, False, _short(error), f"mend conf/mentor/{mentor}.yaml")
        if not isinstance(built, Mentor):
            target = settings["_target_"]
            return Row(mentor, False, f"{target} makes no mentor", f"see conf/mentor/{mentor}.yaml")
    return Row(mentor, True)


def _short(error: Exception) -> str:
    while error.__cause__ is not None and isinstance(error.__cause__, Exception):
        error = error.__cause__
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
