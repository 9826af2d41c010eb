"""What works here, what would fail, and how to mend it.

python -m haim_torchrl.doctor                    # everything
python -m haim_torchrl.doctor --mentor wheel     # could a person at a wheel drive now?
python -m haim_torchrl.doctor --mentor browser mentor.console.port=9000
python -m haim_torchrl.doctor --live             # axes and buttons as they move; Ctrl-C ends it
python -m haim_torchrl.doctor --json             # for programs

Exit code 0 if everything works that is needed, 1 if not, 2 for a wrong command line.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from functools import partial

from haim_torchrl.doctor import inputs, machine, packages
from haim_torchrl.doctor.check import Check, run_checks
from haim_torchrl.doctor.mentors import MENTORS, check_mentor, find_conf, page_address
from haim_torchrl.doctor.report import as_json, as_text, healthy


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the doctor.

    Args:
        arguments: of the command line; the program's own if None.

    Returns:
        The exit code.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.overrides and options.mentor is None:
        parser.error("settings need a --mentor that they belong to")
    if options.live is not None:
        from haim_torchrl.doctor.live import watch

        return 0 if watch(None if options.live == 0.0 else options.live) else 1
    asked_for: str | None = options.mentor
    conf = find_conf()
    overrides = options.overrides if asked_for == "browser" else ()
    sections = examine(asked_for, page_address(overrides, conf))
    names = MENTORS if asked_for is None else (asked_for,)
    rows = [check_mentor(name, options.overrides, conf) for name in names]
    ok = healthy(sections, None if asked_for is None else rows[0])
    if options.json:
        print(as_json(sections, rows, ok))
    else:
        width = shutil.get_terminal_size((100, 24)).columns
        print(as_text(sections, rows, ok, width=width, colour=sys.stdout.isatty()))
    return 0 if ok else 1


def examine(mentor: str | None, page: tuple[str, int]) -> dict[str, list[Check]]:
    """Look at everything that a mentor needs.

    Args:
        mentor: its name, as in ``mentor=wheel``; None for all of them.
        page: host and port of the browser console.

    Returns:
        Findings by subject.
    """
    sections = {
        "packages": run_checks(
            (packages.python_version, packages.required_packages, packages.imports, packages.pygame)
        ),
        "optional packages": run_checks((packages.optional_packages,)),
        "machine": run_checks(
            (
                machine.threads,
                machine.devices,
                machine.prioritised_replay,
                machine.processes,
                machine.shared_memory,
                machine.runs_folder,
                machine.clock,
            )
        ),
    }
    if mentor in (None, "keyboard", "gamepad", "wheel"):
        sections["window"] = run_checks(
            (inputs.display, inputs.video_drivers, inputs.joysticks, inputs.permissions)
        )
    if mentor in (None, "browser"):
        sections["page"] = run_checks(
            (inputs.loopback, partial(inputs.port, *page), inputs.browsers)
        )
    return sections


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m haim_torchrl.doctor",
        description=(__doc__ or "").split("\n")[0],
    )
    parser.add_argument("--mentor", metavar="NAME", help="look at what this mentor needs")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--live",
        nargs="?",
        type=float,
        const=0.0,
        metavar="SECONDS",
        help="show axes and buttons as they move, until Ctrl-C or for so long",
    )
    parser.add_argument(
        "overrides", nargs="*", help="settings of the mentor, such as mentor.console.port=9000"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
