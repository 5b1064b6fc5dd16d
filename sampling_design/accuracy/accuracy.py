"""The least error that any estimator can guarantee for wanted rows of the state, over a whole endless schedule."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.accuracy_profile import AccuracyProfile, GapProof
from sampling_design.accuracy.bounds import Bound, SignalBounds
from sampling_design.accuracy.deviation import Intensity, StandardDeviation, deviations
from sampling_design.accuracy.projection import Projection, shadow
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.rows import Wanted, WantedRows, wanted_rows
from sampling_design.accuracy.search import ChainSearch, RowSearch
from sampling_design.accuracy.start import InitialError
from sampling_design.accuracy.undetectable import DetectablePart
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, attains
from sampling_design.accuracy.worst_witness import left_open, strongest_witness
from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import meet
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.checks import freeze
from sampling_design.records.record import CurveRecord, Plain, Record, Variable, finite_or_nones, short
from sampling_design.records.signatures import open_verb
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

Array = npt.NDArray[np.float64]

MARGIN = 5e-5
"""By how much an upper bound is raised, so that balls prove it too, whose derivatives are bounded a little worse."""
RTOL = 0.01
"""Default width of the brackets, relative."""
MOST_SOLVES = 2000
"""Programs for one row; a bracket that is not closed by then says so."""


class AccuracyBracket(Record):
    """The least guaranteed error of each wanted row, bracketed: `lower` attained, `upper` guaranteed."""

    rows: WantedRows
    lower: Array
    upper: Array
    closed: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(AccuracyBracket, CurveRecord):
    """The least guaranteed error of each wanted row, bracketed, at the worst time of a schedule.

        lower <= sup over t of rho(c; t) <= upper

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
    rows : WantedRows
        Matrix, names and units of what is wanted.
    lower : (r,) array
        No estimator whatsoever guarantees less: attained by `witnesses`.
    upper : (r,) array
        Proven for all real times by gains: of an endless schedule whatever the error was in the distant past, of a
        finite one for all times at which the row is known at all.
    worst : (r,) array
        A time at which `lower` is attained; of an endless schedule not beyond its period.
    offset : (r,) array
        What the best estimate adds to its weighted data at that time since the bounds are not centred at 0; its
        error is then within `upper` on both sides.
    known_from : (r,) array
        From when on the row is known; minus infinity on an endless schedule, infinite if never.
    closed : (r,) bool array
        Whether the bracket met the tolerance asked for.
    at_samples : (r, N) array
        What gains prove at each sample, the sample included.
    profile : AccuracyProfile
    deviation : StandardDeviation or None
        The same rows for white noise, if its size was given.
    witnesses : tuple of AccuracyWitness
        In the coordinates of the known part where something is unknown; None for an infinite row.
    unknown : tuple of str
        Eigenvalues of the modes that no sample shows and that do not decay, or that the samples of a finite schedule do
        not determine: rows that they touch are infinite.
    """

    question: AccuracyQuestion
    rows: WantedRows
    lower: Array
    upper: Array
    worst: Array
    offset: Array
    known_from: Array
    closed: npt.NDArray[np.bool_]
    at_samples: Array
    profile: AccuracyProfile
    witnesses: tuple[AccuracyWitness | None, ...]
    unknown: tuple[str, ...]
    proof: tuple[GapProof, ...] = field(repr=False)
    deviation: StandardDeviation | None = None

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.question.plant

    @property
    def schedule(self) -> Schedule | PeriodicSchedule:
        """The schedule."""
        return self.question.schedule

    @property
    def bounds(self) -> SignalBounds:
        """Bounds on w and v; one row of v for each sample, and an empty one for a start that is no sample."""
        return self.question.bounds

    def shadow(self, first: str, second: str, t: float | None = None, directions: int = 24) -> Projection:
        """Return the exact set of what data may leave possible of two rows at one time (`accuracy.projection`)."""
        return shadow(self, first, second, t, directions)

    def verify(self, rigorous: bool = False) -> bool:
        """Whether both sides hold, recomputed from gains and witnesses without a solver.

        rigorous : bool
            In ball arithmetic (extra `rigorous`): True is then a theorem about the doubles of this record; False
            says that it was not decided, as for exact sensors. For endless schedules that show every mode.

        Raises
        ------
        ArgumentError
            If a rigorous proof is asked of a finite schedule, or where a mode is unknown.
        """
        known = self.question.known()
        if rigorous:
            if self.question.initial is not None or self.unknown:
                raise ArgumentError(
                    "`rigorous` is for endless schedules that show every mode; what else is known is decided "
                    "numerically. Leave it out."
                )
            return self._proven()
        return self._upper_holds(known) and all(self._lower_holds(k, known) for k in range(len(self.rows)))

    def _proven(self) -> bool:
        """Both sides in ball arithmetic."""
        from sampling_design.accuracy.rigorous import proven_above, proven_below

        chain, _ = self.question.chain(self.plant)
        below = all(
            bool(lower == 0) if witness is None else proven_below(witness, self.bounds, float(lower))
            for witness, lower in zip(self.witnesses, self.lower, strict=True)
        )
        return below and proven_above(chain, self.rows.matrix, self.upper, self.proof)

    def _upper_holds(self, known: DetectablePart) -> bool:
        lost = np.array([known.touches(row) for row in self.rows.matrix])
        if not np.all(np.isinf(self.upper[lost])):
            return False
        if lost.all():
            return True
        search = ChainSearch(*self.question.chain(known.plant, known.moving))
        for part in self.proof:
            for mu, gains in zip(part.directions, part.gains, strict=True):
                search.restore(part.sample, mu, gains)
        tops = []
        for k in np.flatnonzero(~lost):
            found = search.opened(self.rows.matrix[k] @ known.lift)
            open_ends = not any(np.isfinite(nodes).any() for nodes in found.nodes)
            tops.append(np.inf if open_ends else search.top(found)[0])
        return bool(np.all(tops <= self.upper[~lost] * (1 + KEPT)))

    def _lower_holds(self, k: int, known: DetectablePart) -> bool:
        witness = self.witnesses[k]
        if witness is None:
            return known.touches(self.rows.matrix[k]) or self.lower[k] == 0 or self.question.initial is not None
        value, excess = attains(witness, self.bounds, self.question.initial)
        return excess <= 1 + KEPT and value >= self.lower[k] * (1 - KEPT)

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        if isinstance(self.schedule, PeriodicSchedule):
            lines = [("samples per period", f"{len(self.schedule)} in {short(self.schedule.period)} {unit}")]
        else:
            span = f"from {short(self.question.nodes[0])} to {short(self.question.end)} {unit}"
            lines = [("samples", f"{len(self.schedule)}, {span}")]
        for k, label in enumerate(self.rows.labels()):
            text = f"{short(self.lower[k])} to {short(self.upper[k])}, worst at {short(self.worst[k])} {unit}"
            if not np.isfinite(self.upper[k]):
                text = f"without bound: {self._why()}"
            elif np.isinf(self.known_from[k]) and self.question.initial is not None:
                text += ", at single times only"
            elif self.known_from[k] > self.question.nodes[0]:
                text += f", unknown before {short(self.known_from[k])} {unit}"
            lines.append((label, text + ("" if self.closed[k] else " (not closed)")))
            if self.offset[k]:
                lines.append((f"offset of {label}", short(self.offset[k])))
        if self.notice:
            lines.append(("notice", self.notice))
        return lines + ([] if self.deviation is None else self.deviation.lines())

    def _why(self) -> str:
        names = ", ".join(self.unknown)
        if self.question.initial is not None:
            return f"the samples do not determine what belongs to the eigenvalue{'s' * (len(self.unknown) > 1)} {names}"
        return f"no sample shows {names}"

    @property
    def notice(self) -> str:
        """Say where the program is degenerate: exact sensors leave what is possible without interior."""
        exact = np.any(self.bounds.v == 0, axis=0)
        names = [name for name, zero in zip(self.plant.outputs.names, exact, strict=True) if zero]
        if not names:
            return ""
        return (
            f"Samples of {', '.join(names)} count as exact (noise bound 0): what is possible has no interior there, so "
            "that the program is degenerate. Both bounds hold; that they meet is not guaranteed."
        )

    def explain(self) -> str:
        """Say what can be guaranteed."""
        known = np.isfinite(self.upper)
        parts = [
            f"{n} within {short(u, 4)}" for n, u in zip(self.rows.labels(), self.upper, strict=True) if np.isfinite(u)
        ]
        lost = [name for name, sure in zip(self.rows.names, known, strict=True) if not sure]
        text = f"Of {', '.join(lost)} no bound holds at all times: {self._why()}. " if lost else ""
        if not parts:
            return text.strip()
        low, up = self.lower[known], self.upper[known]
        widths = np.divide(up, low, out=np.where(up > 0, np.inf, 1.0), where=low > 0) - 1
        width = float(np.max(widths))
        late = [k for k in np.flatnonzero(known) if self.known_from[k] > self.question.nodes[0]]
        within = f"brackets within {100 * width:.2g} %" if np.isfinite(width) else "0: nothing was attained"
        when = "At all times"
        if any(np.isinf(self.known_from[k]) for k in late):
            when = "Where the samples determine them"
        elif late:
            when = f"From {short(max(self.known_from[k] for k in late))} {self.plant.time_unit} on"
        return (
            f"{text}{when}, some estimator guarantees {', '.join(parts)}; none guarantees less than "
            f"{short(low, 4)} ({within})."
            + (f" {self.notice}" if self.notice else "")
            + ("" if self.deviation is None else f" {self.deviation.explain()}")
        )

    def _variables(self) -> dict[str, Variable]:
        profile, time = self.profile, self.plant.time_unit
        return {
            "row": Variable(("row",), np.array(self.rows.names, dtype=str)),
            "unit": Variable(("row",), np.array(self.rows.units, dtype=str)),
            "start": Variable(("cell",), profile.edges[:-1], time),
            "stop": Variable(("cell",), profile.edges[1:], time),
            "lower": Variable(("row", "cell"), profile.lower),
            "upper": Variable(("row", "cell"), profile.upper),
            "sample": Variable(("sample",), profile.samples, time),
            "worst": Variable(("row",), self.worst, time),
        }

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; what is infinite becomes None."""
        data: dict[str, Plain] = {
            "rows": {
                "names": list(self.rows.names),
                "units": list(self.rows.units),
                "matrix": self.rows.matrix.tolist(),
            },
            "time_unit": self.plant.time_unit,
            "schedule": self.schedule.to_dict(),
            "lower": finite_or_nones(self.lower),
            "upper": finite_or_nones(self.upper),
            "unknown": list(self.unknown),
            "worst": self.worst.tolist(),
            "offset": self.offset.tolist(),
            "known_from": finite_or_nones(self.known_from),
            "closed": self.closed.tolist(),
            "at_samples": [finite_or_nones(row) for row in self.at_samples],
            "profile": {
                "edges": self.profile.edges.tolist(),
                "lower": [finite_or_nones(row) for row in self.profile.lower],
                "upper": [finite_or_nones(row) for row in self.profile.upper],
            },
            "witnesses": [None if witness is None else witness.to_dict() for witness in self.witnesses],
        }
        return data if self.deviation is None else data | {"deviation": self.deviation.to_dict()}


