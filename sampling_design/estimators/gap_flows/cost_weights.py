"""What an estimator minimises, as a user gives it and as matrices, and what bounds on the noise are worth in it.

Two costs are known. "certificate" carries the weights as they are,
    e^{-eta M}|x(s) - prior|^2_{P2} + int e^{-eta(t-tau)}|w|^2_{Qw} + sum e^{-eta(t-tau)}|y - Cx - Du|^2_{R~},
"paper" is (15): twice P2, Qw and Qv, once R. With v eliminated both have this one form, with weights
`prior`, `w` and `y` below; everything after this file knows only these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.bound_weights import LARGEST, ErrorBoundArguments, weights_from_bounds
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import chain_speed, symmetrise
from sampling_design.plants.clusters import fastest_rate
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import Record, short
from sampling_design.records.vector_bounds import VectorBound, refuse_apart, vector_bound

Form = Literal["certificate", "paper"]
ArrivalKind = Literal["fixed", "filtered"]
Beginning = Literal["horizon", "sample"]
MATRICES = ("P2", "Qw", "R", "Qv")


@frozen
class CostFunction(Record):
    """The cost that an estimator minimises over a window that began at s, at time t.

        "certificate":  e^{-eta(t-s)}|x(s) - xhat(s)|^2_P2 + int e^{-eta(t-tau)}|w|^2_Qw
                            + sum e^{-eta(t-tau)}|y - Cx - Du|^2_R~,          R~ = (R^-1 + Qv^-1)^-1
        "paper":        2 e^{-eta(t-s)}|x(s) - xhat(s)|^2_P2 + int 2 e^{-eta(t-tau)}|w|^2_Qw
                            + sum e^{-eta(t-tau)}(2|v|^2_Qv + |y - Cx - Du - v|^2_R)

    What is left out comes from the certificate. Without certificate and weights each bound of the estimator is one
    (`weights_from_bounds` at the rate eta, one over the horizon, or the plant's fastest; of integrators alone one over
    the time in which w moves an output by v); else they are those of the plant's scales: P2 = diag(1/s_x^2),
    Qw = diag(1/s_w^2), R = Qv = 2 diag(1/s_y^2), eta = 0.

    Parameters
    ----------
    P2 : (n, n) array, optional
        Weight of the error at the window's start.
    Qw : (q, q) array, optional
        Weight of the disturbance, per unit of time.
    R, Qv : (p, p) arrays, optional
        Weights of the fit and of the noise.
    eta : float, optional
        Discount rate [1/time] of the squared errors.
    form : "certificate" or "paper", optional
        Default "certificate"; for nonlinear plants it is "paper", whose window is closed.
    arrival : "fixed" or "filtered"
        What the error at the window's start weighs: always P2, or its own information Pi(s), which gives the full rate
        for every horizon.
    begins : "horizon" or "sample"
        s = t - M, as in the paper; or the last sample until then, which is at most one gap earlier, keeps every claim
        (a longer window has the rate of M and more), and spares flows to a time between samples where gaps are uneven.

    Raises
    ------
    ArgumentError
        If a weight is no square matrix, the rate is negative or a word is unknown. The sizes meet the plant's in the
        estimator.

    Examples
    --------
    >>> from sampling_design import KalmanFilter, Plant
    >>> cost = CostFunction(P2=[[1.0]], Qw=[[1e9]], R=[[2.0]], Qv=[[2.0]])
    >>> KalmanFilter(Plant([[0.0]], [[1.0]]), cost=cost).update(1.0, [3.0]).x.round(6)
    array([1.5])
    """

    P2: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    Qw: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    R: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    Qv: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    eta: float | None = None
    form: Form | None = None
    arrival: ArrivalKind = "fixed"
    begins: Beginning = "horizon"

    _slip: ClassVar[str] = "Use CostFunction(P2=, Qw=, R=, Qv=, eta=, form=, arrival=, begins=)."

    def __post_init__(self) -> None:
        for key in MATRICES:
            value = getattr(self, key)
            if value is not None:
                array = checks.matrix(key, value)
                self._hold(**{key: checks.matrix(key, value, len(array), len(array))})
        self._check(eta=checks.nonnegative)
        words_of = ("form", self.form, Form), ("arrival", self.arrival, ArrivalKind), ("begins", self.begins, Beginning)
        for key, value, known in words_of:
            named = is_text(value) and value in get_args(known)
            if not (named or (key == "form" and value is None)):
                words = " or ".join(f'"{word}"' for word in get_args(known))
                raise ArgumentError(f"`{key}` must be {words}, got {checks.described(value)}.")

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the weights and the rate that are given here."""
        return tuple(key for key in (*MATRICES, "eta") if getattr(self, key) is not None)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(key, short(getattr(self, key), 4)) for key in self.given]
        rows += [] if self.form is None else [("form", self.form)]
        return [*rows, ("arrival", self.arrival), ("begins", self.begins)]

    def explain(self) -> str:
        """Say what is given and what is taken from elsewhere."""
        given = f"{', '.join(self.given)} given" if self.given else "No weight given"
        weighs = "P2" if self.arrival == "fixed" else "what is known of it"
        weighs += "" if self.begins == "horizon" else "; windows begin at a sample"
        return f"{given}, the rest from the certificate or the scales; the window's first error weighs {weighs}."


