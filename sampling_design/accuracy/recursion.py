"""The best guaranteed estimate on a periodic schedule as a recursion: gains are made once, an update is cheap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.accuracy_record import Accuracy
from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.gains import Gains, whole_gains
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.accuracy.search import GainSearch
from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import forced_flow
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, freeze
from sampling_design.records.record import PlainRecord, above, short
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.family import period_of

FORGOTTEN = 1e-13  # share of a radius below which the start no longer counts: it is added once more, and then left out
TINY = 1e-9  # half-width of what is known exactly at the start, in scaled coordinates


@dataclass(frozen=True, eq=False, repr=False)
class PeriodicEstimate(PlainRecord):
    """Wanted rows after one sample: |z - value| <= radii if the bounds hold.

    Attributes
    ----------
    t : float
        Of the sample.
    value, radii : (r,) arrays
    """

    t: float
    value: Array
    radii: Array

    def _rows(self) -> list[tuple[str, str]]:
        pairs = zip(self.value, self.radii, strict=True)
        return [("t", short(self.t)), *((f"z{k + 1}", f"{short(z)} ± {above(r)}") for k, (z, r) in enumerate(pairs))]

    def explain(self) -> str:
        """Say what is guaranteed."""
        pairs = zip(self.value, self.radii, strict=True)
        return f"At {short(self.t)}: " + ", ".join(f"{short(z)} within {above(r, 4)}" for z, r in pairs) + "."


@dataclass(frozen=True, eq=False)
class _UpdatePhase:
    """What one update at one sample of the period needs."""

    outputs: Index
    F: Array  # to this sample from the one before, inputs as further columns
    C: Array  # (p_j, n + m) over the noise, inputs as further columns
    size: Array
    drift: Array  # what a middle of w other than 0 adds since the sample before
    shift: Array  # the middle of v over the noise
    K: Array
    weights: Array  # (r, back * p)
    radii: Array
    early: Array  # (r,) radii of the filter alone
    rests: Array  # (n, r) what of the filter's error at the window's start is left
    mu: Array  # (n, r)
    passed: Array  # the filter's error from after the sample before to after this one


class PeriodicGains:
    """Estimates of wanted rows with the least guaranteed error, sample by sample of a periodic schedule.

        z = c'x_filter + sum over the last samples of weights_k'(y_k - C x_filter,k)

    Parameters
    ----------
    found : Accuracy
        Of a periodic schedule; its plant, bounds and rows.
    prior : (n,) array, optional
        The state expected at the first sample. Default 0.
    initial_error : float, (n,) or (n, n) array, or mapping
        What is known of x at the first sample less `prior`, as for `guaranteed_accuracy`; all states must be bounded.
    first : int
        Place in the period of the first sample.

    Raises
    ------
    ArgumentError
        If the schedule is finite, a row or an initial error is unbounded, or an argument has another shape.

    Notes
    -----
    *Assumptions.* Samples come at the times of the schedule; bounds hold. *Claim.* Radii hold for every sample; after
    the start is forgotten they are those of `guaranteed_accuracy` at the samples, and no estimator guarantees less.
    *Method.* The gains of the adversary's program, written as weights on the innovations of a periodic filter, so that
    inputs and unstable modes pass through a stable recursion. Until the window is full the filter alone speaks, with
    the radii that its gains prove. An update costs a few products of a matrix with a vector.

    References
    ----------
    Milanese and Tempo, Optimal algorithms theory for robust estimation and prediction (1985).

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant, guaranteed_accuracy
    >>> plant = Plant([[0.0]], [[1.0]])
    >>> found = guaranteed_accuracy(plant, PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.3)
    >>> gains = PeriodicGains(found, initial_error=1.0)
    >>> [float(gains.update([y]).radii[0].round(4)) for y in (0.0,) * 12][-1]
    0.3
    """

    @checked
    def __init__(
        self, found: Accuracy, *, prior: npt.ArrayLike | None = None, initial_error: VectorBound = None, first: int = 0
    ) -> None:
        plant, finite = found.plant, "`found` must be the accuracy of a periodic schedule, got that of one that ends."
        schedule = period_of(found.schedule, finite)
        if found.unknown or not np.all(np.isfinite(found.upper)):
            raise ArgumentError(
                f"`found` must know every mode, but no sample shows {', '.join(found.unknown)}. "
                "Leave those states out of the plant."
            )
        if found.question.is_late:
            raise ArgumentError("`found` must be of samples on time that are known at once: gains are of one schedule.")
        start = InitialSet.of(plant, initial_error)
        if not start.whole:
            raise ArgumentError("`initial_error` must bound every state: nothing is guaranteed before it is forgotten.")
        self.plant, self.schedule, self.rows = plant, schedule, found.rows
        search = GainSearch(*found.question.filter_bounds(plant))
        system = self._system = search.system
        search.back = max([len(g) for part in found.proof for g in part.gains], default=8)
        self._back, self._p, self._n = search.back, plant.n_outputs, plant.n_states
        self._phases = [_phase(search, plant, found, j) for j in range(len(system))]
        self._start = start.scaled(system.D[:, None] * system.L[first % len(system)], system.D, TINY)
        self._x = np.array(checks.vector("prior", np.zeros(plant.n_states) if prior is None else prior, plant.n_states))
        self._x = self._x + start.centre
        self._innovations = np.zeros(2 * self._back * self._p)
        self._at = self._back * self._p
        self._count, self._j = 0, first % len(system)
        self._time = float(schedule.times[self._j])
        self._u = np.zeros(plant.n_inputs)
        self._passed: list[Array] | None = []

    @property
    def settled(self) -> bool:
        """Whether the start no longer counts."""
        return self._passed is None

    def update(self, y: npt.ArrayLike, u: npt.ArrayLike | None = None) -> PeriodicEstimate:
        """Return the estimate after the next sample of the schedule.

        Parameters
        ----------
        y : (p,) array
            NaN where the schedule does not measure.
        u : (m,) array, optional
            Input that holds from this sample on; default as before.

        Raises
        ------
        ArgumentError
            If y lacks an output that the schedule measures, or an argument has another shape. Nothing changes then.
        """
        phase, n = self._phases[self._j], self._n
        read = np.asarray(y, dtype=np.float64)
        if read.shape != (self._p,):
            raise ArgumentError(f"`y` must have shape ({self._p},), got {read.shape}.")
        kept = self._u if u is None else checks.vector("u", u, self._u.size)
        x = self._x
        joint = np.concatenate([x, self._u])
        if self._count:
            joint[:n] = phase.F @ joint + phase.drift
        innovation = read[phase.outputs] / phase.size - phase.C @ joint - phase.shift
        if not np.isfinite(innovation).all():
            raise ArgumentError(
                f"`y` must be finite where the schedule measures, got {read.tolist()!r} at {self._time!r}."
            )
        self._x = joint[:n] + phase.K @ innovation
        if self._at == self._innovations.size:
            self._innovations[: self._back * self._p] = self._innovations[self._back * self._p :]
            self._at = self._back * self._p
        self._innovations[self._at : self._at + self._p] = 0.0
        self._innovations[self._at + phase.outputs] = innovation
        self._at += self._p
        value = self.rows.matrix @ self._x
        radii = phase.radii
        self._count += 1
        if self._passed is not None:
            radii = self._early(phase)
        if self._count > self._back:
            value = value + phase.weights @ self._innovations[self._at - self._back * self._p : self._at]
        estimate = PeriodicEstimate(self._time, value, radii)
        self._u = kept
        self._j = (self._j + 1) % len(self._phases)
        shift = self._time - self.schedule.times[self._j - 1]
        self._time = float(self.schedule.times[self._j] + shift + (self.schedule.period if self._j == 0 else 0.0))
        return estimate

    def _early(self, phase: _UpdatePhase) -> Array:
        """Radii while the start still counts: what is left of it, and the filter's own before the window is full."""
        assert self._passed is not None
        first = np.eye(self._n) - self._system.samples[self._j].K @ self._system.samples[self._j].H
        self._passed.append(phase.passed @ self._passed[-1] if self._passed else first)
        if self._count > self._back:
            window = self._passed[-self._back]
            left = [self._start.support(window.T @ rest, 1.0) for rest in phase.rests.T]
            if np.all(np.array(left) <= FORGOTTEN * phase.radii):
                self._passed = None
            else:
                self._passed = self._passed[-self._back :]
            return np.asarray(phase.radii + np.array(left))
        left = [self._start.support(self._passed[-1].T @ mu, 1.0) for mu in phase.mu.T]
        return np.asarray(phase.early + np.array(left))