@open_verb(AccuracyBracket)
def guaranteed_accuracy(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    *,
    w_bound: Bound = None,
    v_bound: Bound = None,
    of: Wanted = None,
    rtol: float | None = None,
    initial_error: InitialError = None,
    start: float | None = None,
    end: float | None = None,
    w_intensity: Intensity = None,
    v_deviation: Intensity = None,
) -> Accuracy:
    """Return the least error that any estimator can guarantee for wanted rows, at the worst time of a schedule.

        rho(c; t) = min over gains of  h(rest) + int h_W(G'g(s)) ds + sum h_V(lambda_j)
                  = sup { c'x(t) : w, v within their bounds, all y_j = 0 }

    Parameters
    ----------
    plant : Plant, UncertainPlant or TimeVaryingPlant
        With constant parameters in a box: the worst of its plants, each with an estimator that knows it. One that
        varies in time: a finite schedule within its horizon, bounds on each entry, five times of each gap looked at.
    schedule : PeriodicSchedule or Schedule
        Periodic: without end, and so long under way that its start no longer matters. Finite: from `start` to `end`.
    w_bound : float, (q,) array or mapping
        Bound on the Euclidean norm of w(t), or on each entry; 0 where there is none. A mapping gives each disturbance
        by name a number or an interval, a pair (lower, upper).
    v_bound : float, (p,) or (N, p) array, mapping, or function of the sample's time
        Bound on the Euclidean norm of the noise of a sample, on each output, or on each output of each sample of the
        schedule (a better instrument today); 0 for an exact sensor. A mapping gives each output by name a number, a
        pair, one for each sample, or a function of its time.
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states, each in its unit.
    rtol : float
        Relative width of the brackets; default 0.01, over a box 0.1.
    initial_error : float, (n,) or (n, n) array, or mapping, optional
        What is known of x(start) less its nominal value on a finite schedule: a bound on its Euclidean norm, on each
        entry (infinite: unknown), a weight P for e'P e <= 1, or by names of states. Default: nothing.
    start, end : float, optional
        Of a finite schedule; default its first and its last sample.
    w_intensity, v_deviation : float or array, optional
        Sizes of white noises, as for `standard_deviation`, which then stands beside.

    Returns
    -------
    Accuracy, AccuracyOverBox or AccuracyAlong
        With `verify()`, which recomputes both sides without a solver.

    Raises
    ------
    ArgumentError
        If a bound is missing, negative or of another shape, a name is unknown, a sample of a finite schedule lies
        outside `start` and `end`, or an endless one is given a start.

    Notes
    -----
    *Assumptions.* w is bounded at every time and v at every sample; nothing else is known of them, nor of the start.
    *Claim.* `upper` holds for all real times and is guaranteed by an affine estimate; no estimator, linear or not,
    guarantees less than `lower`. *Method.* The adversary's program, a cone program with w constant on cells, over
    windows that grow until the past no longer matters; both sides are evaluated without the solver. The distant past
    costs at most what a filter's gains prove of it. *Numerical aspects.* Coordinates come from the filter's covariance,
    so that units change nothing; integrals are bounded for all real times by the trapezoidal rule with its proven
    error. Whether finitely many samples determine a row from an unknown start is decided numerically. Intervals
    that are not centred at 0 shift the estimate (`offset`) and leave its half-width as it is; what is bounded on one
    side only says nothing before there are data. What composite samples will be worth is told by `interval` of readings
    that are all zero.

    References
    ----------
    Micchelli and Rivlin, A survey of optimal recovery (1977); Milanese and Tempo, Optimal algorithms theory for robust
    estimation and prediction (1985).

    Examples
    --------
    >>> import numpy as np
    >>> from sampling_design import Plant, PeriodicSchedule
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    >>> found = guaranteed_accuracy(plant, PeriodicSchedule([1.0, 0.6, 1.4]), w_bound=0.02, v_bound=0.1)
    >>> [round(float(x), 3) for x in found.upper]
    [0.269, 0.123]
    >>> found.verify()
    True
    """
    tolerance = checks.positive("rtol", RTOL if rtol is None else rtol)
    schedule = meet(plant, schedule)
    rows = wanted_rows(plant, of)
    if isinstance(schedule, PeriodicSchedule):
        given = [n for n, x in (("initial_error", initial_error), ("start", start), ("end", end)) if x is not None]
        if given:
            raise ArgumentError(
                f"`{given[0]}` is for finite schedules, got a PeriodicSchedule, which has no start. "
                "Cut it: schedule.between(start, end)."
            )
        question = AccuracyQuestion.endless(plant, schedule, w_bound, v_bound)
    else:
        question = AccuracyQuestion.finite(plant, schedule, w_bound, v_bound, initial_error, start, end)
    deviation = None
    if w_intensity is not None or v_deviation is not None:
        deviation = deviations(question, rows, w_intensity, v_deviation)
    known = question.known()
    safe = [k for k, row in enumerate(rows.matrix) if not known.touches(row)]
    search = ChainSearch(*question.chain(known.plant, known.moving)) if safe else None
    found: dict[int, RowSearch] = {}
    if search is not None:
        for k in safe:
            found[k] = search.row(rows.matrix[k] @ known.lift, tolerance, MOST_SOLVES)
            search.profile(found[k])
    return replace(_record(question, rows, known, search, found, tolerance), deviation=deviation)