INVERTED = 1e-15
"""Relative error of a weight in units of its diagonal: its inverse is off by as much times its condition."""


class SampleWeights(NamedTuple):
    """Weights of one sample, or of (N, ...) samples: those of its measured outputs, zero rows and columns elsewhere.

    y : R and v together, with `y_root`' `y_root` = y; R, v : of the fit and of the noise; gain : the best v is gain
    times the residual; v_root : v_root v_root' = (R + v)^-1, what the noise may do beside that.
    """

    y_root: Array
    y: Array
    R: Array
    v: Array
    gain: Array
    v_root: Array


@dataclass(frozen=True, eq=False)
class CostWeights:
    """Effective weights of one cost, all positive definite.

    Attributes
    ----------
    prior : (n, n), w : (q, q), y : (p, p)
        Of the error at the window's start, the disturbance, and the residual with v eliminated.
    R, v : (p, p)
        Of the fit and of v where v is kept: y = (R^-1 + v^-1)^-1.
    eta : float
        Discount rate [1/time].
    """

    plant: Plant
    prior: Array
    w: Array
    R: Array
    v: Array
    y: Array
    eta: float
    cost: str

    @cached_property
    def noise(self) -> Array:
        """G Qw^-1 G', the intensity with which information is lost between samples."""
        return symmetrise(self.plant.G @ np.linalg.solve(self.w, self.plant.G.T))

    @cached_property
    def loose(self) -> float:
        """How far what is found from the weights' inverses may be off, relative, as a quadratic form."""
        found = [0.0]
        for weight in (self.prior, self.w, self.R, self.v, self.y):
            if len(weight):
                size = np.sqrt(np.diag(weight))
                values = np.linalg.eigvalsh(weight / size[:, None] / size)
                least = max(float(values[0]), float(np.finfo(float).eps))
                found.append(INVERTED * float(values[-1]) / least)
        return max(found)

    @cached_property
    def entries(self) -> tuple[Array, Array]:
        """Units in which the squares of the entries of y and x sum to no less than their weighted squares."""
        y, prior = self.y.diagonal(), self.prior.diagonal()
        return np.sqrt(len(y) * y), np.sqrt(len(prior) * prior)

    @cached_property
    def units(self) -> Array:
        """Units of the states: what each is uncertain by at the prior."""
        return np.asarray(1 / np.sqrt(np.diag(self.prior)))

    @cached_property
    def prior_factor(self) -> Array:
        """Lower triangular L with L L' = `prior`."""
        return np.asarray(np.linalg.cholesky(self.prior))

    @cached_property
    def prior_root(self) -> Array:
        """S with S S' = `prior`^-1."""
        return np.asarray(np.linalg.solve(self.prior_factor, np.eye(self.plant.n_states)).T)

    @cached_property
    def y_root(self) -> Array:
        """U with U'U = `y`."""
        return np.asarray(np.linalg.cholesky(self.y).T)

    @cached_property
    def _kinds(self) -> dict[bytes, tuple[SampleWeights, tuple[float, float]]]:
        """What is known of each set of measured outputs."""
        return {}

    def at(self, mask: Array) -> SampleWeights:
        """Return the weights of a sample that measures the outputs where the (p,) `mask` is not 0.

        What is not measured is free: the cost is least over it, so that covariances (not weights) lose its rows.
        """
        return self._kind(mask)[0]

    def of(self, masks: Array) -> SampleWeights:
        """Return the weights of N samples, stacked, for (N, p) `masks`."""
        p = self.y.shape[0]
        if not len(masks):
            return SampleWeights(*np.zeros((6, 0, p, p)))
        begins, lengths = stretches(masks)
        kinds = zip(*map(self.at, masks[begins]), strict=True)
        return SampleWeights(*(np.repeat(np.array(part), lengths, axis=0) for part in kinds))

    def _kind(self, mask: Array) -> tuple[SampleWeights, tuple[float, float]]:
        key = (mask > 0).tobytes()
        found = self._kinds.get(key)
        if found is None:
            found = self._kinds[key] = self._made(mask > 0)
        return found

    def _made(self, measured: Mask) -> tuple[SampleWeights, tuple[float, float]]:
        root, R, v = marginal_root(self.y, measured), marginal(self.R, measured), marginal(self.v, measured)
        both = np.linalg.cholesky(R + v + np.diag(np.where(measured, 0.0, 1.0)))
        half = np.linalg.solve(both, np.diag(measured.astype(np.float64)))
        found = SampleWeights(root, root.T @ root, R, v, half.T @ (half @ R), half.T)
        one = np.ones(())
        return found, (largest_energy(v, one), largest_energy(found.y, one))

    def prior_energy(self, bound: Array | None) -> float:
        """Return the largest |e|^2_prior over the bound on e (infinity for None)."""
        return largest_energy(self.prior, bound)

    def disturbance_energy(self, bound: Array | None) -> float:
        """Return the largest |w|^2_w over the bound on w (infinity for None)."""
        return largest_energy(self.w, bound)

    @cached_property
    def diagonal_noise(self) -> bool:
        """Whether R and Qv are diagonal."""
        return all(not np.any(M - np.diag(np.diag(M))) for M in (self.R, self.v))

    def fit_energy(self, bound: Array | None, masks: Array) -> Array:
        """Return, per row of the (N, p) `masks`, a bound on |v|^2_R over its measured outputs."""
        if bound is None:
            return np.where(masks.any(axis=1), np.inf, 0.0)
        return np.array([largest_energy(self.at(mask).R, bound) for mask in masks])

    def sample_energy(self, bound: Array | None, kept: bool, masks: Array) -> Array:
        """Return, per row of the (N, p) `masks`, a bound on the weighted square of v over its measured outputs.

        `kept` says that v is a variable of the problem, so that its own weight counts instead of R~.
        """
        if bound is None:
            return np.where(masks.any(axis=1), np.inf, 0.0)
        begins, lengths = stretches(masks)
        kinds = [self._kind(mask) for mask in masks[begins]]
        if bound.ndim == 0:
            found = [peaks[0 if kept else 1] * float(bound) ** 2 for _, peaks in kinds]
        else:
            found = [float(bound @ np.abs(kind.v if kept else kind.y) @ bound) for kind, _ in kinds]
        return np.repeat(np.array(found), lengths)


