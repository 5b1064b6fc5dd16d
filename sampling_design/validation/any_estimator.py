"""Validation of an estimator of which the three methods are all that is known: runs beside a truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sampling_design.estimators.online.estimator import Estimator
from sampling_design.records.arrays import Array
from sampling_design.records.progress import Progress
from sampling_design.validation.error_map import ErrorRows
from sampling_design.validation.monte_carlo import ratio
from sampling_design.validation.report import ErrorCurve, Finding, ValidationReport
from sampling_design.validation.scenario import (
    ErrorSources,
    ScenarioBounds,
    draw_inputs,
    initial_inputs,
    resonant_inputs,
)
from sampling_design.validation.timeline import Timeline
from sampling_design.validation.trials import EstimatedRun, real_run, true_run

GROWTH_LIMIT = {"resonant": 1.5, "initial": 1.0}
"""Largest error of the second half over that of the first: a settled error under a disturbance in step with a mode
repeats itself (1), one that grows linearly doubles (2); what a wrong prior leaves decays."""


class EstimatorStudy:
    """One estimator under the scenarios that need nothing but its estimates."""

    def __init__(
        self, line: Timeline, bounds: ScenarioBounds, estimator: Estimator, seeds: Sequence[np.random.SeedSequence]
    ):
        self.line, self.bounds, self.estimator, self.seeds = line, bounds, estimator, seeds
        samples = set(line.samples.tolist())
        at = np.array([b for b in range(line.times.size) for _ in range(1 + (b in samples))])
        self.rows = ErrorRows(at, np.append(at[1:] != at[:-1], True), line.times[at])

    def report(
        self, scenarios: Sequence[str], settings: Mapping[str, object], progress: Progress | None
    ) -> ValidationReport:
        """Run the scenarios that are known here, and say of the others that they are not."""
        findings, error_curves = list[Finding](), list[ErrorCurve]()
        inputs: dict[str, Callable[[], ErrorSources]] = {
            "random": lambda: draw_inputs(self.line, self.bounds, self.seeds),
            "resonant": lambda: resonant_inputs(self.line, self.bounds)[0],
            "initial": lambda: initial_inputs(self.line, self.bounds),
        }
        known = [name for name in scenarios if name in inputs]
        for k, name in enumerate(known):
            if progress is not None:
                progress(k / len(known), name)
            runs = self._runs(inputs[name]())
            size = np.linalg.norm([run.errors(self.rows) / self.line.plant.states.scales for run in runs], axis=2)
            error_curves.append(ErrorCurve(name, size.max(axis=0), np.median(size, axis=0)))
            findings += [*self._growth(name, size), *self._promised(name, runs)]
        if progress is not None:
            progress(1.0, "done")
        return ValidationReport(
            plant=self.line.plant,
            findings=tuple(findings),
            times=self.rows.times,
            bound=None,
            norm="states over their scales",
            error_curves=tuple(error_curves),
            settings=settings,
            skipped=tuple(f"{name}: it needs a certificate's estimator." for name in scenarios if name not in known),
        )

    def _runs(self, inputs: ErrorSources) -> list[EstimatedRun]:
        found = []
        for k in range(len(inputs.e0)):
            self.estimator.start(np.zeros(self.line.plant.n_states), 0.0)
            found.append(real_run(self.line, self.rows, true_run(self.line, inputs, k, steered=False), self.estimator))
        return found

    def _growth(self, name: str, size: Array) -> list[Finding]:
        if name not in GROWTH_LIMIT:
            return []
        early = self.rows.times <= self.line.times[-1] / 2
        growth = float(np.max(ratio(size[:, ~early].max(axis=1), size[:, early].max(axis=1))))
        return [Finding("error does not grow", name, GROWTH_LIMIT[name], growth)]

    def _promised(self, name: str, runs: list[EstimatedRun]) -> list[Finding]:
        """Of the estimates that say that their ellipsoid is proven, whether it held the truth."""
        found = [
            each.ratio(x)
            for run in runs
            for each, x in zip(run.estimates, run.truth.states[self.rows.at], strict=True)
            if each.certified
        ]
        return [Finding("online ellipsoid", name, 1.0, max(found))] if found else []
