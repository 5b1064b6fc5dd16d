"""The least error that any estimator can guarantee for wanted rows of the state, over a whole endless schedule."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design._door import door
from sampling_design._record import Plain, Record, short
from sampling_design.errors import ArgumentError
from sampling_design.observability.meeting import meet
from sampling_design.plants.plant import Plant
from sampling_design.recovery.atoms import Atoms
from sampling_design.recovery.bounds import SignalBounds
from sampling_design.recovery.chain import SampleChain, endless_chain
from sampling_design.recovery.rows import Wanted, WantedRows, wanted_rows
from sampling_design.recovery.search import ChainSearch, RowSearch
from sampling_design.recovery.unknown import Known, known_part
from sampling_design.recovery.witness import KEPT, AccuracyWitness, attains, physical
from sampling_design.schedules.schedule import PeriodicSchedule

Array = npt.NDArray[np.float64]

MOST_SOLVES = 2000
"""Programs for one row; a bracket that is not closed by then says so."""


@dataclass(frozen=True, eq=False)
class GapProof:
    """Gains for some directions at one sample: what bounds every row from above over the gap that follows.

    Attributes
    ----------
    sample : int
        Its place in the schedule's period.
    directions : (m, n) array
        In the coordinates of the chain.
    gains : tuple of tuple of arrays
        For each direction, the gains of the samples back in time, the latest last, in units of v_bound.
    """

    sample: int
    directions: Array
    gains: tuple[tuple[Array, ...], ...]


@dataclass(frozen=True, eq=False)
class AccuracyProfile:
    """Both bounds over one period: `upper` holds all along [edges[k], edges[k+1]], `lower` is attained at edges[k].

    Attributes
    ----------
    edges : (N+1,) array
        From the first sample of a period on [the plant's time unit].
    lower : (r, N) array
    upper : (r, N) array
    samples : (m,) array
        Sample times of the period.
    """

    edges: Array
    lower: Array
    upper: Array
    samples: Array


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(Record):
    """The least guaranteed error of each wanted row, bracketed, at the worst time of an endless schedule.

        lower <= sup over t of rho(c; t) <= upper

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule
    rows : WantedRows
        Matrix, names and units of what is wanted.
    lower : (r,) array
        No estimator whatsoever guarantees less: attained by `witnesses`.
    upper : (r,) array
        Proven for all real times by gains, whatever the error was in the distant past.
    worst : (r,) array
        A time in the period at which `lower` is attained.
    closed : (r,) bool array
        Whether the bracket met the tolerance asked for.
    at_samples : (r, N) array
        What gains prove at each sample of the period, the sample included.
    profile : AccuracyProfile
    witnesses : tuple of AccuracyWitness
        In the coordinates of the known part where something is unknown; None for an infinite row.
    unknown : tuple of str
        Eigenvalues of the modes that no sample shows and that do not decay: rows that they touch are infinite.
    """

    plant: Plant
    schedule: PeriodicSchedule
    rows: WantedRows
    bounds: SignalBounds
    lower: Array
    upper: Array
    worst: Array
    closed: npt.NDArray[np.bool_]
    at_samples: Array
    profile: AccuracyProfile
    witnesses: tuple[AccuracyWitness | None, ...]
    unknown: tuple[str, ...]
    proof: tuple[GapProof, ...] = field(repr=False)

    def verify(self) -> bool:
        """Whether both sides hold, recomputed from gains and witnesses without a solver."""
        return self._upper_holds() and all(self._lower_holds(k) for k in range(len(self.rows)))

    def _upper_holds(self) -> bool:
        known = _known(self.plant, self.schedule, self.bounds)
        lost = np.array([known.touches(row) for row in self.rows.matrix])
        if not np.all(np.isinf(self.upper[lost])):
            return False
        if lost.all():
            return True
        search = ChainSearch(_chain(known.plant, self.schedule, self.bounds))
        for part in self.proof:
            for mu, gains in zip(part.directions, part.gains, strict=True):
                search.restore(part.sample, mu, gains)
        rows = self.rows.matrix[~lost] @ known.lift
        tops = [max(float(np.max(panels)) for panels in search.opened(row).panels) for row in rows]
        return bool(np.all(tops <= self.upper[~lost] * (1 + KEPT)))

    def _lower_holds(self, k: int) -> bool:
        witness = self.witnesses[k]
        if witness is None:
            known = _known(self.plant, self.schedule, self.bounds)
            return known.touches(self.rows.matrix[k]) or self.lower[k] == 0
        value, excess = attains(witness, self.bounds)
        return excess <= 1 + KEPT and value >= self.lower[k] * (1 - KEPT)

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        lines = [("samples per period", f"{len(self.schedule)} in {short(self.schedule.period)} {unit}")]
        for k, label in enumerate(self.rows.labels()):
            text = f"{short(self.lower[k])} to {short(self.upper[k])}, worst at {short(self.worst[k])} {unit}"
            text = (
                text if np.isfinite(self.upper[k]) else f"unknown for ever: no sample shows {', '.join(self.unknown)}"
            )
            lines.append((label, text + ("" if self.closed[k] else " (not closed)")))
        return lines

    def explain(self) -> str:
        """Say what can be guaranteed."""
        known = np.isfinite(self.upper)
        parts = [
            f"{n} within {short(u, 4)}" for n, u in zip(self.rows.labels(), self.upper, strict=True) if np.isfinite(u)
        ]
        lost = [name for name, sure in zip(self.rows.names, known, strict=True) if not sure]
        text = (
            f"Of {', '.join(lost)} nothing can ever be known: no sample shows {', '.join(self.unknown)}. "
            if lost
            else ""
        )
        if not parts:
            return text.strip()
        low, up = self.lower[known], self.upper[known]
        width = float(np.max(np.divide(up, low, out=np.ones_like(up), where=low > 0))) - 1
        return (
            f"{text}At all times, some estimator guarantees {', '.join(parts)}; none guarantees less than "
            f"{short(low, 4)} (brackets within {100 * width:.2g} %)."
        )

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {
            "rows": {
                "names": list(self.rows.names),
                "units": list(self.rows.units),
                "matrix": self.rows.matrix.tolist(),
            },
            "time_unit": self.plant.time_unit,
            "schedule": self.schedule.to_dict(),
            "lower": _finite(self.lower),
            "upper": _finite(self.upper),
            "unknown": list(self.unknown),
            "worst": self.worst.tolist(),
            "closed": self.closed.tolist(),
            "at_samples": [_finite(row) for row in self.at_samples],
            "profile": {
                "edges": self.profile.edges.tolist(),
                "lower": [_finite(row) for row in self.profile.lower],
                "upper": [_finite(row) for row in self.profile.upper],
            },
            "witnesses": [None if witness is None else witness.to_dict() for witness in self.witnesses],
        }


@door
def accuracy(
    plant: Plant,
    schedule: PeriodicSchedule,
    *,
    w_bound: npt.ArrayLike | None = None,
    v_bound: npt.ArrayLike | None = None,
    of: Wanted = None,
    rtol: float = 0.01,
) -> Accuracy:
    """Return the least error that any estimator can guarantee for wanted rows, at the worst time of a schedule.

        rho(c; t) = min over gains of  h(rest) + int h_W(G'g(s)) ds + sum h_V(lambda_j)
                  = sup { c'x(t) : w, v within their bounds, all y_j = 0 }

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule
        Without end; so long under way that its start no longer matters.
    w_bound : float or (q,) array
        Bound on the Euclidean norm of w(t), or on each entry; 0 where there is none.
    v_bound : float, (p,) or (N, p) array
        Bound on the Euclidean norm of the noise of a sample, on each output, or on each output of each sample of the
        period (a better instrument today); 0 for an exact sensor.
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states, each in its unit.
    rtol : float
        Relative width of the brackets.

    Returns
    -------
    Accuracy
        With `verify()`, which recomputes both sides without a solver.

    Raises
    ------
    ArgumentError
        If a bound is missing, negative or of another shape, a name is unknown, or the schedule is not periodic.

    Notes
    -----
    *Assumptions.* w is bounded at every time and v at every sample; nothing else is known of them, nor of the start.
    *Claim.* `upper` holds for all real times and is guaranteed by an affine estimate; no estimator, linear or not,
    guarantees less than `lower`. *Method.* The adversary's program, a cone program with w constant on cells, over
    windows that grow until the past no longer matters; both sides are evaluated without the solver. The distant past
    costs at most what a filter's gains prove of it. *Numerical aspects.* Coordinates come from the filter's covariance,
    so that units change nothing; integrals are bounded for all real times by the trapezoidal rule with its proven
    error.

    References
    ----------
    Micchelli and Rivlin, A survey of optimal recovery (1977); Milanese and Tempo, Optimal algorithms theory for robust
    estimation and prediction (1985).

    Examples
    --------
    >>> import numpy as np
    >>> from sampling_design import Plant, PeriodicSchedule
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    >>> found = accuracy(plant, PeriodicSchedule([1.0, 0.6, 1.4]), w_bound=0.02, v_bound=0.1)
    >>> [round(float(x), 3) for x in found.upper]
    [0.269, 0.123]
    >>> found.verify()
    True
    """
    if not isinstance(schedule, PeriodicSchedule):
        raise ArgumentError(
            f"`schedule` must be a PeriodicSchedule, got {type(schedule).__name__}: its accuracy is that without end."
        )
    schedule = meet(plant, schedule)
    tolerance = _checks.positive("rtol", rtol)
    rows = wanted_rows(plant, of)
    bounds = SignalBounds.of(plant, len(schedule), schedule.outputs, w_bound, v_bound)
    known = _known(plant, schedule, bounds)
    safe = [k for k, row in enumerate(rows.matrix) if not known.touches(row)]
    search = ChainSearch(_chain(known.plant, schedule, bounds)) if safe else None
    found: dict[int, RowSearch] = {}
    if search is not None:
        for k in safe:
            found[k] = search.row(rows.matrix[k] @ known.lift, tolerance, MOST_SOLVES)
            search.profile(found[k])
    return _record(plant, schedule, rows, bounds, known, search, found, tolerance)


def _known(plant: Plant, schedule: PeriodicSchedule, bounds: SignalBounds) -> Known:
    """The plant without what the schedule can never show."""
    outputs = [bounds.measured(j) for j in range(len(schedule))]
    return known_part(plant, schedule.times, schedule.period, outputs)


def _chain(plant: Plant, schedule: PeriodicSchedule, bounds: SignalBounds) -> SampleChain:
    """The chain whose gap j lies behind sample j."""
    return endless_chain(plant, np.roll(schedule.gaps, -1), bounds)


def _record(
    plant: Plant,
    schedule: PeriodicSchedule,
    rows: WantedRows,
    bounds: SignalBounds,
    known: Known,
    finder: ChainSearch | None,
    found: dict[int, RowSearch],
    rtol: float,
) -> Accuracy:
    times, first, count = schedule.times, schedule.times[0], len(rows)
    grids = (
        [opened.d for opened in next(iter(found.values())).opened]
        if found
        else [np.array([0.0, h]) for h in np.roll(schedule.gaps, -1)]
    )
    edges = np.concatenate([*(t + d[:-1] for t, d in zip(times, grids, strict=True)), [first + schedule.period]])
    lower, upper, worst = np.full(count, np.inf), np.full(count, np.inf), np.full(count, first)
    closed = np.ones(count, dtype=bool)
    at_samples = np.full((count, len(times)), np.inf)
    below, above = np.full((2, count, edges.size - 1), np.inf)
    witnesses: list[AccuracyWitness | None] = [None] * count
    proof: tuple[GapProof, ...] = ()
    for k, search in found.items():
        assert finder is not None
        witness, offset = _flown(finder, search.row, bounds, search)
        gaps = range(len(times))
        again = finder.opened(search.row)  # with what was found for the rows after it
        witnesses[k], lower[k] = witness, witness.value
        upper[k] = max(float(np.max(panels)) for panels in again.panels)
        worst[k] = times[witness.last] + again.opened[witness.last].d[offset]
        closed[k] = upper[k] <= (1 + rtol) * witness.value
        at_samples[k] = [nodes[0] for nodes in again.nodes]
        below[k] = np.concatenate([finder.attained(again, j)[:-1] for j in gaps])
        above[k] = np.concatenate(again.panels)
    if finder is not None:
        proof = tuple(_proof(j, atoms) for j, atoms in enumerate(finder.atoms))
    return Accuracy(
        plant,
        schedule,
        rows,
        bounds,
        freeze(lower),
        freeze(upper),
        freeze(worst),
        closed,
        freeze(at_samples),
        AccuracyProfile(freeze(edges), freeze(below), freeze(above), times),
        tuple(witnesses),
        known.modes,
        proof,
    )


def _flown(finder: ChainSearch, row: Array, bounds: SignalBounds, found: RowSearch) -> tuple[AccuracyWitness, int]:
    """The strongest strike as a witness that is flown anew and made admissible, and its offset."""
    best: tuple[AccuracyWitness, int] | None = None
    strikes = []
    for j, opened in enumerate(found.opened):
        for strike in finder.strikes[j]:
            values = np.abs(opened.mu @ strike.end) + opened.below
            strikes.append((float(np.max(values)), int(np.argmax(values)), strike))
    for value, offset, strike in sorted(strikes, key=lambda a: -a[0]):
        if best is not None and best[0].value >= value:
            break
        witness = physical(row, found.opened[strike.sample], strike, offset)
        value, excess = attains(witness, bounds)
        factor = max(excess, 1.0)
        w, states = freeze(witness.w / factor), freeze(witness.states / factor)
        witness = replace(witness, w=w, states=states, value=value / factor)
        if best is None or witness.value > best[0].value:
            best = witness, offset
    assert best is not None
    return best


def _finite(values: Array) -> list[float | None]:
    """Plain numbers; what is infinite becomes None."""
    return [float(x) if np.isfinite(x) else None for x in values]


def _proof(j: int, atoms: Atoms) -> GapProof:
    return GapProof(j, freeze(atoms.mu), tuple(gains.gains for gains in atoms.gains))