def marginal_root(weight: Array, measured: Mask) -> Array:
    """Return U with |U r|^2 = min |z|^2_weight over all z that agree with r where `measured`; zero columns elsewhere.

    The last block of the Cholesky factor of the weight with what is not measured put first.
    """
    hidden, visible = np.flatnonzero(~measured), np.flatnonzero(measured)
    order = np.concatenate([hidden, visible])
    factor = np.linalg.cholesky(weight[np.ix_(order, order)])
    root = np.zeros_like(weight)
    root[np.ix_(visible, visible)] = factor[hidden.size :, hidden.size :].T
    return root


def marginal(weight: Array, measured: Mask) -> Array:
    """Return the weight of the entries that are `measured`, the others being free: zero rows and columns for those."""
    if measured.all():
        return weight
    root = marginal_root(weight, measured)
    return symmetrise(root.T @ root)


def largest_energy(weight: Array, bound: Array | None) -> float:
    """Return the largest z'Wz over |z| <= bound (a number), or over |z_i| <= bound_i: no less, unless W is diagonal."""
    if weight.shape[0] == 0:
        return 0.0
    if bound is None:
        return np.inf
    if bound.ndim == 0:
        return float(np.linalg.eigvalsh(weight)[-1]) * float(bound) ** 2
    return float(bound @ np.abs(weight) @ bound)


