"""The standard deviation of wanted rows for white noise: the Kalman-Bucy filter with samples, over a whole schedule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.accuracy.bounds import SEMIDEFINITE
from sampling_design.accuracy.finite import DIFFUSE
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.riccati import RootedPeriod, in_turn, strong
from sampling_design.checkers.strict import is_table
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.filtering import CovarianceMap, carried, correlation_root, covariance_root, noise_roots
from sampling_design.numerics.linalg import discounted_flow, expm_batch, symmetrise
from sampling_design.observability.alignment import align
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import PlainRecord, TableRecord, moment, short
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound, vector_bound
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

POINTS = 64  # offsets in each gap at which the profile stands

WALK = 1e-12
"""Share of a free start's covariance that joins the noise of a period where the filter from P = 0 is unstable."""

ROUNDED = 1e-7
"""Share of noise that may be rounding, root of that of its covariance; and the angle at which an exact sensor's row
shows nothing that is not known."""

WIDER, WIDEST = (1e2, 1e4, 1e6, 1e8, 1e10), (1e8, 1e10)
"""A start of which nothing is known is taken so many times as wide, until what the samples determine stays as it is;
between the two widest, what they do not determine must grow as the start does."""

SETTLED = 1e-6  # share by which what the samples determine may still change
REFINED = 60  # evaluations that place the worst time within its panels


@dataclass(frozen=True, eq=False, repr=False)
class StandardDeviation(TableRecord, PlainRecord):
    """The least standard deviation of wanted rows for white noise, over a whole schedule.

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
    rows : RequestedRows
    worst : (r,) array
        Over all times at which the row is known.
    worst_at : (r,) array
        Times at which it is reached [the plant's time unit].
    mean : (r,) array
        Root of the variance's mean over those times.
    times : (N,) array
        Those of the profile; sample times are there twice, before and after the sample.
    profile : (r, N) array
    """

    plant: Plant
    schedule: Schedule | PeriodicSchedule
    rows: RequestedRows
    worst: Array
    worst_at: Array
    mean: Array
    times: Array
    profile: Array

    _frame = "row:rows.names unit:rows.units worst worst_at mean"
    _plain = "rows:rows.names worst worst_at mean times profile"
    _answers = (
        "the least standard deviation for white noise along a schedule, of all filters",
        "attained: by the Kalman filter, in doubles",
        "at worst {worst}",
        "`.covariance` of the estimates of `KalmanFilter` with the same noise",
    )

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        return [
            (
                f"deviation of {label}",
                f"{short(self.worst[k])} at {moment(self.worst_at[k])} {unit}, {short(self.mean[k])} on average"
                if np.isfinite(self.worst[k])
                else "infinite",
            )
            for k, label in enumerate(self.rows.labels())
        ]

    def explain(self) -> str:
        """Say what a filter attains."""
        parts = [f"{n} {short(x, 4)}" for n, x in zip(self.rows.labels(), self.worst, strict=True)]
        return (
            f"For white noise of the given sizes the best filter's standard deviation is at worst: {', '.join(parts)}."
        )


