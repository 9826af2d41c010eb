"""Minari datasets: sessions written as such, and datasets read as transitions.

``python -m haim_torchrl.data.minari export runs/<folder> <dataset-id>`` writes one,
``python -m haim_torchrl.data.minari info <dataset-id>`` says what one holds.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Any

from haim_torchrl.data.minari_export import export_session
from haim_torchrl.data.minari_format import CARD, MinariError
from haim_torchrl.data.minari_reader import card_of, load_episodes, load_minari, open_dataset
from haim_torchrl.data.session import SessionError

__all__ = [
    "MinariError",
    "card_of",
    "describe",
    "export_session",
    "load_episodes",
    "load_minari",
    "main",
]


def describe(dataset: str | os.PathLike[str]) -> str:
    """What a dataset says of itself, as text.

    Raises:
        MinariError: If it is missing.
    """
    found = open_dataset(dataset)
    metadata = found.storage.metadata
    card = metadata.get(CARD, {})
    rows = {
        "dataset": found.id,
        "folder": found.storage.data_path.parent,
        "format": metadata["data_format"],
        "episodes": found.total_episodes,
        "steps": found.total_steps,
        "observation": _line(found.observation_space),
        "action": _line(found.action_space),
        "environment": None if found.env_spec is None else found.env_spec.id,
        "algorithm": metadata.get("algorithm_name"),
        "author": ", ".join(sorted(metadata.get("author", ()))),
        "requirements": ", ".join(metadata.get("requirements", ())),
        "description": metadata.get("description"),
        "driver": card.get("driver"),
        "observation_view": card.get("observation_view"),
        "seed": card.get("seed"),
        "recorded": card.get("started"),
    }
    rows |= {k: v for k, v in card.get("statistics", {}).items() if k not in rows}
    rows |= {f"infos.{name}": meaning for name, meaning in card.get("infos", {}).items()}
    return "\n".join(
        f"{name:<24}{f'{value:.3g}' if isinstance(value, float) else value}"
        for name, value in rows.items()
        if value not in (None, "")
    )


def _line(value: Any) -> str:
    return " ".join(str(value).split())


def main(arguments: Sequence[str] | None = None) -> None:
    """The command.

    Raises:
        SystemExit: With code 2 after one sentence, if it cannot do what was asked.
    """
    parser = argparse.ArgumentParser(
        prog="python -m haim_torchrl.data.minari",
        description="Sessions as Minari datasets, in the folder that MINARI_DATASETS_PATH names.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    export = commands.add_parser("export", help="drive a session again and write it as a dataset")
    export.add_argument("run", help="a run's folder, or a session file")
    export.add_argument("dataset", help="id: name-v0 or namespace/name-v0")
    export.add_argument("--author", help="for the card")
    export.add_argument("--author-email", help="for the card")
    export.add_argument("--description", help="for the card; by default it says what the data are")
    info = commands.add_parser("info", help="say what a dataset holds")
    info.add_argument("dataset", help="id, or the dataset's folder")
    given = parser.parse_args(arguments)
    try:
        dataset = given.dataset
        if given.command == "export":
            dataset = export_session(
                given.run,
                dataset,
                author=given.author,
                author_email=given.author_email,
                description=given.description,
            )
        print(describe(dataset))
    except (MinariError, SessionError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