def build_weights(
    plant: Plant,
    certificate: SampledCertificate | None,
    cost: CostFunction,
    bounds: ErrorBoundArguments | None = None,
    horizon: float = np.inf,
) -> CostWeights:
    """Return the effective weights: the cost's, else the certificate's; of neither the bounds', else the scales'.

    Bounds weigh so that each of the three terms is at most about one within a horizon (`weights_from_bounds`), which
    puts an estimate near the middle of what data and bounds leave possible. Raises ArgumentError if a weight has
    another size or is not positive definite, or the certificate is another plant's.
    """
    if certificate is not None and (other := first_difference(plant, certificate.plant)):
        raise ArgumentError(f"`certificate` belongs to another plant: {other}.")
    inverse = {
        "P2": plant.states.scales**-2.0,
        "Qw": plant.disturbances.scales**-2.0,
        "R": 2 * plant.outputs.scales**-2.0,
        "Qv": 2 * plant.outputs.scales**-2.0,
    }
    theirs = 0.0 if certificate is None else certificate.eta
    rate = checks.nonnegative("eta", theirs if cost.eta is None else cost.eta)
    by_hand = certificate is not None or any(key in MATRICES for key in cost.given)
    known = {} if bounds is None or by_hand else _weighed(plant, bounds, rate or 1 / horizon or fastest_rate(plant.A))
    matrices = {}
    for key, diagonal in inverse.items():
        value = getattr(cost, key)
        if value is None and certificate is not None:
            value = getattr(certificate, key)
        ours = known.get(key, np.diag(diagonal))
        matrices[key] = checks.definite(key, ours if value is None else value, diagonal.size)
    form = cost.form or "certificate"
    twice = 2.0 if form == "paper" else 1.0
    kept = twice * matrices["Qv"]
    together = symmetrise(matrices["R"] @ np.linalg.solve(matrices["R"] + kept, kept))
    prior, w = twice * matrices["P2"], twice * matrices["Qw"]
    return CostWeights(plant, prior, w, R=matrices["R"], v=kept, y=together, eta=rate, cost=form)


def _weighed(plant: Plant, bounds: ErrorBoundArguments, rate: float) -> dict[str, Array]:
    """The weights of the bounds that are given; of one that is zero, or that no weight in doubles says, none."""
    signals = {"w_bound": plant.disturbances, "v_bound": plant.outputs, "initial_error": plant.states}
    given: dict[str, VectorBound] = dict(bounds)  # type: ignore[arg-type]
    read = {name: vector_bound(name, bound, signals[name].names) for name, bound in given.items() if bound is not None}
    refuse_apart(plant.C, plant.G, w_bound=read.get("w_bound"), initial_error=read.get("initial_error"))
    usable = {name for name, bound in read.items() if np.all((bound >= 1 / LARGEST) & (bound <= LARGEST))}
    wanted = [read[name] if name in usable else 1.0 for name in signals]
    if not rate:  # integrators alone
        w, v = (read[name] if name in usable else signals[name].scales for name in ("w_bound", "v_bound"))
        rate = min(chain_speed(plant.A, plant.G, plant.C, w, v), LARGEST) or 1.0
    found = weights_from_bounds(plant, rate, *wanted)
    belong = {"P2": "initial_error", "Qw": "w_bound", "R": "v_bound", "Qv": "v_bound"}
    return {key: found[key] for key, name in belong.items() if name in usable}


def stretches(masks: Array) -> tuple[list[int], list[int]]:
    """Where stretches of like rows begin, and how long they are."""
    changes = np.flatnonzero((masks[1:] != masks[:-1]).any(axis=1)) + 1
    edges = [0, *changes.tolist(), len(masks)] if len(masks) else [0]
    return edges[:-1], [b - a for a, b in pairwise(edges)]