@checked
def standard_deviation(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    *,
    w_intensity: VectorBound = None,
    v_deviation: VectorBound = None,
    of: Wanted = None,
    start: float | None = None,
    end: float | None = None,
) -> StandardDeviation:
    """Return the standard deviation of wanted rows that a Kalman-Bucy filter with samples attains for white noise.

        P' = AP + PA' + G W G',    P <- P - P C'(C P C' + V_j)^-1 C P at each sample;    sqrt(c'P(t)c)

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
        Periodic: in the periodic limit. Finite: from a start of which nothing is known.
    w_intensity : float, (q,) or (q, q) array, or mapping
        Intensity W of the white noise w [unit of w squared times the plant's time unit]: a number for every entry, one
        for each entry or by name, or a positive semidefinite matrix.
    v_deviation : float, (p,) or (N, p) array, or mapping
        Standard deviation of the noise of a sample [units of the outputs].
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states.
    start, end : float, optional
        Of a finite schedule; default its first and its last sample.

    Returns
    -------
    StandardDeviation

    Raises
    ------
    ArgumentError
        If a size is missing, negative or of another shape, or a periodic schedule is given a start or an end.
    UndecidedError
        If the samples show some state so weakly, or modes grow so far between them, that doubles hold no answer.

    Notes
    -----
    *Assumptions.* w is white, v independent from sample to sample; for Gaussian noise no estimator does better.
    *Method.* Structure-preserving doubling to the periodic limit (the strong solution), exact flows of the covariance
    between samples; the worst time is refined between the points of the profile. Amplitude bounds reward more samples
    much less: compare `guaranteed_accuracy`.

    References
    ----------
    Bittanti, Colaneri and De Nicolao, The periodic Riccati equation (1991).

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant
    >>> found = standard_deviation(Plant([[0.0]], [[1.0]]), PeriodicSchedule([1.0]), w_intensity=1.0, v_deviation=1.0)
    >>> bool(abs(found.worst[0] ** 2 - (1 + 5**0.5) / 2) < 1e-9)  # the golden ratio
    True
    """
    schedule = align(plant, schedule)
    rows = requested_rows(plant, of)
    question = AccuracyQuestion.of(plant, schedule, 0.0, np.zeros(plant.n_outputs), None, start, end)
    return deviations(question, rows, w_intensity, v_deviation)


def deviations(
    question: AccuracyQuestion, rows: RequestedRows, w_intensity: VectorBound, v_deviation: VectorBound
) -> StandardDeviation:
    """Return the standard deviations for the schedule of a question."""
    plant, schedule = question.plant, question.schedule
    W, v = _intensity(plant, w_intensity), _deviation(plant, len(schedule), v_deviation)
    ends = (None, None) if schedule.endless else (float(question.nodes[0]), question.end)
    question = AccuracyQuestion.of(plant, schedule, np.sqrt(np.diag(W)), v, None, *ends)
    known = question.lasting(correlation_root(W))  # of what no noise reaches, an endless past has left what grows
    safe = [k for k, row in enumerate(rows.matrix) if known.plant.n_states and not known.touches(row)]
    curves = _DeviationCurves(question, known.plant, W, known.moving) if safe else None
    lengths = question.gaps
    offsets = [np.linspace(0.0, h, POINTS + 1) for h in lengths]
    times = np.concatenate([t + d for t, d in zip(question.nodes, offsets, strict=True)])
    worst, worst_at = np.array([known.at_rest(row) for row in rows.matrix]), np.full(len(rows), times[0])
    profile, mean = np.tile(worst[:, None], (1, times.size)), worst.copy()
    for k in safe:
        assert curves is not None  # there is such a row
        row = rows.matrix[k] @ known.lift
        parts = [curves.variance(j, d, row) for j, d in enumerate(offsets)]
        profile[k] = np.sqrt(np.concatenate(parts))
        if np.isfinite(profile[k]).any():
            worst[k], worst_at[k] = curves.worst(parts, offsets, row)
            mean[k] = _mean(parts, offsets)
    return StandardDeviation(
        plant, schedule, rows, freeze(worst), freeze(worst_at), freeze(mean), freeze(times), freeze(profile)
    )


