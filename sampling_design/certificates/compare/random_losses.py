"""How likely a window contracts, and by what factor the squared error shrinks, where samples are lost by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.compare.contraction import FINITE
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.window_problem import WindowProblem, window_problem
from sampling_design.errors import ArgumentError
from sampling_design.numerics.filtering import measurement_update, propagate
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.evidence import Claim
from sampling_design.records.record import PlainRecord, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import period_of

MOST_PATTERNS = 2048
"""Patterns of received samples that are followed side by side: eleven samples and fewer are counted out exactly, of
more the patterns that matter least are left as bounds."""
MOST_SAMPLES = 128  # of a window: work grows with their square
UNDECIDED = 1e-9  # a factor within this share of 1 is on neither side of it: rounding decides


@dataclass(frozen=True, eq=False, repr=False)
class RandomLosses(PlainRecord):
    """What is left of a certificate's contraction if every sample is lost with the same probability, independently.

    Attributes
    ----------
    loss_probability : float
        p.
    length : float [time]
        M, a whole number of periods.
    samples : int
        Samples that are planned in a window.
    ends : (N,) array [time]
        Where the windows (t - M, t] end: at the samples of a period.
    probability : (N, 2) array
        Lower and upper bound of the probability that the window contracts, rho < 1.
    factor : (N, 2) array
        Lower and upper bound of E[rho]; the upper one is infinite where it could not be bounded.
    time_unit : str
    """

    loss_probability: float
    length: float
    samples: int
    ends: Array
    probability: Array
    factor: Array
    time_unit: str

    @property
    def contracts(self) -> tuple[float, float]:
        """Bounds of the probability that a window contracts, of the window where it is least."""
        lower, upper = self.probability.min(axis=0).tolist()
        return lower, upper

    @property
    def mean_factor(self) -> tuple[float, float]:
        """Bounds of E[rho] of the window where it is largest."""
        lower, upper = self.factor.max(axis=0).tolist()
        return lower, upper

    @property
    def rate(self) -> float | None:
        """-ln(E[rho])/M [1/time]: how fast the expected squared error decays; None where E[rho] < 1 is not proven."""
        worst = max(self.mean_factor[1], float(np.finfo(float).tiny))  # a smaller one is 0 by rounding alone
        return -float(np.log(worst)) / self.length if worst < 1 else None

    def windows_in_a_row(self, count: int) -> tuple[float, float]:
        """Return bounds of the probability that so many windows, one after the other, all contract."""
        lower, upper = self.contracts
        power = checks.whole("count", count, 1)
        return lower**power, upper**power

    @property
    def claim(self) -> Claim:
        """What is bounded, and what it assumes."""
        return Claim(
            f"a window contracts with a probability of at least {short(self.contracts[0])}, and the expected squared "
            f"error by a factor of at most {short(self.mean_factor[1])}",
            "expected contraction under random losses",
            (
                "losses are independent, of each other and of the noise",
                "the estimator minimises the certificate's cost over (t - M, t]",
                "linear plant, in doubles",
            ),
        )

    _table = {
        "samples lost": "with probability {loss_probability}",
        "window": "{length} {time_unit}, {samples} samples",
        "contracts": "with probability {contracts[0]} to {contracts[1]}",
        "squared error": "times {mean_factor[0]} to {mean_factor[1]} a window, on average",
    }
    _plain = "loss_probability length samples ends probability contracts factor mean_factor rate claim"

    def explain(self) -> str:
        """Say how likely the promise holds, and whether the error stays bounded on average."""
        unit, (lower, upper) = self.time_unit, self.contracts
        likely = short(lower, 4) if upper - lower <= 1e-4 * upper else f"{short(lower, 4)} to {short(upper, 4)}"
        words = (
            f"If each sample is lost with probability {short(self.loss_probability)}, a window of {short(self.length)} "
            f"{unit} still contracts with probability {likely}."
        )
        if self.rate is not None:
            return (
                f"{words} On average the squared error shrinks at least by the factor {short(self.mean_factor[1])} a "
                f"window, at the rate {short(self.rate)} per {unit}."
            )
        if self.mean_factor[0] >= 1:
            return f"{words} On average the bound on the squared error does not shrink."
        return f"{words} Whether the squared error shrinks on average is not decided."


@checked
def random_losses(certificate: Certificate, loss_probability: float, *, length: float | None = None) -> RandomLosses:
    """Bound how likely a certificate's contraction holds, and its mean, where samples are lost by chance.

        P(rho_S < 1),   E[rho_S],   rho_S = e^{-eta M} lambda_max(P2 Y_S(t)),   S the samples received in (t - M, t]

    Y_S is the inverse of the information that the window keeps of P2: in its norm |e(t)|^2 <= rho_S (|e(t - M)|^2 + N),
    N = e^{eta M} times the noise of the window in the certificate's cost.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule.
    loss_probability : float
        p in [0, 1]: of every sample, all outputs together.
    length : float, optional [time]
        M, a whole number of periods. Default: the least that is not below `certificate.horizon().length`.

    Returns
    -------
    RandomLosses

    Raises
    ------
    ArgumentError
        If the schedule is finite, `loss_probability` no probability, `length` not a whole number of periods, or a
        window holds more than `MOST_SAMPLES` samples.

    Notes
    -----
    *Claim.* For windows that end at the samples of a period, whatever the noise: E|e(k M)|^2 <= r^k |e(0)|^2 +
    r N/(1 - r) with r = E[rho], since windows that follow each other share no sample. At p = 0 this is the
    certificate's own contraction. *Method.* rho_S only grows where a sample is lost. Patterns are decided sample by
    sample in time; what is left open is bounded by all the rest received and all the rest lost. Up to eleven samples
    the bounds coincide; of more, `MOST_PATTERNS` patterns are followed, those that leave most open. *Sharp.* For
    each pattern some pair of motions attains rho_S.

    References
    ----------
    Proof: docs/theory/horizon.md. Filters that lose samples: Sinopoli et al., IEEE TAC 49(9), 2004.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant, certify
    >>> swing = certify(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([0.5, 1.5]))
    >>> found = random_losses(swing, 0.1)
    >>> found.contracts[0] > 0.99, random_losses(swing, 0.0).contracts
    (True, (1.0, 1.0))
    """
    schedule = period_of(certificate.schedule, FINITE)
    p = checks.nonnegative("loss_probability", loss_probability)
    if p > 1:
        raise ArgumentError(f"`loss_probability` must lie between 0 and 1, got {p!r}.")
    asked = certificate.horizon().length if length is None else checks.positive("length", length)
    periods = asked / schedule.period
    if (most := periods * (1 - 1e-9) * len(schedule)) > MOST_SAMPLES:
        raise ArgumentError(
            f"`length` = {short(asked)} spans {short(np.ceil(most))} samples: at most {MOST_SAMPLES} are followed."
        )
    whole = max(1, int(np.ceil(periods * (1 - 1e-9)))) if length is None else round(periods)
    if length is not None and (whole < 1 or abs(periods - whole) > 1e-9 * whole):
        raise ArgumentError(
            f"`length` = {short(asked)} must be a whole number of periods ({short(schedule.period)}): windows that "
            "follow each other are alike then."
        )
    M = whole * schedule.period
    c = certificate
    problem = window_problem(c.plant, schedule, c.P2, c.Qw, c.R, c.Qv, c.eta)
    ends = np.array(schedule.times)
    with np.errstate(over="ignore", invalid="ignore"):  # growth that no double holds bounds nothing
        found = [_window(problem, index, M, whole, p) for index in range(len(ends))]
    probability, factor = (np.array([each[k] for each in found]) for k in range(2))
    return RandomLosses(
        loss_probability=p,
        length=M,
        samples=whole * len(schedule),
        ends=ends,
        probability=probability,
        factor=factor,
        time_unit=c.plant.time_unit,
    )


def _window(problem: WindowProblem, last: int, M: float, periods: int, p: float) -> tuple[Array, Array]:
    """Bounds of P(rho < 1) and of E[rho] of the window that ends with the sample `last` of a period."""
    n = problem.size
    if not n:
        return np.ones(2), np.zeros(2)
    order = (last + 1 + np.arange(periods * problem.count)) % problem.count
    F, W = problem.flow(problem.gaps[order])
    rows, half = problem.rows[order], float(np.exp(-problem.eta * M / 2))
    steps = len(order)

    def factors(Y: Array, at: int, received: bool) -> Array:
        """Rho where of all samples from the step `at` on every one is received, or lost."""
        for k in range(at, steps):
            Y = propagate(Y, F[k], W[k])
            Y = measurement_update(Y, rows[k]) if received else Y
        finite = np.isfinite(Y).all(axis=(1, 2))
        found = np.full(len(Y), 0.0 if received else np.inf)
        found[finite] = half * np.linalg.eigvalsh(Y[finite])[:, -1] * half
        return found

    Y, mass = np.eye(n)[None], np.ones(1)
    low, high = factors(Y, 0, True), factors(Y, 0, False)
    done = np.zeros(4)  # mass that contracts, and that does not; the sums of mass times low and high
    for k in range(steps):
        before = propagate(Y, F[k], W[k])
        after = measurement_update(before, rows[k])
        known = [
            (after, mass * (1 - p), low, factors(after, k + 1, False)),
            (before, mass * p, factors(before, k + 1, True), high),
        ]
        Y, mass, low, high = (np.concatenate(parts) for parts in zip(*known, strict=True))
        kept = _open(mass, low, high)
        done += _summed(mass[~kept], low[~kept], high[~kept])
        Y, mass, low, high = Y[kept], mass[kept], low[kept], high[kept]
    done += _summed(mass, low, high)
    return np.array([done[0], 1 - done[1]]).clip(0.0, 1.0), done[2:]


def _open(mass: Array, low: Array, high: Array) -> Mask:
    """Which patterns are followed further: those that leave most open, as many as may be."""
    undecided = (low <= 1 + UNDECIDED) & (high >= 1 - UNDECIDED)
    worth = mass * (undecided + np.minimum(high, np.finfo(float).max) - np.minimum(low, np.finfo(float).max))
    kept = worth > 0
    if np.count_nonzero(kept) > MOST_PATTERNS:
        kept &= worth > np.partition(worth, -MOST_PATTERNS - 1)[-MOST_PATTERNS - 1]
    return kept


def _summed(mass: Array, low: Array, high: Array) -> Array:
    """Mass that contracts, mass that does not, and both bounds of the mean; what has no mass counts for nothing."""
    there = mass > 0
    mass, low, high = mass[there], low[there], high[there]
    return np.array([mass[high < 1 - UNDECIDED].sum(), mass[low > 1 + UNDECIDED].sum(), mass @ low, mass @ high])
