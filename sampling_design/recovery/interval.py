"""What the data at hand prove: the values that a wanted row may still have, with the gains that prove it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design._door import door
from sampling_design._linalg import discounted_flow, expm_batch
from sampling_design._record import Plain, Record, short
from sampling_design.errors import ArgumentError
from sampling_design.plants.grouping import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.recovery.between import open_integral
from sampling_design.recovery.bounds import SignalBounds
from sampling_design.recovery.chain import ChainSample, Gap, SampleChain, make_gap, noise_units, state_scales
from sampling_design.recovery.program import ConeWindow
from sampling_design.recovery.riccati import updated
from sampling_design.recovery.rows import Wanted, WantedRows, wanted_rows
from sampling_design.recovery.start import StartSet

Array = npt.NDArray[np.float64]
Arrived = tuple[float, npt.ArrayLike | None, npt.ArrayLike | None]

DIFFUSE = 1e6
"""Covariance of a free start, in scaled coordinates: for the choice of coordinates only."""

COARSE = 2e-2
"""Share of the curvature that cells may lose here: gains are second order in it, and more cells cost time."""

LOOSE = 1e-6
"""Tolerance asked of the solver here: gains are second order in it, too."""

DISPROVED = 1e-9
"""A contradiction must exceed this share of its terms before the bounds count as disproved."""


@dataclass(frozen=True, eq=False)
class Data:
    """Measurements in order of time, with what they would read without error.

    Attributes
    ----------
    times : (K,) array
    start : float
    y : (K, p) array
        Less D u and C times the nominal state; NaN where not measured.
    nominal : (n,) array
        The nominal state at the last sample: the prior's centre, flown with the inputs.
    size : (n,) array or None
        Half-widths of the error at the start (equal ones: a Euclidean bound, if `ball`); None: nothing is known.
    """

    times: Array
    start: float
    y: Array
    nominal: Array
    size: Array | None
    ball: bool


@dataclass(frozen=True, eq=False, repr=False)
class Interval(Record):
    """The values that the data leave possible, for each wanted row.

        lower <= z <= upper,    upper = c'xbar + min over gains of sum lambda'y + b(lambda),   lower = -upper(-c)

    Attributes
    ----------
    t : float
    rows : WantedRows
    lower, upper : (r,) arrays
    contradiction : float
        0 where the data agree with the bounds; else the least factor by which all bounds together would have to grow,
        proven by `evidence`.
    evidence : tuple of arrays
        Gains of the samples (in units of the noise) for which sum lambda'y exceeds what the bounds allow.
    samples : (m,) int array
        The samples that matter most in it, the first ones first.
    """

    plant: Plant
    bounds: SignalBounds
    data: Data
    t: float
    rows: WantedRows
    lower: Array
    upper: Array
    gains: tuple[tuple[tuple[Array, ...], tuple[Array, ...]], ...] = field(repr=False)
    contradiction: float = 0.0
    evidence: tuple[Array, ...] = ()

    @property
    def centre(self) -> Array:
        """The best point: no other estimate has a smaller largest error."""
        return freeze((self.lower + self.upper) / 2)

    @property
    def radii(self) -> Array:
        """Half-widths."""
        return freeze((self.upper - self.lower) / 2)

    @property
    def samples(self) -> npt.NDArray[np.intp]:
        """Samples that make nine tenths of a contradiction, the strongest first."""
        if not self.evidence:
            return np.zeros(0, dtype=np.intp)
        share = np.array([float(np.abs(lam).sum()) for lam in self.evidence])[-len(self.data.times) :]
        order = np.argsort(-share, kind="stable")
        count = int(np.searchsorted(np.cumsum(share[order]), 0.9 * share.sum())) + 1
        return np.asarray(order[:count])

    def holds(self, truth: npt.ArrayLike) -> bool:
        """Whether rows of the state `truth` lie in their intervals."""
        z = self.rows.matrix @ _checks.vector("truth", truth, self.plant.n_states)
        return bool(np.all((self.lower <= z) & (z <= self.upper)))

    def verify(self) -> bool:
        """Whether the gains prove both ends (or the contradiction), evaluated without a solver."""
        engine = Engine(self.plant, self.bounds, self.data)
        if self.contradiction:
            return engine.factor(list(self.evidence)) >= self.contradiction * (1 - DISPROVED)
        for k, (high, low) in enumerate(self.gains):
            up, down = (
                engine.end(self.t, self.rows.matrix[k], list(high)),
                engine.end(self.t, -self.rows.matrix[k], list(low)),
            )
            slack = DISPROVED * max(abs(self.upper[k]), abs(self.lower[k]))
            if up > self.upper[k] + slack or -down < self.lower[k] - slack:
                return False
        return True

    def _rows(self) -> list[tuple[str, str]]:
        lines = [("t", f"{short(self.t)} {self.plant.time_unit}"), ("samples", str(self.data.times.size))]
        if self.contradiction:
            return [
                *lines,
                ("contradiction", f"all bounds would have to be {short(self.contradiction, 3)} times as large"),
            ]
        ends = zip(self.rows.labels(), self.lower, self.upper, strict=True)
        return [*lines, *((label, f"{short(a)} to {short(b)}") for label, a, b in ends)]

    def explain(self) -> str:
        """Say what the data prove."""
        if self.contradiction:
            when = ", ".join(short(self.data.times[k]) for k in self.samples[:4])
            return (
                f"The data contradict the bounds, most of all the samples at {when}: all bounds together would have to "
                f"be {short(self.contradiction, 3)} times as large."
            )
        ends = zip(self.rows.labels(), self.lower, self.upper, strict=True)
        return "The data prove " + ", ".join(f"{n} from {short(a, 4)} to {short(b, 4)}" for n, a, b in ends) + "."

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; what is unbounded becomes None."""
        return {
            "t": self.t,
            "rows": list(self.rows.names),
            "lower": [float(x) if np.isfinite(x) else None for x in self.lower],
            "upper": [float(x) if np.isfinite(x) else None for x in self.upper],
            "contradiction": self.contradiction,
            "gains": [[[lam.tolist() for lam in side] for side in pair] for pair in self.gains],
            "evidence": [lam.tolist() for lam in self.evidence],
        }


