"""How often samples may be lost by chance before the expected error grows without bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.numerics.linalg import balance, positive_or_one, right_directions
from sampling_design.numerics.modal_flow import exponential
from sampling_design.observability.alignment import align
from sampling_design.observability.count.pbh import require_observable
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.modes import split_modes
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.record import Claim, PlainRecord, counted, moment, probability
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule

NEARLY_HIDDEN = 1e-9  # a row that shows less of a direction than this share of its own length does not observe it
LOOKS = 20_000  # sets of samples that are looked at in one search for the largest hidden one
MOST_PERIODS = 8  # periods over which hidden sets are counted exactly; beyond, the zero count bounds them
SAME_GROWTH = 1e-8  # modes whose growth differs by less than this share of it, or by rounding, grow alike

MOST_GROWTH = 30.0
"""Logarithm of the growth within the periods that are counted exactly: beyond, doubles show one mode only."""


@dataclass(frozen=True, eq=False, repr=False)
class LossTolerance(PlainRecord):
    """Probabilities of independent losses that a periodic schedule tolerates.

    Attributes
    ----------
    lower : float
        Any loss probability below it keeps the expected squared error bounded. Proven.
    upper : float
        At it and above the expected squared error grows without bound. Proven where no hidden set is named,
        else attained by `hidden_times` up to rounding.
    limit : float
        e^{-2a/rho}: what no schedule of the same density can exceed.
    growth : float
        a, the largest real part of an eigenvalue [1/time]; 0 where no mode grows.
    density : float
        rho, samples per time.
    period : float
        P [time].
    hidden_times : (h,) array
        Times of a largest set of samples, over `periods` periods, that all miss one direction of the modes
        that do not decay.
    periods : int
        Periods over which hidden sets were counted; 0 where only the zero count was used.
    claim : Claim
    time_unit : str
    """

    lower: float
    upper: float
    limit: float
    growth: float
    density: float
    period: float
    hidden_times: Array
    periods: int
    claim: Claim
    time_unit: str = "s"

    _answers = (
        "how often samples of a periodic schedule may be lost at random",
        "{claim.evidence}",
        "the expected squared error stays bounded below {_lower}, and grows without bound from {_upper} on",
        "{_checked}",
    )
    _table = {
        "any schedule as dense": "below {_limit}",
        "growth": "{growth} 1/{time_unit}",
        "samples": "{density} per {time_unit}",
        "hidden together": "{_hidden}",
    }

    def _lower(self) -> str:
        return probability(self.lower)

    def _upper(self) -> str:
        return probability(self.upper, up=True)

    def _limit(self) -> str:
        return probability(self.limit, up=True)

    def _checked(self) -> str:
        where = "`zero_count_bound` says how many samples can miss a direction"
        return "samples at `.hidden_times` miss one direction together" if self.hidden_times.size else where

    def _hidden(self) -> str:
        return f"{counted(self.hidden_times.size, 'sample')} in {counted(self.periods, 'period')}"

    _plain = "lower upper limit growth density period periods hidden_times time_unit claim"

    def explain(self) -> str:
        """Say how many losses are borne, and which samples are worth moving."""
        if not self.lower:
            return "No probability of loss is proven to be borne: some direction is missed by every sample of a period."
        if not self.growth:
            return "No mode grows: any probability of loss below 1 keeps the expected error bounded."
        words = (
            f"Each sample may be lost with a probability below {self._lower()}, independently; from "
            f"{self._upper()} on the expected squared error grows without bound."
        )
        if self.hidden_times.size:
            spent = counted(self.periods, "period")
            listed = ", ".join(moment(t, self.hidden_times) for t in self.hidden_times[:6])
            listed += ", ..." * (self.hidden_times.size > 6) + f" {self.time_unit}"
            words += (
                f" Of {round(self.density * self.periods * self.period)} samples in {spent} those at {listed} may all "
                f"miss one direction; no schedule as dense tolerates {self._limit()}."
            )
        return words


@checked
def loss_tolerance(plant: Plant, schedule: PeriodicSchedule) -> LossTolerance:
    """Return the probabilities of independent losses that an endless schedule tolerates.

        p < exp(-2 a L P/(L N - K_L))        p < exp(-2 a/(rho - delta/(2 pi)))

    a is the fastest growth, N samples in a period P, rho = N/P, and K_L the most samples of L periods that
    all miss one direction of the modes that do not decay; delta is twice their largest frequency.

    Parameters
    ----------
    plant : Plant
        Detectable; its modes that do not decay are observed by some output.
    schedule : PeriodicSchedule
        Each of its samples is lost with the same probability p, independently of all others.

    Returns
    -------
    LossTolerance

    Raises
    ------
    ArgumentError
        If `schedule` is not periodic or its unit of time is not the plant's.
    NotObservableError
        If a mode that does not decay is observed by no output.

    Notes
    -----
    *Assumptions.* White noise of any intensities on every measured output; the error's covariance is that of
    the Kalman filter. *Proof, enough.* Of a finite number of samples every set that has full rank has a
    least singular value above some eps > 0; what each direction x at a period's start shows above eps |x| is
    thus all but at most K_L samples of L periods. Over B blocks of L periods the patterns "shown or not" of
    all trajectories are those of L N B quadratic forms in n unknowns, a number polynomial in B. So the
    probability that some trajectory is shown by none of the samples received in B blocks is at most a
    polynomial times p^{B (L N - K_L)}, where the error has grown by e^{2 a B L P} (polynomials aside):
    the sum over B is finite. The second condition is the first for L to infinity by the zero count, where
    every sample measures every output. *Proof, too much.* A direction of the fastest modes whose hidden samples
    repeat is lost for B blocks with probability p^{B (L N - K)}, from a covariance that even complete records
    leave positive. *Numerical aspects.* A sample does not observe a direction within `NEARLY_HIDDEN`, which
    can only lower `lower`. `upper` takes "repeats" within the same tolerance.

    References
    ----------
    Sinopoli, Schenato, Franceschetti, Poolla, Jordan, Sastry, IEEE TAC 49(9), 2004 (the critical probability);
    Mo and Sinopoli, IEEE TAC 57(3), 2012 (tail exponents of the filter's covariance).

    Examples
    --------
    >>> import numpy as np
    >>> plant = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
    >>> even = loss_tolerance(plant, PeriodicSchedule([np.pi / 2]))
    >>> uneven = loss_tolerance(plant, PeriodicSchedule(np.pi / 2 * np.array([0.6, 1.1, 0.8, 1.5])))
    >>> round(even.lower, 3), round(uneven.lower, 3), round(even.limit, 3)
    (0.533, 0.658, 0.73)
    """
    schedule = align(plant, schedule)
    kept = _retained(plant)
    density = len(schedule) / schedule.period
    growth, rounding = _fastest(kept)
    require_observable(plant, "a loss tolerance", 0.0)
    everything = bool(schedule.outputs is None or schedule.outputs.all())
    periods, hidden = _hidden(kept, schedule, growth)
    lower = 0.0
    for count, (most, _) in hidden.items():
        lower = max(lower, _borne(growth, count * schedule.period, count * len(schedule) - most))
    if everything:
        clusters = eigenvalue_clusters(kept.A) if kept.n_states else ()
        fastest = max((float(np.max(np.abs(c.members.imag))) + c.uncertainty for c in clusters), default=0.0)
        left = density - 2 * fastest / (2 * np.pi)
        lower = max(lower, _borne(growth, 1.0, left if left > NEARLY_HIDDEN * density else 0.0))
    limit = _borne(growth, 1.0, density)
    upper, times = limit, np.zeros(0)
    if periods:
        times = _times(schedule, hidden[periods][1])
    if growth:
        missed = _repeating(kept, schedule, growth, SAME_GROWTH * growth + rounding)
        if missed is not None:
            count, chosen = missed
            upper, times, periods = (
                _borne(growth, count * schedule.period, count * len(schedule) - len(chosen)),
                _times(schedule, chosen),
                count,
            )
    claim = Claim(
        f"independent losses with a probability below {probability(lower)} keep the expected squared error bounded",
        "hidden sets and their patterns, see the notes of loss_tolerance",
        ("white noise on every measured output", "losses are independent and equally likely"),
        citation="Mo and Sinopoli 2012",
    )
    lower, period = min(lower, upper), schedule.period
    return LossTolerance(
        lower=lower, upper=upper, limit=limit, growth=float(growth), density=density, period=period, hidden_times=times,
        periods=periods, claim=claim, time_unit=plant.time_unit,
    )  # fmt: skip


def _fastest(plant: Plant) -> tuple[float, float]:
    """The fastest growth, 0 where rounding alone may make it, and how well it is known.

    Each mode in its own size: what oscillates fast says nothing of one that grows slowly beside it.
    """
    growth, rounding = 0.0, 0.0
    for cluster in eigenvalue_clusters(plant.A) if plant.n_states else ():
        real, doubt = cluster.value.real, cluster.uncertainty
        if real > max(growth, min(doubt, SAME_GROWTH * abs(cluster.value))):
            growth, rounding = real, 2 * doubt
    return growth, rounding


def _retained(plant: Plant) -> Plant:
    """The modes that do not decay, without what outputs show of them within `NEARLY_HIDDEN` of what was added up."""
    split = split_modes(plant)
    part, added = split.retained, np.abs(plant.C) @ np.abs(split.basis_retained)
    return Plant(part.A, np.where(np.abs(part.C) > NEARLY_HIDDEN * added, part.C, 0.0))


def _borne(growth: float, time: float, samples: float) -> float:
    """exp(-2 a time/samples): the largest loss probability for which p^samples e^{2 a time} < 1; 0 without samples."""
    if samples <= 0:
        return 0.0
    return float(np.exp(-2 * growth * time / samples))


def _times(schedule: PeriodicSchedule, samples: frozenset[int]) -> Array:
    chosen = np.array(sorted(samples), dtype=int)
    return np.asarray(schedule.times[chosen % len(schedule)] + schedule.period * (chosen // len(schedule)))


def hidden_rows(plant: Plant, schedule: PeriodicSchedule, periods: int, growth: float) -> Array:
    """C e^{(A - a I) t} of every sample, (N, p, n), in balanced states: each row of length 1 or nothing at all.

    States that drive each other keep the sizes that their dynamics give them: by columns of one size, what rounding
    shows of a state that no sample sees would count as a reading.
    """
    tau = schedule.times - schedule.times[0]
    times = (tau + schedule.period * np.arange(periods)[:, None]).ravel()
    rows = exponential(plant.A - growth * np.eye(plant.n_states)).rows(plant.C, times)
    if schedule.outputs is not None:
        rows = rows * np.tile(schedule.outputs, (periods, 1))[:, :, None]
    rows = rows * balance(plant.A * schedule.period, plant.C).d  # of chains alone only time says how fast they are
    return np.asarray(rows / positive_or_one(np.linalg.norm(rows, axis=2))[:, :, None])


def _hidden(
    plant: Plant, schedule: PeriodicSchedule, growth: float
) -> tuple[int, dict[int, tuple[int, frozenset[int]]]]:
    """The largest hidden set over 1, 2, ... periods, and over how many it is rarest."""
    found: dict[int, tuple[int, frozenset[int]]] = {}
    if not plant.n_states:
        return 0, found
    values = np.linalg.eigvals(plant.A).real
    best, share = 0, np.inf
    for periods in range(1, MOST_PERIODS + 1):
        if (growth - float(values.min())) * schedule.period * periods > MOST_GROWTH:
            break
        largest = largest_hidden(hidden_rows(plant, schedule, periods, growth))
        if largest is None:
            break
        found[periods] = (len(largest), largest)
        if len(largest) / periods < share:
            best, share = periods, len(largest) / periods
    return best, found


def largest_hidden(rows: Array) -> frozenset[int] | None:
    """Return a largest set of samples, of (N, p, n) rows of length 1 or 0, that all miss one direction.

    None where more than `LOOKS` sets would have to be looked at. Every such set is what the null space of some
    of its own samples, at most n - 1 of them, is hidden from.
    """
    n = rows.shape[2]
    best: frozenset[int] = frozenset()
    visited: set[frozenset[int]] = set()
    stack = [np.eye(n)]
    looks = 0
    while stack:
        space = stack.pop()
        norms = np.linalg.norm(rows @ space, axis=(1, 2))
        closure = frozenset(np.flatnonzero(norms <= NEARLY_HIDDEN).tolist())
        if closure in visited:
            continue
        visited.add(closure)
        if len(closure) > len(best) or not best:
            best = closure
        if space.shape[1] == 1:
            continue
        for j in range(len(rows)):
            if j in closure:
                continue
            looks += 1
            if looks > LOOKS:
                return None
            singular, right = right_directions(rows[j] @ space)
            rank = int(np.sum(singular > NEARLY_HIDDEN))
            if rank < space.shape[1]:
                stack.append(space @ right[rank:].T)
    return best


def _repeating(
    plant: Plant, schedule: PeriodicSchedule, growth: float, alike: float
) -> tuple[int, frozenset[int]] | None:
    """A hidden set of the fastest modes that comes again after as many periods, or None where none was found."""
    values = np.linalg.eigvals(plant.A)
    slower = [v.real for v in values if v.real < growth - alike]
    line = (growth + max(slower, default=growth - 2 * max(growth, alike))) / 2
    moved = Plant(plant.A - line * np.eye(plant.n_states), plant.C)
    fast = _retained(moved)
    d = balance(fast.A, fast.C).d
    best: tuple[int, frozenset[int]] | None = None
    for count in range(1, MOST_PERIODS + 1):
        turned = exponential(fast.A - (growth - line) * np.eye(fast.n_states))([count * schedule.period])[0]
        turned = turned * d / d[:, None]
        if np.max(np.abs(turned - turned[0, 0] * np.eye(fast.n_states))) > NEARLY_HIDDEN * max(1.0, abs(turned[0, 0])):
            continue  # not every direction comes back; whether the hidden one does is not asked
        largest = largest_hidden(hidden_rows(fast, schedule, count, growth - line))
        if largest and (best is None or len(largest) * best[0] > len(best[1]) * count):
            best = (count, largest)
    return best
