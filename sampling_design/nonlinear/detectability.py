"""Assumption 7 along simulated pairs of trajectories: evidence for a nonlinear plant, never proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, marginal
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.region import own_box
from sampling_design.nonlinear.simulation import Integrator
from sampling_design.nonlinear.tightest_pairs import PairOutcome, SampledTrajectory, TightestPairs
from sampling_design.nonlinear.weights import NonlinearWeights, scaled_weights
from sampling_design.numerics.linalg import quadratic
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.record import Claim, YesOrNo, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

QUIET_SHARE = 1 / 3  # share of the pairs without disturbance and noise: there the right side is smallest
MOST_PAIRS = 1_000_000  # hours; more would be asked for by mistake
LINEARISED = 10  # pairs beside whose first trajectory all small differences are looked at
SAME_TIME = 1e-9  # grid times closer to a sample than this share of the step are that sample


class PairWitness(NamedTuple):
    """Where the inequality was tightest: number of the pair, its sampling set K_i, time, difference of the states."""

    pair: int
    start: int
    t: float
    difference: Array


@dataclass(frozen=True, eq=False, repr=False)
class DetectabilityEvidence(YesOrNo):
    """Inequality (16) along random pairs, and for all small differences from trajectories of some of them.

    True if it held along every pair, which is evidence and no proof; false if it failed along one, which refutes it.

        ratio = min over pairs and times of  (right side of (16)) / |dx(t)|^2_P1

    Attributes
    ----------
    ratio : float
        (16) held along all pairs exactly when this is at least 1.
    least_lambda : float
        lambda_max(P2, P1) cannot be less than this for any P1 that satisfies (16) with these P2, Qw, R, Qv, eta:
        the largest |dx(t)|^2_P2 over the right side. This much is refuted, not only sampled.
    least_lambda_time : float
        When that was.
    quiet_lambda : float
        The same for small differences with equal disturbances, so that Qw does not matter.
    ratios : array
        The least ratio of each pair.
    pairs, left_out : int
        Pairs looked at, and pairs that left X or could not be simulated (not counted in `pairs`).
    eta, duration : float
    witness : PairWitness
    claim : Claim
        Its strength is "sampled".
    """

    ratio: float
    least_lambda: float
    least_lambda_time: float
    quiet_lambda: float
    ratios: Array
    pairs: int
    left_out: int
    eta: float
    duration: float
    time_unit: str
    witness: PairWitness
    claim: Claim

    _answers = (
        "inequality (16) of the paper along random pairs of trajectories",
        "{claim.strength}: it {_verdict} along {pairs} pairs",
        "worst ratio {ratio}",
        "`.witness`: the worst pair",
    )
    _table = {
        "pairs": "{pairs}{_left_out} (evidence, not proof)",
        "at": "pair {witness.pair}, K_{witness.start}, t = {witness.t} {time_unit}",
        "median ratio": "{_median}",
        "lambda, at least": "{least_lambda} (at t = {least_lambda_time})",
        "lambda, at least, equal disturbances": "{quiet_lambda}",
        "horizon of Theorem 9, at least": "{least_horizon} {time_unit}",
        "eta": "{eta} 1/{time_unit}",
        "duration": "{duration} {time_unit}",
    }

    def _left_out(self) -> str:
        return f", {self.left_out} more left out" if self.left_out else ""

    def _median(self) -> float:
        return float(np.median(self.ratios))

    @property
    def holds(self) -> bool:
        """Whether (16) held at every time that was looked at."""
        return self.ratio >= 1.0

    def _answer(self) -> bool:
        return self.holds

    def least_horizon(self) -> float:
        """Return 2 ln(2 least_lambda)/eta: with these weights Theorem 9 asks for more than this, whatever P1 is."""
        return float(2 * np.log(2 * self.least_lambda) / self.eta) if self.eta > 0 else float("inf")

    def explain(self) -> str:
        """Say what was seen and that it proves nothing."""
        text = f"Inequality (16) {self._verdict()} along {self.pairs} random pairs; its right side was at least "
        text += f"{short(self.ratio)} times the left. "
        if self.holds:
            return text + "This is evidence, not proof: other pairs and times in between were not looked at."
        return text + (
            f"So it does not hold with these weights and this P1; any P1 that it holds with has lambda_max(P2, P1) of "
            f"at least {short(self.least_lambda)}."
        )

    def _verdict(self) -> str:
        return "held" if self.holds else "failed"


@checked
def check_detectability(
    plant: NonlinearPlant,
    schedule: Schedule | PeriodicSchedule,
    x0: object = None,
    *,
    cost: CostFunction,
    P1: object = None,
    duration: float,
    dt: float | None = None,
    pairs: int = 100,
    u: object = None,
    rng: checks.Seed = None,
    budget: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> DetectabilityEvidence:
    """Look at Assumption 7 along random pairs of simulated trajectories.

        |dx(t)|^2_P1 <= e^{-eta t}|dx(0)|^2_P2 + int e^{-eta(t-tau)}|dw|^2_Qw
                            + sum e^{-eta(t-tau)}(|dy|^2_R + |dv|^2_Qv)

    Parameters
    ----------
    plant : NonlinearPlant
    schedule : Schedule or PeriodicSchedule
        Generates the sets K_i; the pairs take them in turn. An output that is not measured at a sample is free there.
    x0 : (lower, upper), optional
        Box from which initial states are drawn, uniformly. Default: the plant's box of states, if finite.
    cost : CostFunction
        P2, Qw, R, Qv (physical weights, with the estimator's defaults) and eta, which must be given.
    P1 : (n, n) array, optional
        The weight on the left; default P2.
    duration : float
        Length of the trajectories [time].
    dt : float, optional
        The disturbances are constant on pieces of this length [time]; default duration/40.
    pairs : int
        A hundred take about 2.5 s of processor time with two to four states, and 9 s with six.
    u : (m,) array, optional
        Constant input; default 0.
    rng : numpy.random.Generator or its seed, optional
    budget : float, optional [seconds]
        No pair begins after it but the first; `pairs` of the evidence says how many were looked at.
    progress : callable, optional

    Returns
    -------
    DetectabilityEvidence

    Raises
    ------
    ArgumentError
        If an argument has the wrong size or sign, the rate or the box of starts is missing, or every pair leaves X.

    Notes
    -----
    *Claim.* Sampled: holds at the grid times of these pairs, at samples also in the limit from the left. `least_lambda`
    is a bound from below, up to the integrator's tolerance.
    *Method.* w and v are uniform in their boxes (in +-1 scale where unbounded), shrunk by a random factor per pair, and
    zero for a third of the pairs. Along one trajectory of each of the first ten pairs the least right side over all
    small differences, disturbances and noises that lead to dx(t) is a quadratic form in dx(t), and (16) a generalised
    eigenvalue problem at each time; before the first grid time at 40 more instants, evenly in their logarithms.

    References
    ----------
    The paper, Assumption 7 and Section VI.

    Examples
    --------
    >>> from sampling_design import CostFunction, PeriodicSchedule
    >>> plant = NonlinearPlant(lambda x, u, w: [-(x[0] ** 3) + w[0]], lambda x, u, v: [x[0] + v[0]],
    ...                        {"states": 1, "disturbances": 1, "outputs": 1})
    >>> cost = CostFunction(eta=0.1)
    >>> found = check_detectability(plant, PeriodicSchedule([1.0]), ([-1], [1]), cost=cost, duration=5.0, pairs=6)
    >>> found.claim.strength, found.pairs
    ('sampled', 6)
    """
    if cost.eta is None:
        raise ArgumentError("`cost` must give a rate here: CostFunction(eta=...).")
    study = DetectabilityStudy(plant, scaled_weights(plant, cost), x0, duration, dt, u)
    left = study.weights.P2 if P1 is None else scaled_weights(plant, CostFunction(P2=P1), name="P1").P2  # type: ignore[arg-type]
    rng = checks.generator(rng)
    count, sets = checks.whole("pairs", pairs, 1), SamplingSet(schedule)
    if count > MOST_PAIRS:
        raise ArgumentError(f"`pairs` must be at most {MOST_PAIRS}: each takes milliseconds, got {pairs!r}.")
    found, looked, limit = [], 0, Budget(None if budget is None else checks.positive("budget", budget))
    for k in range(count):
        if k and limit.over:
            break
        i = 1 + k % sets.distinct
        outcome = study.pair(sets.starting_at(i), left, rng, k < LINEARISED)
        if outcome is not None:
            found.append((outcome, PairWitness(k, i, outcome.t, outcome.difference * plant.signals["states"].scales)))
        looked = k + 1
        if progress is not None:
            progress(looked / count, f"{looked} of {count} pairs")
    return study.evidence(found, looked - len(found))


class DetectabilityStudy:
    """What all pairs share."""

    def __init__(
        self, plant: NonlinearPlant, weights: NonlinearWeights, x0: object, duration: object, step: object, u: object
    ) -> None:
        self.plant, self.weights = plant, weights
        self.start = own_box("states", plant.bounds["states"] if x0 is None else x0, plant.n_states)
        if not np.all(np.isfinite(self.start)):
            raise ArgumentError("`x0` must be a finite box (lower, upper): the plant's box of states is not.")
        self.duration = checks.positive("duration", duration)
        self.step = self.duration / 40 if step is None else checks.positive("dt", step)
        self.u = checks.vector("u", np.zeros(plant.n_inputs) if u is None else u, plant.n_inputs)
        self.integrator = Integrator(plant)
        self.tightest = TightestPairs(plant, weights)

    def evidence(self, found: list[tuple[PairOutcome, PairWitness]], left_out: int) -> DetectabilityEvidence:
        """Return the record of the pairs that stayed in X. Raises ArgumentError if there are none."""
        if not found:
            raise ArgumentError("`x0` must hold states from which pairs stay in X, got none: every pair left it.")
        least, witness = min(found, key=lambda item: item[0].ratio)
        unit = self.plant.time_unit
        statement = f"(16) along {len(found)} random pairs of length {short(self.duration)} {unit}"
        claim = Claim(statement, "Assumption 7", ("only these pairs and grid times",), "sampled")
        values = freeze([looked.ratio for looked, _ in found])
        growth, when = max([(1.0, 0.0), *((looked.lam, looked.lam_time) for looked, _ in found)])  # at t = 0 it is 1
        return DetectabilityEvidence(
            ratio=least.ratio,
            least_lambda=growth,
            least_lambda_time=when,
            quiet_lambda=max(1.0, *(looked.quiet for looked, _ in found)),
            ratios=values,
            pairs=len(found),
            left_out=left_out,
            eta=self.weights.eta,
            duration=self.duration,
            time_unit=unit,
            witness=witness,
            claim=claim,
        )

    def pair(self, times: AnySchedule, P1: Array, rng: np.random.Generator, near: bool) -> PairOutcome | None:
        """Return what a pair shows, where `near` with all small differences from its first one; None outside X."""
        within = times.between(0.0, self.duration)
        samples = within.times
        grid = _grid(self.duration, self.step, samples)
        loud = 0.0 if rng.random() < QUIET_SHARE else rng.random()
        one, other = (self._trajectory(grid, loud, rng) for _ in range(2))
        if one is None or other is None:
            return None
        x, w, v, y = (a - b for a, b in zip(one, other, strict=True))
        measured = np.zeros(y.shape, dtype=np.bool_)
        measured[np.isin(grid, samples)] = True if within.outputs is None else within.outputs
        ratio = ratios(grid, x, w, v, y, measured, P1, self.weights)
        j = int(np.argmin(ratio))
        grown = ratios(grid, x, w, v, y, measured, self.weights.P2, self.weights)
        k = int(np.argmin(grown))
        found = PairOutcome(float(ratio[j]), float(grid[j]), x[j], 1 / float(grown[k]), float(grid[k]))
        if not near:
            return found
        scale = self.plant.scales
        first = [part * scale[key] for part, key in zip(one, ("states", "disturbances", "noises"), strict=False)]
        tight = self.tightest.along(SampledTrajectory(grid, first[0], first[1], first[2], self.u, measured), P1)
        least, most = min(found, tight, key=itemgetter(0)), max(found, tight, key=itemgetter(3))
        return PairOutcome(*least[:3], *most[3:5], tight.quiet)

    def _trajectory(
        self, grid: Array, loud: float, rng: np.random.Generator
    ) -> tuple[Array, Array, Array, Array] | None:
        """Return scaled x, w, v and y on the grid; None if x leaves X or the integration fails."""
        plant = self.plant
        x = np.empty((grid.size, plant.n_states))
        x[0] = rng.uniform(*self.start)
        w, v = (loud * self._noise(key, grid.size, rng) for key in ("disturbances", "noises"))
        y = np.empty((grid.size, plant.n_outputs))
        lower, upper = plant.bounds["states"]
        for j, t in enumerate(grid.tolist()):
            if np.any(x[j] < lower) or np.any(x[j] > upper):
                return None
            y[j] = plant.h(x[j], self.u, v[j])
            if j + 1 < grid.size:
                try:
                    x[j + 1] = self.integrator.step(x[j], self.u, w[j], t, grid[j + 1])
                except SolverError:
                    return None
        scale = plant.scales
        return x / scale["states"], w / scale["disturbances"], v / scale["noises"], y / scale["outputs"]

    def _noise(self, key: str, rows: int, rng: np.random.Generator) -> Array:
        scale = self.plant.signals[key].scales
        lower, upper = self.plant.bounds[key]
        return rng.uniform(
            np.where(np.isfinite(lower), lower, -scale), np.where(np.isfinite(upper), upper, scale), (rows, scale.size)
        )


def _grid(duration: float, step: float, samples: Array) -> Array:
    """Multiples of the step up to the duration, and the samples; a multiple that is nearly a sample gives way."""
    regular = np.append(np.arange(0.0, duration * (1 - SAME_TIME), step), duration)
    if samples.size:
        near = np.abs(regular[:, None] - samples).min(axis=1) <= SAME_TIME * step
        regular = regular[~near]
    grid = np.union1d(regular, samples)
    return grid if grid[0] == 0.0 else np.insert(grid, 0, 0.0)


def ratios(
    grid: Array, x: Array, w: Array, v: Array, y: Array, measured: Mask, P1: Array, weights: NonlinearWeights
) -> Array:
    """Return, at each grid time, right side over left side of (16) for differences of one pair, all scaled.

    `measured` says of each grid time and output whether it is measured then; what is not is free, and so is its noise
    where each output has its own. At a sample the smaller of the values before and after it counts; infinite where the
    states agree.
    """
    eta = weights.eta
    right = np.empty(grid.size)
    gaps = np.diff(grid)
    gain = quadratic(w[:-1], weights.Qw) * discounted_length(eta, gaps)
    jump = np.zeros(grid.size)
    for pattern in np.unique(measured[measured.any(axis=1)], axis=0):
        at = (measured == pattern).all(axis=1)
        Qv = marginal(weights.Qv, pattern) if v.shape[1] == pattern.size else weights.Qv
        jump[at] = quadratic(y[at], marginal(weights.R, pattern)) + quadratic(v[at], Qv)
    total = float(x[0] @ weights.P2 @ x[0])
    for j in range(grid.size):
        if j:
            total = total * np.exp(-eta * gaps[j - 1]) + gain[j - 1]
        right[j] = total  # before the sample at this time, if there is one
        total += jump[j]
    left = quadratic(x, P1)
    return np.asarray(np.divide(right, left, out=np.full(grid.size, np.inf), where=left > 0))