class _DeviationCurves:
    """Roots of the covariances after each node, in scaled coordinates, and variances of rows between nodes."""

    def __init__(self, question: AccuracyQuestion, plant: Plant, W: Array, moving: Array | None):
        self.question = question
        system, directions = question.filter_bounds(plant, moving)
        self.D, self.A, self._L, self._directions, self._r = system.D, system.A, system.L, directions, system.determined
        G = plant.G / self.D[:, None]
        self._driven, self._noise = G @ correlation_root(W), symmetrise(G @ W @ G.T)
        self._exact = [s.noise == 0 for s in system.samples]  # their size is for coordinates alone
        sizes = [s.size * np.where(own, 1.0, s.noise) for s, own in zip(system.samples, self._exact, strict=True)]
        rows = [plant.C[s.outputs] * self.D / size[:, None] for s, size in zip(system.samples, sizes, strict=True)]
        self._roots = self._endless(rows) if question.initial is None else self._finite(rows)

    def _endless(self, rows: list[Array]) -> list[Array]:
        lengths = self.question.gaps
        n, r, count = len(self.A), self._r, len(lengths)
        bases = [np.eye(n)] * count if r == n else list(self._L)  # the last n - r entries nobody knows, or needs
        flows, roots = expm_batch(self.A, lengths), noise_roots(self.A, self._driven, lengths)
        F, noise = list[Array](), list[Array]()
        for L, ahead, flow, root in zip(bases, [*bases[1:], bases[0]], flows, roots, strict=True):
            F.append(np.linalg.solve(ahead, flow @ L)[:r, :r])
            noise.append(np.linalg.solve(ahead, root)[:r])
        outputs = [H @ L[:, :r] for H, L in zip(rows, bases, strict=True)]
        maps = [CovarianceMap(f, H.T @ H, N @ N.T) for f, H, N in zip(F, outputs, noise, strict=True)]
        rooted = RootedPeriod(F, outputs, noise)
        try:
            limit = covariance_root(strong(in_turn(maps), np.eye(r) * DIFFUSE, WALK))
            followed = rooted.gives_back(limit)
        except np.linalg.LinAlgError:  # as where accuracies are doubled
            followed = False
        after = rooted.settled(limit if followed else np.eye(r) * np.sqrt(DIFFUSE))
        if any(own.any() for own in self._exact):
            root = carried(after[-1], rooted.F[-1], rooted.noise[-1])
            after = rooted.exactly(root, self._exact, ROUNDED, r + 1)  # each but the last shows a direction more
        return [L[:, :r] @ root for L, root in zip(bases, after, strict=True)]

    def _finite(self, rows: list[Array]) -> list[Array]:
        n = len(self.A)
        gaps = np.diff(self.question.nodes)
        F, noise = expm_batch(self.A, gaps), noise_roots(self.A, self._driven, gaps)
        path = RootedPeriod([*F, np.eye(n)], rows, [*noise, np.zeros((n, 0))])

        def begun(size: float) -> list[Array]:
            root = np.eye(n) * np.sqrt(DIFFUSE) * size
            return path.exactly(root, self._exact, ROUNDED) if exact else path(root)[0]

        exact = any(own.any() for own in self._exact)
        widest = [begun(size) for size in WIDEST] if not all(a.whole for a in self._directions) else []
        free = [self._sizes(roots, False) for roots in widest]
        roots = begun(1.0)
        for size in WIDER:
            before, roots = self._sizes(roots), begun(size)
            settled = np.allclose(self._sizes(roots), before, rtol=SETTLED, atol=SETTLED)  # of what a filter leaves
            if settled and (not free or np.all(free[1] > free[0] * WIDEST[1] / WIDEST[0] / 2)):
                return roots
        raise UndecidedError(
            "undecided: the samples show some state so weakly that doubles cannot tell it from what was "
            "assumed at the start. Give a shorter schedule."
        )

    def _sizes(self, roots: list[Array], observable: bool = True) -> Array:
        """Standard deviations at the nodes of what the samples determine, or of what they do not."""
        found = []
        for directions, L, root in zip(self._directions, self._L, roots, strict=True):
            r, whole = directions.basis.shape[1], np.linalg.svd(directions.basis)[0]
            chosen = whole[:, :r] if observable else whole[:, r:]
            found.append(np.linalg.norm(chosen.T @ np.linalg.solve(L, root), axis=1))
        return np.concatenate(found)

    def variance(self, j: int, offsets: Array, row: Array) -> Array:
        """c'P(t_j + d)c for offsets d; infinite where the samples do not determine the row."""
        F, W = discounted_flow(self.A, self._noise, offsets)
        propagated = (row * self.D) @ F
        found = np.sum((propagated @ self._roots[j]) ** 2, axis=1) + np.maximum(
            np.einsum("i,kij,j->k", row * self.D, W, row * self.D), 0
        )
        if self.question.initial is None:  # of rows that what nobody knows does not touch
            return np.asarray(found)
        return np.where(self._directions[j].determines(propagated @ self._L[j]), found, np.inf)

    def worst(self, parts: list[Array], offsets: list[Array], row: Array) -> tuple[float, float]:
        """The largest standard deviation and its time, refined between the points of the profile."""
        from scipy.optimize import minimize_scalar

        finite = [np.where(np.isfinite(part), part, -1.0) for part in parts]
        j = int(np.argmax([part.max() for part in finite]))
        k, d = int(np.argmax(finite[j])), offsets[j]
        best, at = float(finite[j][k]), float(d[k])
        low, high = float(d[max(k - 1, 0)]), float(d[min(k + 1, d.size - 1)])
        if 0 < k < d.size - 1 and high > low:
            found = minimize_scalar(
                lambda x: -float(self.variance(j, np.array([x]), row)[0]),
                bounds=(low, high),
                method="bounded",
                options={"maxiter": REFINED, "xatol": 1e-9 * (high - low)},
            )
            if -found.fun > best:
                best, at = -float(found.fun), float(found.x)
        return float(np.sqrt(best)), float(self.question.nodes[j] + at)


