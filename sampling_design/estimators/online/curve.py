"""Estimates over all times of a record, and what a picture shows of them: each of a few, of many the extremes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sampling_design.estimators.online.estimate import Estimate, StateTube, joined
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.estimators.online.in_order import OnlineEstimator
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.record import Record, counted, short
from sampling_design.records.signatures import checked

STRETCHES = 600  # stretches of a record that has more times than that: about one for each column of dots of a picture


@dataclass(frozen=True, eq=False, repr=False)
class EstimateEnvelope(Record):
    """Extremes of estimates and of their proven bounds, at each time of a few, else at the samples of each stretch.

    Attributes
    ----------
    plant : Plant
    times : (K,) array [time]
        Of the samples, or the middles of the stretches.
    length : float [time]
        Of a stretch; 0 where each time stands for itself.
    lowest, highest : (K, n) arrays
        Of the estimates; NaN where a stretch has none.
    lower, upper : (K, n) arrays
        Of what is proven at the samples, the estimate and its radius; NaN where nothing is.
    failed : (K,) array of bool
        Whether any of them failed.
    """

    plant: Plant
    times: Array
    length: float
    lowest: Array
    highest: Array
    lower: Array
    upper: Array
    failed: Mask

    @classmethod
    def over(cls, plant: Plant, times: npt.ArrayLike, stretches: int = STRETCHES) -> EstimateEnvelope:
        """Return an envelope of nothing yet for estimates at some times; `including` takes them in."""
        places, length = np.unique(np.asarray(times, dtype=float)), 0.0
        if places.size > stretches:
            length = float((places[-1] - places[0]) / stretches)
            places = places[0] + length * (np.arange(stretches) + 0.5)
        lowest, highest, lower, upper = np.full((4, places.size, plant.n_states), np.nan)
        return cls(plant, places, length, lowest, highest, lower, upper, np.zeros(places.size, dtype=bool))

    @property
    def edges(self) -> Array:
        """Where stretches begin, and where the last one ends (K + 1,)."""
        return np.append(self.times - self.length / 2, self.times[-1:] + self.length / 2)

    def including(self, times: Array, x: Array, radii: Array, certified: Mask, failed: Mask) -> EstimateEnvelope:
        """Return it with estimates x (N, n) at some of the times, their radii (N, n) and whether proven or failed."""
        begin = self.times if self.length == 0 else self.edges[:-1]
        at = np.maximum(np.searchsorted(begin, times, side="right") - 1, 0)
        around = np.where(np.isfinite(radii) & certified[:, None], radii, np.nan)
        lowest, highest, lower, upper = np.array([self.lowest, self.highest, self.lower, self.upper])
        fails = self.failed.copy()
        np.fmin.at(lowest, at, x)
        np.fmax.at(highest, at, x)
        np.fmin.at(lower, at, x - around)
        np.fmax.at(upper, at, x + around)
        np.logical_or.at(fails, at, failed)
        return replace(self, lowest=lowest, highest=highest, lower=lower, upper=upper, failed=fails)

    def _rows(self) -> list[tuple[str, str]]:
        edges = self.edges
        what = "stretches" if self.length else "times"
        return [(what, str(self.times.size)), ("time", f"{short(edges[0], 12)} to {short(edges[-1], 12)}")]

    def explain(self) -> str:
        """Say what the extremes are of."""
        where = f"over {self.times.size} stretches of time" if self.length else f"at {self.times.size} times"
        return f"Extremes of the estimates {where}, each state by itself."


POINTS_PER_GAP = 12  # points of the open loop between two samples


@dataclass(frozen=True, eq=False, repr=False)
class EstimateCurve(Record):
    """Estimates at the samples of a record and at points between them, as a picture of it needs them.

    Attributes
    ----------
    estimates : EstimateRecord
        At a sample twice: as predicted before it, and with it.
    tube : StateTube or None
        Every state lies in it, at all times between samples, if the bounds hold; None where nothing is proven.
    measurements : Measurements
    """

    estimates: EstimateRecord
    tube: StateTube | None
    measurements: Measurements

    _answers = (
        "estimates at the samples of a record and between them",
        "{_evidence}",
        "{estimates._last}",
        "`.estimates.estimates[-1].interval().verify()`",
    )
    _table = {"samples": "{measurements.__len__}", "points": "{estimates.__len__}"}

    def _evidence(self) -> str:
        return "nothing is proven between samples" if self.tube is None else "proven: the tube, if the bounds hold"

    def explain(self) -> str:
        """Say what holds the truth between samples."""
        count = counted(len(self.measurements), "sample")
        if self.tube is None:
            return f"Estimates between and at {count}; between them nothing is proven."
        return f"Estimates between and at {count}; the tube holds every state at all times, if the bounds do."


class CurveCollector:
    """Collects a curve while an estimator goes along a record: `before` each sample, then `after` its estimate.

    `start` is when the prior is. `centred`: the curve is the middle of the tube, which goes with estimates that are in
    the middle of their intervals.
    """

    def __init__(
        self, estimator: OnlineEstimator, points: int = POINTS_PER_GAP, centred: bool = False, start: float = 0.0
    ):
        self.estimator, self.count, self.centred = estimator, points, centred
        self.points, self.tubes, self.last = [estimator.predict(start)], list[StateTube](), start

    def before(self, t: float) -> None:
        """Draw on to t, with what is known before the sample there."""
        if t > self.last:
            times = np.linspace(self.last, t, self.count + 1)
            ahead = [self.estimator.predict(s) for s in times]
            if ahead[0].proof is not None:
                tube = ahead[0].proof.tube(times, np.array([each.x for each in ahead]))
                self.tubes.append(tube)
                if self.centred:
                    ahead = [_moved(each, x) for each, x in zip(ahead, tube.middle, strict=True)]
            self.points += ahead[1:]

    def after(self, t: float, estimate: Estimate) -> None:
        """Go on from the estimate at t, unless its sample was late."""
        if t >= self.last:
            self.points.append(estimate)
            self.last = t

    def curve(self, measurements: Measurements) -> EstimateCurve:
        """Return what was collected."""
        estimates = EstimateRecord.collect(self.estimator.plant, self.points)
        return EstimateCurve(estimates, joined(self.tubes), measurements)


def _moved(estimate: Estimate, x: Array) -> Estimate:
    """The estimate at x where that is known."""
    return replace(estimate, x=freeze(np.where(np.isfinite(x), x, estimate.x)))


@checked
def estimate_curve(
    estimator: OnlineEstimator, measurements: Measurements, points: int = POINTS_PER_GAP, *, start: float = 0.0
) -> EstimateCurve:
    """Run an estimator along a record and return its estimates between the samples, too, with the tube around them.

    Parameters
    ----------
    estimator : MovingHorizonEstimator, KalmanFilter or another of this package
        Fresh, or started anew; it takes in the whole record.
    measurements : Measurements
    points : int
        Of the open loop between two samples, >= 1.
    start : float
        Time of the estimator's prior, where the curve begins.

    Returns
    -------
    EstimateCurve

    Raises
    ------
    ArgumentError
        If it is no estimator or no record of measurements in the terms of its plant, or `points` is no count.

    Notes
    -----
    *Claim.* With bounds on the disturbance, the noise and the prior's error, every state lies within the tube at all
    real times between samples, not only at the points. `EstimateRecord` alone knows the samples only.
    *Numerical aspects.* A few programs are solved for each gap: for records of some thousand samples take
    `EstimateEnvelope` instead.

    Examples
    --------
    >>> from sampling_design import MovingHorizonEstimator, PeriodicSchedule, simulate_record
    >>> from sampling_design.plants import library
    >>> plant = library.oscillator()
    >>> record = simulate_record(plant, PeriodicSchedule([0.7, 1.6]), 3.0, w_bound=0.02, v_bound=0.1)
    >>> estimator = MovingHorizonEstimator(plant, horizon=6.0, w_bound=0.02, v_bound=0.1, initial_error=2.0)
    >>> print(estimate_curve(estimator, record.measurements).explain())
    Estimates between and at 4 samples; the tube holds every state at all times, if the bounds do.
    """
    following = CurveCollector(estimator, checks.whole("points", points, 1), start=checks.number("start", start))
    measurements = measurements.on_clock(estimator.clock_origin, estimator.plant)
    for t, (stamp, y, u) in zip(measurements.times.tolist(), measurements, strict=True):
        following.before(t)
        following.after(t, estimator.update(stamp, y, u))
    return following.curve(measurements)
