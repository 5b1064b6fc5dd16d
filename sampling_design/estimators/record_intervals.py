"""Estimates at every row of a record that hold whichever few samples are outliers, or that later samples sharpen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.accuracy.interval import Interval, state_interval
from sampling_design.accuracy.readings import Arrived
from sampling_design.accuracy.record_readings import left_out
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimate_file import TOGETHER
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.kalman import KalmanFilter
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.online.estimate import Contradiction, Estimate, StateTube
from sampling_design.estimators.online.evidence import output_of
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Progress

UNSURE = "Every sample so far may be an outlier."


def smoothed_along(
    estimator: MovingHorizonEstimator, record: Measurements, bounds: ErrorBoundArguments, kind: str
) -> Iterator[list[Estimate]]:
    """Yield the estimates at every sample given all samples, some at a time, as they stand beside radii of a kind.

    The filter has the weights of `estimator`, its prior, and no constraints.
    """
    start = estimator.state.last
    smoother = KalmanFilter(
        estimator.plant, estimator.certificate, cost=CostFunction(eta=estimator.weights.eta), prior=start.x,
        prior_time=start.t, **bounds,
    )  # fmt: skip
    found = list(smoother.smooth(record).estimates)
    for k in range(0, len(found), TOGETHER):
        yield [each.centred() if kind == "centred" else each for each in found[k : k + TOGETHER]]


def estimates_despite_outliers(
    estimator: MovingHorizonEstimator,
    record: Measurements,
    bounds: ErrorBoundArguments,
    outliers: int | tuple[int, int],
    *,
    smooth: bool = False,
    progress: Progress | None = None,
) -> Iterator[list[Estimate]]:
    """Yield the middle of what stays possible at every row, some at a time, if so few of its samples are outliers.

    Raises ArgumentError if there are more sets of samples that may be outliers than are looked at.

    Parameters
    ----------
    estimator : MovingHorizonEstimator
        Brings plant and prior.
    record : Measurements
        In order of time.
    outliers : int or (int, int)
        As for `state_interval`.
    smooth : bool
        Whether later rows count too.
    """
    rows, read = list(record), np.cumsum(record.measured.any(axis=1))
    most = len(left_out(outliers, int(read[-1]))[0])
    start, found = estimator.state.last, list[Estimate]()
    x = start.x
    for k, t in enumerate(record.times.tolist()):
        last = len(rows) - 1 if smooth else k
        known, unproven = int(read[last]), Estimate(t, x, freeze(np.eye(x.size)), window_start=start.t)
        if known > most:
            proof = _OutlierEvidence(estimator.plant, rows[: last + 1], known, outliers, bounds, (start.t, start.x))
            found.append(replace(unproven, proof=proof).centred())
        else:
            found.append(replace(unproven, status="prior", note=UNSURE))
        x = found[-1].x
        if progress is not None:
            progress((k + 1) / len(rows), f"{k + 1} of {len(rows)} rows")
        if len(found) == TOGETHER or k + 1 == len(rows):
            yield found
            found = []


@dataclass
class _OutlierEvidence:
    """What the interval of a row is proven from (`ProvesIntervals`)."""

    plant: Plant
    rows: Sequence[Arrived]
    samples: int
    outliers: int | tuple[int, int]
    bounds: ErrorBoundArguments
    start: tuple[float, Array]
    contradiction: Contradiction | None = None
    newly: bool = True

    def interval(self, t: float, of: Wanted, ellipsoid: tuple[Array, Array, float] | None = None) -> Interval:
        """The interval that holds every case; a contradiction, if all cases are impossible."""
        begun, prior = self.start
        found = state_interval(
            self.plant, self.rows, t, prior=prior, prior_time=begun, of=of, outliers=self.outliers, **self.bounds
        )
        if found.disproof is not None and self.contradiction is None:
            at = int(found.disproof.strongest[0])
            name = self.plant.outputs.names[output_of(found.disproof, at)]
            when = float(found.disproof.readings.times[at])
            self.contradiction = Contradiction(self.samples, when, name, found.contradiction, alone=False)
        return found

    def tube(self, times: Array, x: Array) -> StateTube:
        """Refused: between the rows nothing is worked out. Raises ArgumentError."""
        raise ArgumentError("`outliers` are of the rows alone: between them nothing is worked out.")