class Engine:
    """The program of one record, posed once; every row and both its ends are solves of it.

    `gaps` keeps gaps by length, for records that grow or slide in the same coordinates.
    """

    def __init__(self, plant: Plant, bounds: SignalBounds, data: Data, coordinates: Array | None = None):
        self.plant, self.bounds, self.data = plant, bounds, data
        merged = data.times.size > 0 and data.times[0] == data.start
        marks = data.times if merged else np.concatenate([[data.start], data.times])
        lengths = np.diff(marks)
        balance = balanced_schur(plant.A).d
        A = plant.A * balance / balance[:, None]
        G = plant.G * bounds.w / balance[:, None]
        F, W = discounted_flow(A, G @ G.T, lengths) if lengths.size else (np.zeros((0, *A.shape)),) * 2
        W = W * (float(np.mean(lengths)) if lengths.size else 1.0)
        rows, sizes, exact = noise_units(plant.C * balance, bounds, W)
        D = self._scales(F, W, rows, merged)
        A, G, F, W = A * D / D[:, None], G / D[:, None], F * D / D[:, None], W / np.outer(D, D)
        rows = [H * D for H in rows]
        self.D = balance * D
        L = self._root(F, W, rows, merged)
        count = len(lengths) + 1
        gaps = self._gaps(A, G, lengths, L, F)
        no_gain: Array = np.zeros((len(A), 0))
        blank = ChainSample(
            np.zeros(0, dtype=np.intp),
            np.zeros(0),
            np.zeros((0, A.shape[0])),
            np.zeros(0, bool),
            no_gain,
        )
        measured = self._samples(rows, sizes, exact, L, gaps, merged)
        samples = tuple(measured if merged else [blank, *measured])
        self.chain = SampleChain(plant, bounds, self.D, np.broadcast_to(L, (count, *L.shape)), A, G, samples, gaps)
        start = StartSet(None, False)
        if data.size is not None:
            start = StartSet(
                self.D[:, None] * L / np.where(data.size > 0, data.size, NO_ERROR * self.D)[:, None], data.ball
            )
        shown = [data.y[k, s.outputs] / s.size for k, s in enumerate(measured)]
        self.window = ConeWindow(
            self.chain, list(range(count)), start, shown if merged else [np.zeros(0), *shown], LOOSE
        )

    def _scales(self, F: Array, W: Array, rows: list[Array], merged: bool) -> Array:
        if not len(F):
            return np.ones(self.plant.n_states)
        ahead = rows if merged else [np.zeros((0, self.plant.n_states)), *rows]
        return state_scales(F, W, ahead[:-1])

    def _root(self, F: Array, W: Array, rows: list[Array], merged: bool) -> Array:
        """One root of the filter's covariance at the last sample: the coordinates of the whole record."""
        P = np.eye(len(self.D)) * DIFFUSE
        if self.data.size is not None:
            P = np.diag((np.where(self.data.size > 0, self.data.size, 1e-3 * self.D) / self.D) ** 2)
        steps = list(zip(F, W, strict=True))
        if merged:
            P = updated(P, rows[0].T @ rows[0])
        for (f, w), H in zip(steps, rows[1:] if merged else rows, strict=True):
            P = f @ P @ f.T + w
            P = updated(P, H.T @ H)
        return np.asarray(np.linalg.cholesky(P + 1e-13 * np.diag(np.diag(P))))

    def _gaps(self, A: Array, G: Array, lengths: Array, L: Array, F: Array) -> tuple[Gap, ...]:
        known: dict[float, Gap] = {}
        for h, f in zip(lengths, F, strict=True):
            if float(h) not in known:
                known[float(h)] = make_gap(A, G, float(h), L, L, f, COARSE)
        return tuple(known[float(h)] for h in lengths)

    def _samples(
        self,
        rows: list[Array],
        sizes: list[Array],
        exact: list[npt.NDArray[np.bool_]],
        L: Array,
        gaps: tuple[Gap, ...],
        merged: bool,
    ) -> list[ChainSample]:
        """Samples with the gains of the filter, in the coordinates of the record."""
        found, n = [], len(L)
        P = np.eye(n) * DIFFUSE
        for j, H in enumerate(rows):
            if j or not merged:
                gap = gaps[j - merged]
                P = gap.F @ P @ gap.F.T + np.einsum("mnq,mkq->nk", gap.cells, gap.cells)
            Hz = H @ L
            gain = np.asarray(np.linalg.solve(Hz @ P @ Hz.T + np.eye(len(Hz)), Hz @ P).T, dtype=np.float64)
            P = updated((P + P.T) / 2, Hz.T @ Hz)
            found.append(ChainSample(self.bounds.measured(j), sizes[j], Hz, exact[j], gain))
        return found

    def ahead(self, t: float, row: Array) -> tuple[Array, float, float]:
        """Phi(d)'c in the coordinates of the last sample, a bound on what w adds until t, and c'Phi(d)xbar."""
        last = self.data.times[-1] if self.data.times.size else self.data.start
        flown = row @ self.plant.transition(t - last) if t > last else row
        added = open_integral(self.chain, t - last, row) if t > last else 0.0
        mu = self.chain.mu(len(self.chain) - 1, flown[None])[:, 0]
        return mu, added, float(flown @ self.data.nominal)

    def end(self, t: float, row: Array, gains: list[Array]) -> float:
        """The upper end that given gains prove, no solver."""
        mu, added, nominal = self.ahead(t, row)
        return nominal + added + self.window.upper(mu, gains).value

    def solve(self, t: float, row: Array) -> tuple[float, tuple[Array, ...]]:
        """The upper end of a row at t, and the gains that prove it."""
        mu, added, nominal = self.ahead(t, row)
        found = self.window.gains(mu)
        return nominal + added + found.value, found.gains

    def factor(self, gains: list[Array]) -> float:
        """The factor by which bounds must grow for the data, as given gains for the row 0 prove it."""
        zero = np.zeros(len(self.D))
        shown = sum(float(lam @ y) for lam, y in zip(gains, self.window.data or [], strict=True))
        allowed = self.window.upper(zero, gains).value - shown
        return -shown / allowed if allowed > 0 else (np.inf if shown < 0 else 0.0)