def _mean(parts: list[Array], offsets: list[Array]) -> float:
    """Root of the mean variance over the times at which it is finite, by Simpson's rule on pairs of panels."""
    total, length = 0.0, 0.0
    for part, d in zip(parts, offsets, strict=True):
        for k in range(0, d.size - 2, 2):
            piece = part[k : k + 3]
            if np.isfinite(piece).all():
                total += float(d[k + 2] - d[k]) / 6 * float(piece[0] + 4 * piece[1] + piece[2])
                length += float(d[k + 2] - d[k])
    return float(np.sqrt(total / length)) if length else np.inf


def _intensity(plant: Plant, value: VectorBound) -> Array:
    q = plant.n_disturbances
    if value is None:
        raise ArgumentError(
            "`w_intensity` is missing: give the intensity of the white noise w [its unit squared times "
            f"{plant.time_unit}], 0 where there is none."
        )
    if is_table(value) or checks.dimensions(value) < 2:
        return np.eye(q) * vector_bound("w_intensity", value, plant.disturbances.names)
    matrix = checks.symmetric("w_intensity", value, q)
    sizes = np.sqrt(np.abs(np.diag(matrix)))
    unit = matrix / np.outer(np.where(sizes > 0, sizes, 1.0), np.where(sizes > 0, sizes, 1.0))
    if np.linalg.eigvalsh(unit)[0] < -SEMIDEFINITE * q:
        raise ArgumentError("`w_intensity` must be positive semidefinite, got a matrix with a negative eigenvalue.")
    return np.array(matrix)


def _deviation(plant: Plant, samples: int, value: VectorBound) -> Array:
    p = plant.n_outputs
    if value is None:
        raise ArgumentError(
            f"`v_deviation` is missing: give the standard deviation of the noise of {', '.join(plant.outputs.names)}."
        )
    if is_table(value) or checks.dimensions(value) < 2:
        return np.full((samples, p), vector_bound("v_deviation", value, plant.outputs.names))
    array = np.array(checks.matrix("v_deviation", value, samples, p))
    if np.any(array < 0):
        raise ArgumentError(f"`v_deviation` must not be negative, got {float(array.min())!r}.")
    return array
