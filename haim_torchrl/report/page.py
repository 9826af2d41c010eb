"""The report as one HTML page that needs no other file, and as Markdown."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from haim_torchrl.report.table import ReportTable

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 2em auto; max-width: 90em;
       padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .85em; }
th, td { padding: .3em .7em; text-align: left; white-space: nowrap; }
th { border-bottom: 2px solid #888; white-space: normal; vertical-align: bottom; }
td { border-bottom: 1px solid #ddd; vertical-align: top; }
.paper { color: #777; }
.note { color: #555; font-size: .85em; max-width: 70em; margin: .5em 0; }
.problem { background: #fdf3d8; padding: .3em .8em; }
img { max-width: 100%; height: auto; }
"""


@dataclass
class Report:
    """What a report consists of.

    Attributes:
        title: Title.
        problems: Sentences on what is missing or doubtful, above everything else.
        tables: Tables.
        pictures: Titles and PNG images.
    """

    title: str
    problems: Sequence[str] = ()
    tables: Sequence[ReportTable] = ()
    pictures: list[tuple[str, Path]] = field(default_factory=list)

    def html(self) -> str:
        """One page with its pictures inside, without links to anything outside."""
        parts = [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{html.escape(self.title)}</title><style>{STYLE}</style></head><body>",
            f"<h1>{html.escape(self.title)}</h1>",
            *(f'<p class="problem">{html.escape(problem)}</p>' for problem in self.problems),
            *(table.html() for table in self.tables),
        ]
        for title, path in self.pictures:
            data = base64.b64encode(path.read_bytes()).decode()
            name = html.escape(title)
            parts.append(f'<h2>{name}</h2>\n<img alt="{name}" src="data:image/png;base64,{data}">')
        return "\n".join([*parts, "</body></html>", ""])

    def markdown(self) -> str:
        """The tables, and the pictures as files beside them."""
        parts = [f"# {self.title}\n", *(f"- {problem}" for problem in self.problems)]
        parts += ["", *(table.markdown() for table in self.tables)]
        parts += [f"## {title}\n\n![{title}]({path.name})\n" for title, path in self.pictures]
        return "\n".join(parts)

    def write(self, folder: Path) -> Path:
        """Write ``report.html``, ``report.md`` and a CSV file for each table.

        Returns:
            The page.
        """
        for table in self.tables:
            table.write_csv(folder)
        (folder / "report.md").write_text(self.markdown(), encoding="utf-8")
        page = folder / "report.html"
        page.write_text(self.html(), encoding="utf-8")
        return page