NO_ERROR = 1e-9
"""Half-width of an entry that is known exactly at the start, in scaled coordinates."""


@door
def interval(
    plant: Plant,
    record: Iterable[Arrived],
    t: float | None = None,
    *,
    w_bound: npt.ArrayLike | None = None,
    v_bound: npt.ArrayLike | None = None,
    initial_error: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    prior_time: float | None = None,
    of: Wanted = None,
) -> Interval:
    """Return the values of wanted rows that the data leave possible, with gains that prove them.

    Parameters
    ----------
    plant : Plant
    record : Measurements or iterable of (t, y, u)
        In order of time; y is NaN where not measured, u holds from t on.
    t : float, optional
        At or after the last sample; default the last sample.
    w_bound, v_bound : float or array
        As for `accuracy`; `v_bound` may have a row for each sample.
    initial_error : float or (n,) array, optional
        Bound on |x - prior| at `prior_time`, Euclidean or entry by entry. Default: nothing is known.
    prior : (n,) array, optional
        Default 0.
    prior_time : float, optional
        Not after the first sample; default the first sample.
    of : str, sequence of str, or (r, n) array, optional
        As for `accuracy`.

    Returns
    -------
    Interval

    Raises
    ------
    ArgumentError
        If a bound is missing or of another shape, the record is empty or not in order, or `t` lies before its end.

    Notes
    -----
    *Assumptions.* w, v and the initial error keep their bounds. *Claim.* Each row lies in its interval, and every value
    in it is possible up to the width of the cells on which w is constant. If the data contradict the bounds, the gains
    prove it. *Method.* The adversary's program with the data in place of zeros; its multipliers are gains, evaluated
    without the solver.

    References
    ----------
    Milanese and Tempo, Optimal algorithms theory for robust estimation and prediction (1985).

    Examples
    --------
    >>> from sampling_design import Plant
    >>> found = interval(Plant([[0.0]], [[1.0]]), [(0.0, [1.0], None), (1.0, [1.5], None)], w_bound=0.1, v_bound=0.3)
    >>> found.lower.round(6), found.upper.round(6)
    (array([1.2]), array([1.4]))
    """
    data = read_record(plant, record, prior, prior_time, initial_error)
    if not data.times.size:
        raise ArgumentError("`record` must hold at least one measurement, got none.")
    at = float(data.times[-1]) if t is None else _checks.number("t", t)
    if at < data.times[-1]:
        raise ArgumentError(f"`t` must not lie before the last sample {float(data.times[-1])!r}, got {at!r}.")
    bounds = SignalBounds.of(plant, data.times.size, np.isfinite(data.y), w_bound, v_bound)
    return prove(Engine(plant, bounds, data), at, wanted_rows(plant, of))


