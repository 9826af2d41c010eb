"""The paper's figures and the rows of its tables."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from omegaconf import OmegaConf

Figures = Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Row:
    """A row of one of the paper's tables.

    Attributes:
        name: Name of the runs that belong to it.
        title: What the table calls it.
        category: Kind of method.
        command: Command that makes such a run; empty when unknown.
        paper: The paper's figures by measure: (mean,) or (mean, standard deviation).
    """

    name: str
    title: str
    category: str = ""
    command: str = ""
    paper: Figures | None = None


@functools.cache
def rows(table: str) -> tuple[Row, ...]:
    """Rows of a table in the paper's order.

    Args:
        table: ``"table1"``, ``"table2"``, or ``"further"`` for methods that are not in the paper.
    """
    return tuple(_row(entry) for entry in _contents()[table])


def _row(entry: Mapping[str, Any]) -> Row:
    figures = {
        measure: tuple(map(float, numbers))
        for measure, numbers in (entry.get("paper") or {}).items()
        if numbers is not None
    }
    return Row(**{**entry, "paper": figures})


def known(name: str) -> Row:
    """The row of a method; one with its plain name for a method that is in no table."""
    for table in ("table1", "further", "table2"):
        for row in rows(table):
            if row.name == name:
                return row
    return Row(name, name, paper={})


@dataclass(frozen=True)
class CurveFigure:
    """A figure of learning curves.

    Attributes:
        key: Short name.
        title: Title.
        names: Methods in it, beside the reference.
    """

    key: str
    title: str
    names: tuple[str, ...]


@functools.cache
def figures() -> tuple[CurveFigure, ...]:
    """The paper's figures of learning curves."""
    return tuple(
        CurveFigure(entry["key"], entry["title"], tuple(entry["names"]))
        for entry in _contents()["figures"]
    )


def _contents() -> dict[str, Any]:
    text = (files("haim_torchrl.report") / "paper.yaml").read_text(encoding="utf-8")
    contents: Any = OmegaConf.to_container(OmegaConf.create(text))
    return dict(contents)
