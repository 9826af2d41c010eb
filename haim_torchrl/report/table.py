"""A table of text, and its forms: Markdown, HTML, CSV."""

from __future__ import annotations

import csv
import html
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GAP = "-"
"""What stands where nothing was measured; the same as in the tables of a run."""


@dataclass(frozen=True)
class ReportTable:
    """A table with its notes.

    Attributes:
        key: File name of the CSV form, without ending.
        title: Title.
        columns: Headings.
        rows: Text, a list for each row.
        notes: Sentences below it.
        numbers: The same as numbers, a mapping for each row.
    """

    key: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    numbers: Sequence[Mapping[str, Any]] = ()

    def markdown(self) -> str:
        """The table in Markdown, with its title as a heading."""
        lines = [
            f"## {self.title}",
            "",
            f"| {' | '.join(self.columns)} |",
            "|" + "---|" * len(self.columns),
            *(f"| {' | '.join(row)} |" for row in self.rows),
        ]
        for note in self.notes:
            lines += ["", note]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """The table in HTML, with its title as a heading."""

        def row(tag: str, texts: Sequence[str]) -> str:
            cells = (
                f"<{tag}{' class=paper' if column == 'paper' else ''}>{_lines(text)}</{tag}>"
                for column, text in zip(self.columns, texts)
            )
            return f"<tr>{''.join(cells)}</tr>"

        body = "\n".join(row("td", texts) for texts in self.rows)
        notes = "\n".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        return (
            f"<h2>{html.escape(self.title)}</h2>\n<div class=wide><table>\n"
            f"<thead>{row('th', self.columns)}</thead>\n<tbody>\n{body}\n</tbody></table></div>\n"
            f"{notes}\n"
        )

    def write_csv(self, folder: str | os.PathLike[str]) -> Path:
        """Write the numbers to ``<key>.csv`` and return its path; what is unknown is empty."""
        path = Path(folder) / f"{self.key}.csv"
        columns = dict.fromkeys(name for row in self.numbers for name in row)
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(columns), restval="")
            writer.writeheader()
            writer.writerows(self.numbers)
        return path


def _lines(text: str) -> str:
    """A cell in HTML, with an interval or a deviation on a line of its own."""
    return html.escape(text).replace(" [", "<br>[").replace(" ± ", "<br>± ")