def _record(
    question: AccuracyQuestion,
    rows: WantedRows,
    known: DetectablePart,
    finder: ChainSearch | None,
    found: dict[int, RowSearch],
    rtol: float,
) -> Accuracy:
    times, count, plain = question.nodes, len(rows), question.initial is None
    lengths = np.diff(times, append=question.end)
    grids = (
        [opened.d for opened in next(iter(found.values())).opened] if found else [np.array([0.0, h]) for h in lengths]
    )
    edges = np.concatenate([*(t + d[:-1] for t, d in zip(times, grids, strict=True)), [question.end]])
    lower, upper, worst = np.full(count, np.inf), np.full(count, np.inf), np.full(count, times[0])
    closed, offsets = np.ones(count, dtype=bool), np.zeros(count)
    known_from = np.full(count, np.inf)
    at_samples = np.full((count, len(times)), np.inf)
    below, above = np.full((2, count, edges.size - 1), np.inf)
    witnesses: list[AccuracyWitness | None] = [None] * count
    proof: tuple[GapProof, ...] = ()
    for k, search in found.items():
        assert finder is not None
        again = finder.opened(search.row)  # with what was found for the rows after it
        at_samples[k] = [nodes[0] for nodes in again.nodes]
        above[k] = np.concatenate(again.panels)
        attained = [
            np.where(np.isfinite(nodes), finder.attained(again, j), np.inf) for j, nodes in enumerate(again.nodes)
        ]
        below[k] = np.concatenate([part[:-1] for part in attained])
        if not np.isfinite(at_samples[k]).any() and not np.isfinite(above[k]).any():
            continue
        witness, j, offset = strongest_witness(finder, search.row, question, again)
        witnesses[k], lower[k] = witness, witness.value * (1 - KEPT)
        upper[k] = finder.top(again)[0] * (1 + MARGIN)
        worst[k] = times[j] + again.opened[j].d[offset]
        if plain and worst[k] > question.end - times[0]:
            worst[k] -= question.end - times[0]
        offsets[k] = finder.offset(again, j, offset)
        closed[k] = upper[k] <= (1 + rtol) * witness.value
        open_ends = np.flatnonzero(np.isinf(above[k]))
        late = open_ends[-1] + 1 if open_ends.size else 0
        known_from[k] = -np.inf if plain else edges[late] if late < edges.size - 1 else np.inf
    if finder is not None:
        proof = tuple(GapProof(j, freeze(a.mu), tuple(g.gains for g in a.gains)) for j, a in enumerate(finder.atoms))
    return Accuracy(
        question=question,
        rows=rows,
        lower=freeze(lower),
        upper=freeze(upper),
        worst=freeze(worst),
        offset=freeze(offsets),
        known_from=freeze(known_from),
        closed=closed,
        at_samples=freeze(at_samples[:, question.samples]),
        profile=AccuracyProfile(freeze(edges), freeze(below), freeze(above), freeze(times[question.samples])),
        witnesses=tuple(witnesses),
        unknown=known.modes if plain else left_open(question, finder, upper),
        proof=proof,
    )
