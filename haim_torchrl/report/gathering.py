"""All runs below some folders, and a sentence for each thing that is wrong with them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from haim_torchrl.report.methods import Method
from haim_torchrl.report.runs import (
    RESULT_FILE,
    FinishedRun,
    RunFileError,
    read_published,
    read_result,
    result_files,
)


@dataclass
class Gathered:
    """What was found.

    Attributes:
        methods: Methods by name, in the order of their first run, seeds in order.
        problems: One sentence for each thing that a reader of the tables should know.
    """

    methods: dict[str, Method] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def runs(self) -> list[FinishedRun]:
        """All runs, method by method."""
        return [run for method in self.methods.values() for run in method.runs]


def gather(sources: Sequence[str | os.PathLike[str]]) -> Gathered:
    """Read runs, leaving out what cannot be used.

    Args:
        sources: Folders, searched with their subfolders, and published ``runs.json`` files. Where
            one run is given twice it counts once; of two runs of the same method and seed the
            first one counts.
    """
    found = Gathered()
    chosen: dict[tuple[str, int], tuple[FinishedRun, Path]] = {}
    for path in _files(sources, found.problems):
        try:
            runs = read_result(path) if path.name.startswith("metrics") else read_published(path)
        except RunFileError as error:
            found.problems.append(str(error))
            continue
        for run in runs:
            former = chosen.setdefault((run.name, run.seed), (run, path))
            if former[0] != run:
                found.problems.append(
                    f"{run.name} has two runs of seed {run.seed}, in {former[1]} and {path}; "
                    "the second one is left out"
                )
    names = dict.fromkeys(name for name, _ in chosen)
    for name in names:
        runs = [run for (owner, _), (run, _) in sorted(chosen.items()) if owner == name]
        found.methods[name] = Method(name, runs)
    found.problems += [problem for m in found.methods.values() for problem in m.problems()]
    found.problems += _missing_seeds(found.methods)
    return found


def _files(sources: Sequence[str | os.PathLike[str]], problems: list[str]) -> Iterator[Path]:
    """Result files of all sources, each once; ``problems`` gets what is missing or unfinished."""
    seen: set[Path] = set()
    for source in map(Path, sources):
        if source.is_file():
            paths = [source]
        elif source.is_dir():
            paths = [*result_files(source), *sorted(source.rglob("runs.json"))]
            problems += _unfinished(source)
            if not paths:
                problems.append(f"{source} holds no finished run")
        else:
            problems.append(f"{source} does not exist; its runs are missing from the tables")
            continue
        for path in paths:
            if path.resolve() not in seen:
                seen.add(path.resolve())
                yield path


def _unfinished(source: Path) -> list[str]:
    """A sentence for each run below a folder that has begun but not come to its end."""
    begun = {path.parent for name in ("config.yaml", "train.csv") for path in source.rglob(name)}
    ended = {path.parent for path in source.rglob("metrics*.json")}
    return [
        f"{folder} has no {RESULT_FILE}, since its run has not come to its end; it is left out"
        for folder in sorted(begun - ended)
    ]


def _missing_seeds(methods: dict[str, Method]) -> list[str]:
    """A sentence for each trained method that lacks seeds that others have."""
    trained = {name: m for name, m in methods.items() if m.trained}
    every = {run.seed for method in trained.values() for run in method.runs}
    sentences = []
    for name, method in trained.items():
        missing = sorted(every - {run.seed for run in method.runs})
        if missing:
            seeds = ", ".join(map(str, missing))
            kind = "seed" if len(missing) == 1 else "seeds"
            sentences.append(f"{name} has no run of {kind} {seeds}, which other methods have")
    return sentences
