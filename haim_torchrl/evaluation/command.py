"""How a recipe runs as a command: errors in one sentence, Ctrl-C that saves, its own folder."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from hydra.errors import HydraException, InstantiationException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from haim_torchrl.evaluation.checkpoint import CheckpointError
from haim_torchrl.evaluation.config import ConfigError

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130
"""Exit codes: settings that cannot work, a run that could not go on, Ctrl-C."""


class RunFailed(RuntimeError):
    """A run that cannot go on for a reason that the user can act on."""


def _first_sentence(error: BaseException) -> str:
    """What went wrong, on one line, from the innermost cause that says something."""
    causes: list[BaseException] = [error]
    while (deeper := causes[-1].__cause__) is not None:
        causes.append(deeper)
    chosen = causes[-1] if isinstance(error, InstantiationException) else error
    text = str(chosen.args[0]) if isinstance(chosen, KeyError) and chosen.args else str(chosen)
    kept = [
        line.strip()
        for line in text.splitlines()
        if line.strip() and not line.lstrip().startswith(("full_key:", "object_type="))
    ]
    sentence = " ".join(kept) or type(chosen).__name__
    if isinstance(error, InstantiationException) and "full_key:" in str(error):
        key = str(error).split("full_key:")[1].split()[0]
        sentence = f"{key}: {sentence}"
    return sentence


def run_command(main: Callable[[], Any], arguments: Sequence[str] | None = None) -> None:
    """Run a function decorated with ``hydra.main`` and end the process with its exit code.

    What the user can mend, such as an unknown key or a missing checkpoint, becomes one sentence on
    stderr and a non-zero exit code; anything else keeps its traceback, as a fault of the program.
    ``HYDRA_FULL_ERROR=1`` shows the traceback of everything.

    Args:
        main: The decorated function.
        arguments: Command line without the program's name; defaults to the process's own.
    """
    if arguments is not None:
        sys.argv = [sys.argv[0], *arguments]
    verbose = os.environ.get("HYDRA_FULL_ERROR") == "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then hands the exception on instead of printing.
    try:
        main()
    except (ConfigError, CheckpointError, HydraException, OmegaConfBaseException) as error:
        if verbose:
            raise
        _fail(error, BAD_INPUT)
    except (RunFailed, FileExistsError) as error:
        if verbose:
            raise
        _fail(error, FAILED)
    except KeyboardInterrupt:
        print("\ninterrupted; nothing was saved since the last checkpoint", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _fail(error: BaseException, code: int) -> None:
    print(f"error: {_first_sentence(error)}", file=sys.stderr)
    sys.exit(code)


class InterruptFlag:
    """Turns the first Ctrl-C into a wish that the loop grants when its state is whole.

    A second Ctrl-C stops at once.

    Example:
        >>> with InterruptFlag() as interrupt:
        ...     bool(interrupt)
        False
    """

    def __init__(self) -> None:
        self._wished = False
        self._former: Any = None

    def __bool__(self) -> bool:
        """Whether Ctrl-C was pressed."""
        return self._wished

    def __enter__(self) -> InterruptFlag:
        """Listen."""
        self._former = signal.getsignal(signal.SIGINT)
        signal.signal(signal.SIGINT, self._wish)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Listen no more."""
        signal.signal(signal.SIGINT, self._former)

    def _wish(self, number: int, frame: FrameType | None) -> None:
        if self._wished:
            raise KeyboardInterrupt
        self._wished = True
        print("\nstopping after this batch; press Ctrl-C again to stop at once", file=sys.stderr)


def run_folder(name: str, resume: str | None = None, root: str = "runs") -> str:
    """The folder of a run: a fresh one, or that of the run to resume.

    Args:
        name: Name of the run.
        resume: Run folder or checkpoint file to go on from, or None.
        root: Where runs are kept.

    Returns:
        ``runs/<name>/<date>_<time>``; a number is added while that folder exists, so that no run
        ever writes into another one's.
    """
    if resume:
        path = Path(resume)
        folder = path.parent if path.suffix == ".pt" else path
        return str(folder.parent if folder.name == "checkpoints" else folder)
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    base = Path(root) / name / stamp
    folder, number = base, 2
    while folder.exists():
        folder, number = base.with_name(f"{stamp}_{number}"), number + 1
    return str(folder)


def register_resolvers() -> None:
    """Make ``${run_folder:...}`` known to OmegaConf; its first answer holds for the process."""
    OmegaConf.register_new_resolver("run_folder", run_folder, use_cache=True, replace=True)
