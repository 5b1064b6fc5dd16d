"""What samples buy: the guaranteed accuracy of so many evenly spaced ones, and of none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sampling_design.accuracy.accuracy import guaranteed_accuracy
from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.bounds import Bound, NoiseBound
from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.declarations import Column, above
from sampling_design.records.record import PlainRecord, TableRecord, counted, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule

LEAST = 1e-3  # seconds that a count is given where the budget is spent: its bracket is proven, and wide


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyByCount(TableRecord, PlainRecord):
    """The guaranteed accuracy for several counts of evenly spaced samples, one row per count.

    Attributes
    ----------
    counts : tuple of int
        Samples per period, increasing; 0: none at all.
    period : float
        In the plant's time unit.
    rows : RequestedRows
        Matrix, names and units of what is wanted.
    accuracies : tuple of Accuracy
        What `guaranteed_accuracy` says of each count; for 0 of a sensor that reads nothing.
    """

    counts: tuple[int, ...]
    period: float
    rows: RequestedRows
    accuracies: tuple[Accuracy, ...]

    _plain = "counts period rows{names units matrix} upper lower closed"
    _answers = (
        "the least error that an estimator can guarantee, by how many evenly spaced samples it has",
        "proven: `upper` by gains, `lower` by trajectories that no sample shows",
        "{_good}",
        "`.verify()`",
    )

    def _good(self) -> str:
        return "as sharp as asked" if self.closed else "not as sharp as can be: a larger `budget` narrows it"

    @property
    def upper(self) -> Array:
        """Proven for each count and row (k, r): k evenly spaced samples hold those of each divisor of k, and none."""
        own = np.array([found.upper for found in self.accuracies])
        nested = [[k == many or k == 0 or (many > 0 and many % k == 0) for k in self.counts] for many in self.counts]
        return freeze([own[which].min(axis=0) for which in nested])

    @property
    def lower(self) -> Array:
        """No estimator guarantees less (k, r): attained."""
        return freeze([found.lower for found in self.accuracies])

    @property
    def closed(self) -> bool:
        """Whether every bracket met its tolerance; where not, `upper` is proven and may be too large."""
        return all(bool(np.all(found.closed)) for found in self.accuracies)

    def verify(self) -> bool:
        """Whether each is of so many samples of one plant, and both its sides hold, recomputed without a solver."""
        last = self.accuracies[-1].question
        for k, found in zip(self.counts, self.accuracies, strict=True):
            asked, plant = found.question, last.plant if k else remade(last.plant, C=0 * last.plant.C)
            even = np.array_equal(asked.schedule.gaps, [self.period / max(k, 1)])
            mine = np.array_equal(found.rows.matrix, self.rows.matrix) and np.array_equal(asked.bounds.w, last.bounds.w)
            if not (even and mine and plant.same_dynamics(asked.plant)):
                return False
        return all(found.verify() for found in self.accuracies)

    def _columns(self) -> Mapping[str, Column]:
        return {"samples": np.array(self.counts), **dict(zip(self.rows.labels(), self.upper.T, strict=True))}

    def _rows(self) -> list[tuple[str, str]]:
        return [(self._many(k), self._within(row)) for k, row in zip(self.counts, self.upper, strict=True)]

    def _many(self, count: int) -> str:
        every = f"every {short(self.period)} {self.accuracies[0].plant.time_unit}"
        return f"with {counted(count, 'sample')} {every}" if count else "without samples"

    def _within(self, row: Array) -> str:
        said = [
            f"{name} {above(x, 3)}{unit and f' {unit}'}" if np.isfinite(x) else f"{name} has no bound"
            for name, unit, x in zip(self.rows.names, self.rows.units, row, strict=True)
        ]
        return ", ".join(said)

    def explain(self) -> str:
        """Say what samples buy."""
        bounds = " ".join(f"{what[0].upper()}{what[1:]}: {within}." for what, within in self._rows())
        wide = "" if self.closed else " Proven, but not as sharp as can be: a larger `budget` narrows it."
        return f"Whatever disturbances and noise do within their bounds, errors stay within these. {bounds}{wide}"


@checked
def accuracy_by_count(
    plant: Plant,
    counts: Sequence[int],
    *,
    period: float,
    w_bound: Bound = None,
    v_bound: NoiseBound = None,
    of: Wanted = None,
    rtol: float = 0.02,
    budget: float | None = None,
) -> AccuracyByCount:
    """Return what samples buy: the guaranteed accuracy of so many evenly spaced samples per period, and of none.

        0 samples:  sup { c'x(t) : w within its bound },   finite where c shows only modes that decay

    Parameters
    ----------
    plant : Plant
    counts : sequence of int
        Samples per period; 0 for none at all.
    period : float [plant.time_unit]
    w_bound, v_bound : float, array or mapping
        As for `guaranteed_accuracy`.
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states.
    rtol : float
        Relative width of the brackets.
    budget : float, optional [seconds]
        Of all counts together; brackets are wider then, and proven all the same.

    Returns
    -------
    AccuracyByCount
        A table: `to_frame()` has a row for each count.

    Raises
    ------
    ArgumentError
        If there is no count or one is no whole number from 0 on, or as for `guaranteed_accuracy`.

    Notes
    -----
    *Assumptions.* Those of `guaranteed_accuracy`. *Claim.* `upper` is proven and `lower` attained. *Method.* Without
    samples the plant has one sensor that reads 0 whatever the state is, so that nothing is learned from it.

    References
    ----------
    Micchelli and Rivlin, A survey of optimal recovery (1977).

    Examples
    --------
    >>> plant = Plant([[-0.1]], [[1.0]], time_unit="h", states=["level"])
    >>> found = accuracy_by_count(plant, (0, 1, 4), period=8.0, w_bound=0.1, v_bound=0.2)
    >>> print(found.upper[:, 0].round(2))
    [1.   0.64 0.35]
    """
    many = sorted({checks.whole("counts", each) for each in counts})
    if not many:
        raise ArgumentError("`counts` must hold a number of samples, got none: give (0, 4), say.")
    length, rows = checks.positive("period", period), requested_rows(plant, of)
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    unmeasured = remade(plant, C=0 * plant.C)
    found = []
    for done, k in enumerate(many):
        asked, noise, wanted = (plant, v_bound, of) if k else (unmeasured, 1.0, rows.matrix)
        schedule = PeriodicSchedule([length / max(k, 1)], time_unit=plant.time_unit)
        share = limit.seconds_left(LEAST, 1 / (len(many) - done))
        found.append(
            guaranteed_accuracy(asked, schedule, w_bound=w_bound, v_bound=noise, of=wanted, rtol=rtol, budget=share)
        )
    return AccuracyByCount(tuple(many), length, rows, tuple(found))
