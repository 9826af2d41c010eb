"""How a recipe runs as a command: errors in one sentence, Ctrl-C that saves, its own folder."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from haim_torchrl.collectors import ClusterError
from haim_torchrl.evaluation.checkpoint import CheckpointError, find_checkpoint
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.schema import register_schemas

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130
"""Exit codes: settings that cannot work, a run that could not go on, Ctrl-C."""

ERROR_FILE = "error.txt"
"""Where a run of a sweep leaves the sentence that it failed with."""


class RunFailed(RuntimeError):
    """A run that cannot go on for a reason that the user can act on."""


def _first_sentence(error: BaseException) -> str:
    """What went wrong, on one line: the error, and what caused it if that says more."""
    text = _one_line(error)
    cause = error.__cause__
    if isinstance(error, HydraException) and isinstance(cause, OmegaConfBaseException):
        text = f"{text.split(' To append to your config')[0].rstrip('.')}: {_one_line(cause)}"
    return text


def _one_line(error: BaseException) -> str:
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    details = ("full_key:", "object_type=", "reference_type=")
    lines = [line.strip() for line in text.splitlines()]
    line = " ".join(line for line in lines if line and not line.startswith(details))
    line = re.sub(r"^\w+ raised while resolving interpolation: ", "", line)
    return line or type(error).__name__


def run_command(main: Callable[[], Any]) -> None:
    """Run a function decorated with ``hydra.main`` as a command.

    What the user can mend, such as an unknown key or a missing checkpoint, becomes one sentence on
    stderr and a non-zero exit code; anything else keeps its traceback, as a fault of the program.
    ``HYDRA_FULL_ERROR=1`` shows the traceback of everything.

    Args:
        main: The decorated function.
    """
    verbose = os.environ.get("HYDRA_FULL_ERROR") == "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then hands the exception on instead of printing.
    with reporting(verbose):
        main()


@contextmanager
def reporting(verbose: bool | None = None, *, go_on: bool = False) -> Iterator[None]:
    """Turn errors that the user can mend into one sentence and an exit code.

    Also used inside a job, since Hydra announces each exception that leaves one.

    Args:
        verbose: Keep the tracebacks; by default as the user asked by ``HYDRA_FULL_ERROR=1``.
        go_on: Leave the sentence in the run's folder instead of exiting, as in a sweep whose other
            runs are to go on.
    """
    global _verbose
    if verbose is not None:
        _verbose = verbose
    try:
        yield
    except (ConfigError, CheckpointError, HydraException, OmegaConfBaseException) as error:
        if _verbose:
            raise
        _fail(error, BAD_INPUT, go_on)
    except (RunFailed, ClusterError, FileExistsError) as error:
        if _verbose:
            raise
        _fail(error, FAILED, go_on)
    except KeyboardInterrupt:
        print("\ninterrupted; what is not in the last checkpoint is lost", file=sys.stderr)
        sys.exit(INTERRUPTED)


_verbose = False


def _fail(error: BaseException, code: int, go_on: bool) -> None:
    settings = HydraConfig.instance().cfg
    sentence = _first_sentence(error)
    if settings is not None:
        folder = OmegaConf.select(settings, "hydra.runtime.output_dir")  # type: ignore[arg-type]
        if folder and go_on:
            Path(folder).mkdir(parents=True, exist_ok=True)
            (Path(folder) / ERROR_FILE).write_text(sentence + "\n")
        elif folder:
            _remove_if_empty(Path(folder))
    label = f"{name}: " if (name := job_label()) else ""
    print(f"{label}error: {sentence}", file=sys.stderr, flush=True)
    if not go_on:
        sys.exit(code)


def job_label() -> str:
    """What tells this run of a sweep from the others; empty outside of a sweep.

    Returns:
        The overrides of the run, such as ``method=haco,seed=1``.
    """
    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return ""
    return str(HydraConfig.get().job.override_dirname)


def _remove_if_empty(folder: Path) -> None:
    """Take back the folder that Hydra made for a run that never began."""
    for path in (folder, folder.parent):
        if path == Path.cwd():
            return
        try:
            path.rmdir()
        except OSError:
            return


def open_folder(config: DictConfig) -> Path:
    """The run's folder, with its settings in ``config.yaml``; a resumed run keeps its own."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (folder / "config.yaml").open("x") as stream:
            stream.write(OmegaConf.to_yaml(config))
    except FileExistsError:
        if not config.resume:
            raise FileExistsError(
                f"{folder} holds another run, and nothing is overwritten; choose another name"
            ) from None
    return folder


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

    def wish(self) -> None:
        """Do as if Ctrl-C had been pressed."""
        self._wished = True

    def __enter__(self) -> InterruptFlag:
        """Listen."""
        self._former = signal.getsignal(signal.SIGINT)
        signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Listen no more."""
        signal.signal(signal.SIGINT, self._former)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
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

    Raises:
        CheckpointError: If there is nothing to resume.
    """
    if resume == "auto":
        raise ConfigError(
            "resume=auto is for the runs of a sweep, which have a folder each; resume=<run folder> "
            "goes on with a single run"
        )
    if resume:
        # Looked up here already, since Hydra makes the folder that this returns.
        path = find_checkpoint(resume)
        if path.parent.name != "checkpoints":
            raise CheckpointError(
                f"checkpoint {path} lies outside a run's checkpoints/; resume from the run's folder"
            )
        return str(path.parent.parent)
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    base = Path(root) / name / stamp
    folder, number = base, 2
    while folder.exists():
        folder, number = base.with_name(f"{stamp}_{number}"), number + 1
    return str(folder)


def register() -> None:
    """Make known to Hydra what ``conf/`` uses: the schema and ``${run_folder:...}``."""
    register_schemas()
    OmegaConf.register_new_resolver("run_folder", run_folder, use_cache=True, replace=True)