def prove(engine: Engine, t: float, rows: WantedRows) -> Interval:
    """Return the interval of each row at t, or the proof that the data contradict the bounds."""
    lower, upper, gains = [], [], []
    for row in rows.matrix:
        (high, up), (low, down) = engine.solve(t, row), engine.solve(t, -row)
        if engine.window.infeasible or high < -low - DISPROVED * max(abs(high), abs(low)):
            evidence = engine.window.least_scale()
            factor = engine.factor(evidence)
            if factor > 1 + DISPROVED:
                nothing = freeze(np.full(len(rows), np.nan))
                return Interval(
                    engine.plant, engine.bounds, engine.data, t, rows, nothing, nothing, (), factor, tuple(evidence)
                )
        lower.append(-low)
        upper.append(high)
        gains.append((up, down))
    return Interval(engine.plant, engine.bounds, engine.data, t, rows, freeze(lower), freeze(upper), tuple(gains))


def _arrived(item: object, p: int) -> tuple[float, Array | None, npt.ArrayLike | None]:
    """One row of a record, checked."""
    if not isinstance(item, (tuple, list)) or len(item) not in (2, 3):
        raise ArgumentError(f"`record` must hold rows (t, y, u), got {item!r:.60}.")
    t = _checks.number("t", item[0])
    if item[1] is None:
        return t, None, item[2] if len(item) == 3 else None
    try:
        y = np.asarray(item[1], dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        y = np.full(p + 1, np.nan)
    if y.size != p or np.isinf(y).any():
        raise ArgumentError(f"`record` must hold {p} outputs a sample, finite or NaN, got {item[1]!r:.60} at {t!r}.")
    return t, y, item[2] if len(item) == 3 else None


def read_record(
    plant: Plant,
    record: Iterable[Arrived],
    prior: npt.ArrayLike | None,
    prior_time: float | None,
    initial_error: npt.ArrayLike | None,
) -> Data:
    """Return the measurements less what the prior, flown with the inputs, would show."""
    n, p, m = plant.n_states, plant.n_outputs, plant.n_inputs
    x = np.array(_checks.vector("prior", np.zeros(n) if prior is None else prior, n))
    items = [_arrived(item, p) for item in record]
    start = items[0][0] if prior_time is None and items else _checks.number("prior_time", prior_time or 0.0)
    joint = np.zeros((n + m, n + m))
    joint[:n] = np.hstack([plant.A, plant.B])
    now, u = start, np.zeros(m)
    times: list[float] = []
    shown: list[Array] = []
    for item in items:
        t = item[0]
        if t < now:
            raise ArgumentError(
                f"`record` must be in order of time and not begin before `prior_time`, got {t!r} after {now!r}."
            )
        x, now = expm_batch(joint, [t - now])[0][:n] @ np.concatenate([x, u]), t
        if item[2] is not None and m:
            u = np.array(_checks.vector("u", item[2], m))
        if item[1] is None:
            continue
        y = item[1]
        if times and t == times[-1]:
            raise ArgumentError(f"`record` measures twice at {t!r}. Put both into one row.")
        if np.isfinite(y).any():
            times.append(t)
            shown.append(y - plant.C @ x - plant.D @ u)
            nominal = x
    size, ball = None, False
    if initial_error is not None:
        ball = np.ndim(initial_error) == 0 and n > 1
        bound = np.full(n, _checks.nonnegative("initial_error", initial_error)) if np.ndim(initial_error) == 0 else None
        size = _checks.vector("initial_error", initial_error, n) if bound is None else bound
        if np.any(size < 0):
            raise ArgumentError(f"`initial_error` must not be negative, got {float(size.min())!r}.")
    empty = np.zeros((0, p))
    return Data(freeze(times), start, np.array(shown) if shown else empty, nominal if times else x, size, ball)
