"""The runs of one method taken together: its measures over seeds and shared scenarios."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from haim_torchrl.report.runs import FinishedRun
from haim_torchrl.report.statistics import Scores


def _outcome(name: str) -> Callable[[FinishedRun], list[float]]:
    return lambda run: [float(outcome == name) for outcome in run.episodes["outcome"]]


def _column(name: str) -> Callable[[FinishedRun], list[float]]:
    return lambda run: [float(value or 0.0) for value in run.episodes[name]]


Column = Callable[[FinishedRun], list[float]]

MEASURES: dict[str, tuple[Column, Column | None]] = {
    "success": (_outcome("success"), None),
    "return": (_column("reward"), None),
    "violations": (_column("violations"), None),
    "disturbance_rate": (_column("hard_brakes"), _column("steps")),
    "out_of_road": (_outcome("out_of_road"), None),
    "timeout": (_outcome("timeout"), None),
    "speed": (_column("distance"), _column("duration")),
}
"""Measures of a test: what is summed over episodes, and by what it is divided (None: episodes)."""


@dataclass(frozen=True)
class Method:
    """A method and its runs, one for each seed.

    Attributes:
        name: Its name.
        runs: Its runs.
    """

    name: str
    runs: Sequence[FinishedRun]

    @property
    def trained(self) -> bool:
        """Whether there was a training, as there was none of a mentor or of straight driving."""
        return any(run.training for run in self.runs)

    @property
    def seeds(self) -> int:
        """Number of seeds behind its figures."""
        return len(self.runs)

    def scenarios(self) -> list[int]:
        """Scenarios that all of its runs drove in the test."""
        shared = set.intersection(*(set(run.scenarios()) for run in self.runs))
        return sorted(shared)

    def scores(self, measure: str, scenarios: Collection[int] | None = None) -> Scores:
        """A measure of the test.

        Args:
            measure: One of :data:`MEASURES`.
            scenarios: Scenarios to take; by default those that all runs share.

        Returns:
            ``[seeds, scenarios]``.
        """
        chosen = sorted(self.scenarios() if scenarios is None else scenarios)
        top, bottom = MEASURES[measure]

        def matrix(column: Column) -> list[list[float]]:
            rows = [dict(zip(run.scenarios(), column(run))) for run in self.runs]
            return [[row[scenario] for scenario in chosen] for row in rows]

        return Scores.of(matrix(top), None if bottom is None else matrix(bottom))

    def totals(self, name: str, scale: float = 1.0) -> Scores:
        """A total of the training times ``scale``, ``[seeds, 1]``; runs without it are left out."""
        return Scores.of_runs([scale * run.total(name) for run in self.runs])

    def problems(self) -> list[str]:
        """A sentence for each way in which its runs do not belong together."""
        sentences = []
        for what, values in (
            ("worlds", [run.settings.world for run in self.runs]),
            ("numbers of environment steps", [run.training.get("frames") for run in self.runs]),
        ):
            different = sorted({str(value) for value in values if value is not None})
            if len(different) > 1:
                sentences.append(
                    f"the runs of {self.name} have different {what} ({', '.join(different)}); "
                    "their figures should not be taken together"
                )
        if len({run.settings.digest for run in self.runs} - {None}) > 1:
            sentences.append(
                f"the runs of {self.name} have different settings; compare their config.yaml"
            )
        if len({tuple(run.scenarios()) for run in self.runs}) > 1:
            shared = len(self.scenarios())
            sentences.append(
                f"the runs of {self.name} drove different test scenarios; its figures are over "
                f"the {shared} that all of them share"
                if shared
                else f"the runs of {self.name} share no test scenario, so that it has no figures"
            )
        return sentences
