"""What the data at hand prove: the values that a wanted row may still have, with the gains that prove it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy import interval_file
from sampling_design.accuracy.bounds import Bound
from sampling_design.accuracy.disproof import Disproof, disprove, program_of
from sampling_design.accuracy.readings import Arrived, Readings
from sampling_design.accuracy.record_program import DISPROVED, RecordProgram
from sampling_design.accuracy.record_readings import beginning, left_out, read_record
from sampling_design.accuracy.record_rows import arrived
from sampling_design.accuracy.undetectable import OTHER_STATES, modes_with
from sampling_design.checkers.check import verdict
from sampling_design.errors import ArgumentError
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, freeze
from sampling_design.records.record import Plain, PlainRecord, TableRecord, above, below, counted, moment
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound


@dataclass(frozen=True, eq=False, repr=False)
class Interval(TableRecord, PlainRecord):
    """The values that the data leave possible, for each wanted row.

        lower <= z <= upper,    upper = c'xbar + min over gains of sum lambda'y + b(lambda),   lower = -upper(-c)

    Attributes
    ----------
    readings : Readings
        All that it was made from.
    t : float
    rows : RequestedRows
    lower, upper : (r,) arrays
    gains : (r, 2, R) array
        Proof of the upper and of the lower end: one number for each row that was read, in plain units.
    scales : (n,) array
        Sizes of the states in which the proof's integrals are evaluated; any will do.
    outer : (r, 2) array or None
        Lower and upper ends that are proven elsewhere (an estimator's ellipsoid); where one is the tighter, it is
        the end.
    disproof : Disproof or None
        Where the data contradict the bounds; the ends are NaN then.
    cases : tuple of Interval
        Where some samples may be outliers: the interval without each set of them, of which this one holds all that the
        rest does not contradict; its own gains are 0.
    """

    readings: Readings
    t: float
    rows: RequestedRows
    lower: Array
    upper: Array
    gains: Array = field(repr=False)
    scales: Array = field(repr=False)
    outer: Array | None = None
    disproof: Disproof | None = None
    cases: tuple[Interval, ...] = field(default=(), repr=False)

    _frame = "row:rows.names unit:rows.units lower upper centre radius:radii"
    _plain = "t rows{names matrix} lower upper contradiction gains disproof"

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.readings.plant

    @property
    def contradiction(self) -> float:
        """0 where the data agree with the bounds, else the least factor by which all of them would have to grow."""
        return 0.0 if self.disproof is None else self.disproof.factors["all"]

    @property
    def samples(self) -> Index:
        """Samples that make nine tenths of a contradiction, the strongest first."""
        return np.zeros(0, dtype=np.intp) if self.disproof is None else self.disproof.samples

    @property
    def centre(self) -> Array:
        """The best point: no other estimate has a smaller largest error. NaN where a row is unbounded both ways."""
        with np.errstate(invalid="ignore"):
            return freeze((self.lower + self.upper) / 2)

    @property
    def radii(self) -> Array:
        """Half-widths."""
        return freeze((self.upper - self.lower) / 2)

    def radii_from(self, z: npt.ArrayLike) -> Array:
        """Return the distance from an estimate z (r,) of the rows to the far ends: what its error is at most."""
        z = checks.vector("z", z, len(self.rows))
        return freeze(np.maximum(self.upper - z, z - self.lower))

    def holds(self, truth: npt.ArrayLike) -> bool:
        """Whether rows of the state `truth` lie in their intervals."""
        z = self.rows.matrix @ checks.vector("truth", truth, self.plant.n_states)
        return bool(np.all((self.lower <= z) & (z <= self.upper)))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write what was read, the bounds and the gains as JSON, with the ends that the gains alone prove.

        Parameters
        ----------
        path : path
            Ends in .json. `Interval.read` reads it, `sampling-design verify` and the standalone checkers prove it.

        Returns
        -------
        Path
            The file, written whole or not at all.

        Raises
        ------
        ArgumentError
            If the ending is another one, or samples may be outliers.
        """
        if self.cases:
            raise ArgumentError(
                "`save` writes one proof: where samples may be outliers each of the `cases` has its own."
            )
        return interval_file.write_tree(self._sealed(), path)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Interval:
        """Read an interval from the file that `save` wrote.

        Parameters
        ----------
        path : path

        Returns
        -------
        Interval
            Not yet proven again: call `verify()`.

        Raises
        ------
        FileFormatError
            If the file is missing, cut off, altered, or holds something else.
        """
        found, plant = interval_file.read_tree(path)
        readings, rows = interval_file.readings_of(found, plant)
        lower, upper = _ends(found.ends)
        disproof, scales = None, freeze(found.scales)
        if found.factors is not None:
            factors = {which: factor for which, (factor, _) in found.factors.items()}
            gains = {which: freeze(own) for which, (_, own) in found.factors.items()}
            disproof = Disproof(readings, factors, gains, scales)
            lower = upper = freeze(np.full(len(rows), np.nan))
        return cls(readings, found.t, rows, lower, upper, freeze(found.gains), scales, disproof=disproof)

    def _sealed(self) -> dict[str, Plain]:
        if self.t < self.readings.times[-1]:
            raise ArgumentError("A file of an interval is of its last sample or later: of earlier times call verify().")
        readings, found = self.readings, self.disproof
        lower, upper, proof = np.full(len(self.rows), -np.inf), np.full(len(self.rows), np.inf), None
        program = program_of(readings, self.scales)
        if found is None:
            for k, row in enumerate(self.rows.matrix):
                up, down = program.upper(self.t, row, self.gains[k, 0]), program.upper(self.t, -row, self.gains[k, 1])
                upper[k] = up.value + interval_file.STATED * up.width
                lower[k] = -down.value - interval_file.STATED * down.width
        else:  # worked out again, as the ends are: what was read from a file is written as it stood there
            proof = {which: program.growth(which, own) for which, own in found.gains.items()}, found.gains
        return interval_file.tree_of(readings, self.t, self.rows, (lower, upper), self.gains, self.scales, proof)

    def verify(self, rigorous: bool = False) -> bool:
        """Whether the gains prove both ends (or the contradiction), evaluated without a solver; `outer` is a premise.

        Parameters
        ----------
        rigorous : bool
            With every rounding bounded, as the standalone checkers do it, for the ends that `save` writes (wider by a
            millionth; those of the gains alone where an ellipsoid is tighter).
        """
        if self.cases:
            mine = all(case.t == self.t and np.array_equal(case.rows.matrix, self.rows.matrix) for case in self.cases)
            return mine and all(case.verify(rigorous) for case in self.cases) and _holds_all(self, self.cases)
        if rigorous:
            return self.verify() and verdict(self._sealed()).passed
        if self.disproof is not None:
            nothing = np.isnan(self.lower).all() and np.isnan(self.upper).all()
            return bool(nothing) and replace(self.disproof, readings=self.readings).verify()
        program = program_of(self.readings, self.scales)
        ends = np.array([self.lower, self.upper]).T
        for k, row in enumerate(self.rows.matrix):
            for side, sign in enumerate((1.0, -1.0)):
                own = program.upper(self.t, sign * row, self.gains[k, side])
                proven = own.again
                if self.outer is not None:
                    proven = min(proven, sign * self.outer[k, 1 - side])
                if not proven <= sign * ends[k, 1 - side]:
                    return False
        return True

    _answers = (
        "the values that data and bounds leave possible at {_moment} {plant.time_unit}",
        "proven: gains for each end",
        "{_half_widths}",
        "`.verify()`",
    )

    def _half_widths(self) -> str:
        if self.disproof is not None:
            return "no value is left: the data contradict the bounds"
        return f"half-widths {above((self.upper - self.lower) / 2)}"

    def _rows(self) -> list[tuple[str, str]]:
        count = int(np.sum(np.diff(self.readings.offsets) > 0))
        lines = [("samples", str(count))]
        if self.disproof is not None:
            return [*lines, *self.disproof._rows()]
        ends = zip(self.rows.labels(), self.lower, self.upper, strict=True)
        return [*lines, *((label, f"{below(a)} to {above(b)}") for label, a, b in ends)]

    def _moment(self) -> str:
        return moment(self.t)

    def explain(self) -> str:
        """Say what the data prove."""
        if self.disproof is not None:
            return self.disproof.explain()
        labels, bounded = self.rows.labels(), np.isfinite(self.lower) | np.isfinite(self.upper)
        ends = list(zip(labels, self.lower, self.upper, bounded, strict=True))
        said = [f"{n} from {below(a, 4)} to {above(b, 4)}" for n, a, b, known in ends if known]
        sentences = [f"The data prove {', '.join(said)}."] if said else []
        if not bounded.all():
            names = ", ".join(n for n, *_, known in ends if not known)
            modes = self.unobservable_modes
            why = f"no reading shows {modes_with(modes)}" if modes else self._few()
            sentences.append(f"They prove no bound of {names}: {why}.")
        return " ".join([*sentences, *([self.notice] if self.notice else [])]) or "No row was asked for."

    def _few(self) -> str:
        """Why nothing is proven, though readings of every mode are there."""
        read, n = self.readings, self.plant.n_states
        plain = int(np.count_nonzero(~read.below))
        if plain < n:
            return f"{counted(plain, 'reading')} (limits do not count) for {counted(n, 'state')}"
        hidden = f"rounding in these coordinates hides that they do. {OTHER_STATES[:-1]}"
        return f"these readings may not determine it, or {hidden}"

    @property
    def notice(self) -> str:
        """Say where the program is degenerate: readings that count as exact leave a set without interior."""
        rows = [row for rows in self.readings.rows for row in rows if row.size == 0 and not row.below]
        exact = {row.H.tobytes() for row in rows}
        outputs = zip(self.plant.outputs.names, self.plant.C, strict=True)
        names = [name for name, row in outputs if row.tobytes() in exact]
        if not names:
            return ""
        return (
            f"Readings of {', '.join(names)} count as exact (noise bound 0): what is possible has no interior, the "
            "ends are proven but need not be attained, and rounding alone may contradict such data."
        )

    @property
    def unobservable_modes(self) -> tuple[str, ...]:
        """Eigenvalues that no output that was read shows, in words."""
        measured = {row.H.tobytes(): row.H for rows in self.readings.rows for row in rows if not row.below}
        C = np.array([*measured.values(), np.zeros(self.plant.n_states)])
        found = unobservable_modes(Plant(self.plant.A, C)).eigenvalues
        return tuple(dict.fromkeys(format_eigenvalue(complex(value)) for value in found))


@checked
def state_interval(
    plant: Plant,
    record: Iterable[Arrived],
    t: float | None = None,
    *,
    prior: npt.ArrayLike | None = None,
    prior_time: float | None = None,
    w_bound: Bound = None,
    v_bound: Bound = None,
    initial_error: VectorBound = None,
    of: Wanted = None,
    outliers: int | tuple[int, int] = 0,
) -> Interval:
    """Return the values of wanted rows that the data leave possible, with gains that prove them.

    Parameters
    ----------
    plant : Plant
    record : Measurements or iterable of (t, y, u)
        In any order of time; y is NaN where not measured, u holds from t on. An entry of y may be
        `BelowDetection(0.5)`, `AboveRange(8)` (limits) or `CompositeReading(3.1, since=0.0)` (a composite sample).
    t : float, optional
        From the start on, before the last sample what all samples say of that time; default the last sample.
    prior : (n,) array, optional
        Default 0.
    prior_time : float, optional
        Not after the first sample; default the first sample.
    w_bound, v_bound : float, array, mapping, or for v a function of time
        As for `guaranteed_accuracy`: a number bounds the norm, entries bound each, a mapping names them and may hold
        pairs (lower, upper); `v_bound` may have a row for each sample in order of time.
    initial_error : float or (n,) array, optional
        Bound on |x - prior| at `prior_time`, Euclidean or entry by entry. Default: nothing is known.
    of : str, sequence of str, or (r, n) array, optional
        As for `guaranteed_accuracy`.
    outliers : int or (int, int)
        At most so many samples (of the last so many) may show anything. The work is that of one interval for each
        set that may be left out.

    Returns
    -------
    Interval

    Raises
    ------
    ArgumentError
        If a bound is missing or of another shape, the record is empty or begins before `prior_time`, a row of it says
        nothing or what another one of its time contradicts, or `t` lies before its start.

    Notes
    -----
    *Assumptions.* w, v (but for `outliers`) and the initial error keep their bounds. *Claim.* Each row lies in its
    interval. Every value in it is possible, up to the width of the cells on which w is constant, where times are known
    and all samples count: one whose time is uncertain counts as limits at the middle of its span, which may leave more,
    and with `outliers` there may be gaps between what the `cases` leave. If the data contradict the bounds, the gains
    prove it. *Method.* The adversary's program with the data in place of zeros; its multipliers are gains, evaluated
    without the solver.

    References
    ----------
    Milanese and Tempo, Optimal algorithms theory for robust estimation and prediction (1985).

    Examples
    --------
    >>> from sampling_design import Plant
    >>> visits = [(0.0, [1.0], None), (1.0, [1.5], None)]
    >>> found = state_interval(Plant([[0.0]], [[1.0]]), visits, w_bound=0.1, v_bound=0.3)
    >>> found.lower.round(6), found.upper.round(6)
    (array([1.2]), array([1.4]))
    """
    items, at = arrived(record, plant), None if t is None else checks.number("t", t)
    readings = read_record(plant, items, w_bound, v_bound, initial_error, prior, prior_time, at)
    rows = requested_rows(plant, of)
    at = float(readings.times[-1]) if at is None else at
    if outliers == 0:
        return prove(RecordProgram(readings), at, rows)
    begun = beginning(items) if prior_time is None else prior_time
    samples = [k for k, row in enumerate(items) if row.y is not None]
    cases = []
    for out in left_out(outliers, len(samples)):
        gone = {samples[k] for k in out}
        rest = [row._replace(y=None, censored=()) if k in gone else row for k, row in enumerate(items)]
        noise = np.delete(np.asarray(v_bound), out, axis=0) if np.ndim(v_bound) == 2 else v_bound  # type: ignore[arg-type]
        read = read_record(plant, rest, w_bound, noise, initial_error, prior, begun, at)
        cases.append(prove(RecordProgram(read), at, rows))
    return _united(readings, tuple(cases))


def _united(readings: Readings, cases: tuple[Interval, ...]) -> Interval:
    """The interval that holds all cases that do not contradict themselves; the mildest contradiction where all do."""
    possible = [case for case in cases if case.disproof is None]
    if not possible:
        mildest = min(cases, key=lambda case: case.contradiction)
        return replace(mildest, cases=cases)
    lower, upper = np.min([case.lower for case in possible], axis=0), np.max([case.upper for case in possible], axis=0)
    first, gains = possible[0], freeze(np.zeros((len(lower), 2, len(readings.y))))
    return Interval(readings, first.t, first.rows, freeze(lower), freeze(upper), gains, first.scales, cases=cases)


def _holds_all(found: Interval, cases: Sequence[Interval]) -> bool:
    """Whether an interval holds those of the cases that do not contradict themselves; without one, it has no ends."""
    possible = [case for case in cases if case.disproof is None]
    if not possible:
        return found.disproof is not None and bool(np.isnan(found.upper).all())
    return all(bool(np.all((found.lower <= case.lower) & (case.upper <= found.upper))) for case in possible)


def _ends(pairs: Sequence[tuple[float | None, float | None]]) -> tuple[Array, Array]:
    """Ends of a file, infinite where there is none."""
    lower = [-np.inf if low is None else low for low, _ in pairs]
    return freeze(lower), freeze([np.inf if high is None else high for _, high in pairs])


def prove(program: RecordProgram, t: float, rows: RequestedRows, outer: Array | None = None) -> Interval:
    """Return the interval of each row at t, or the proof that the data contradict the bounds."""
    ends, readings = program.solve(t, rows.matrix, stops=True), program.readings
    if program.seems_infeasible or any(
        up.value + down.value < -DISPROVED * (up.width + down.width) for up, down in ends
    ):
        disproof = disprove(program, [up.gains + down.gains for up, down in ends])
        if disproof is not None:
            nothing = freeze(np.full(len(rows), np.nan))
            gains = freeze(np.zeros((len(rows), 2, len(readings.y))))
            return Interval(readings, t, rows, nothing, nothing, gains, program.table.D, disproof=disproof)
    lower, upper = np.array([-down.value for _, down in ends]), np.array([up.value for up, _ in ends])
    if outer is not None:
        lower, upper = np.fmax(lower, outer[:, 0]), np.fmin(upper, outer[:, 1])
    gains = freeze(np.array([(up.gains, down.gains) for up, down in ends]))
    return Interval(readings, t, rows, freeze(lower), freeze(upper), gains, program.table.D, outer)