def _phase(search: GainSearch, plant: Plant, found: Accuracy, j: int) -> _UpdatePhase:
    system, bounds, n, m = search.system, search.system.bounds, plant.n_states, plant.n_inputs
    sample, before = system.samples[j], system.gaps[j - 1]
    scaled = np.hstack([plant.B, np.zeros((n, 1)) if bounds.w_centre is None else (plant.G @ bounds.w_centre)[:, None]])
    flow = forced_flow(system.A, scaled / system.D[:, None], [before.length])[0]
    flow = system.D[:, None] * flow / np.concatenate([system.D, np.ones(m + 1)])
    mu = system.mu(j, found.rows.matrix)
    made = [search.window(j, search.back, False).gains(column) for column in mu.T]
    parts = [_on_innovations(search, j, column, one) for column, one in zip(mu.T, made, strict=True)]
    shift = np.zeros(len(sample.H)) if bounds.v_centre is None else bounds.v_centre[j, sample.outputs] / sample.size
    return _UpdatePhase(
        outputs=sample.outputs,
        F=freeze(flow[:, : n + m]),
        C=freeze(np.hstack([plant.C, plant.D])[sample.outputs] / sample.size[:, None]),
        size=sample.size,
        drift=freeze(flow[:, n + m]),
        shift=freeze(shift),
        K=freeze(system.D[:, None] * (system.L[j] @ sample.K)),
        weights=freeze([weights for weights, _ in parts]),
        radii=freeze([one.value for one in made]),
        early=freeze(np.abs(mu).T @ system.reach[j]),
        rests=freeze(np.array([rest for _, rest in parts]).T),
        mu=freeze(mu),
        passed=freeze((np.eye(n) - sample.K @ sample.H) @ before.F),
    )


def _on_innovations(search: GainSearch, j: int, mu: Array, gains: Gains) -> tuple[Array, Array]:
    """Weights on the filter's innovations in place of gains on the data, and the rest at the window's start.

    These are gains beside the filter's, and (I - H K)'lambda_0 at the first sample, whose estimate the window starts
    from.
    """
    system: SampledSystem = search.system
    p = system.plant.n_outputs
    nodes = system.nodes(j, len(gains.gains))
    weights, (whole, rest) = np.zeros((len(nodes), p)), whole_gains(system, nodes, mu, gains.gains)
    for k, node in enumerate(nodes):
        sample, lam = system.samples[node], whole[k]
        weights[k, sample.outputs] = gains.gains[k] if k else lam - sample.K.T @ (sample.H.T @ lam)
    return weights.ravel(), rest
