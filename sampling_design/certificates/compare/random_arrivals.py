"""How likely a window contracts, and by what factor the squared error shrinks, where chance decides which samples come.

Each sample of a schedule is lost with the same probability, or samples come as a Poisson process
(`arrival_patterns`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.compare.arrival_patterns import contraction_bounds, planned_steps, poisson_steps
from sampling_design.certificates.compare.contraction import FINITE
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.window_problem import whitened_rows, window_problem
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Claim, PlainRecord, below, probability, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import period_of

MOST_SAMPLES = 128  # of a window: work grows with their square


@dataclass(frozen=True, eq=False, repr=False)
class RandomArrivals(PlainRecord):
    """What is left of a certificate's contraction if chance decides which samples arrive.

    Attributes
    ----------
    loss_probability : float
        p: of every sample, independently of all others.
    arrival_rate : float or None [1/time]
        Of the Poisson process that the samples are, before losses; None where they are those of the schedule.
    length : float [time]
        M; a whole number of periods where samples are those of the schedule.
    samples : float
        Samples that are planned in a window, or expected.
    ends : (N,) array [time]
        Where the windows (t - M, t] end: at the samples of a period; one stands for all where arrivals are Poisson's.
    probability : (N, 2) array
        Lower and upper bound of the probability that the window contracts, rho < 1.
    factor : (N, 2) array
        Lower and upper bound of E[rho]; the upper one is infinite where it could not be bounded.
    time_unit : str
    """

    loss_probability: float
    arrival_rate: float | None
    length: float
    samples: float
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
            f"a window contracts with a probability of at least {self._least}, and the expected squared "
            f"error by a factor of at most {probability(self.mean_factor[1], up=True)}",
            "expected contraction under random arrivals",
            (
                "arrivals are independent, of each other and of the noise",
                "the estimator minimises the certificate's cost over (t - M, t]",
                "linear plant, in doubles",
            ),
        )

    @property
    def _least(self) -> str:
        return probability(self.contracts[0])

    @property
    def _most(self) -> str:
        return probability(self.contracts[1], up=True)

    @property
    def process(self) -> str:
        """How samples arrive, in words."""
        p, unit = self.loss_probability, self.time_unit
        if self.arrival_rate is None:
            return f"each sample is lost with probability {probability(p)}"
        lost = f", each of which is lost with probability {probability(p)}" if p else ""
        return f"samples come as a Poisson process, {short(self.arrival_rate)} per {unit}{lost}"

    _answers = (
        "windows of {length} {time_unit} where {process}",
        "{claim.evidence}",
        "a window contracts with probability {_least} to {_most}",
        "draw arrivals and count the windows that contract",
    )
    _table = {
        "samples in a window": "{samples}",
        "squared error": "times {mean_factor[0]:down} to {mean_factor[1]:up} a window, on average",
    }
    _plain = "loss_probability arrival_rate length samples ends probability contracts factor mean_factor rate claim"

    def explain(self) -> str:
        """Say how likely the promise holds, and whether the error stays bounded on average."""
        unit, (lower, upper) = self.time_unit, self.contracts
        likely, most = probability(lower, 4), probability(upper, 4, up=True)
        likely = likely if upper - lower <= 1e-4 * upper else f"{likely} to {most}"
        words = f"If {self.process}, a window of {short(self.length)} {unit} still contracts with probability {likely}."
        if self.rate is not None:
            factor = probability(self.mean_factor[1], up=True)
            return (
                f"{words} On average the squared error shrinks at least by the factor {factor} a window, "
                f"at the rate {below(self.rate)} per {unit}."
            )
        if self.mean_factor[0] >= 1:
            return f"{words} On average the bound on the squared error does not shrink."
        return f"{words} Whether the squared error shrinks on average is not decided."


@checked
def random_arrivals(
    certificate: Certificate,
    loss_probability: float = 0.0,
    *,
    arrival_rate: float | None = None,
    horizon: float | None = None,
) -> RandomArrivals:
    """Bound how likely a certificate's contraction holds, and its mean, where chance decides which samples arrive.

        P(rho_S < 1),   E[rho_S],   rho_S = e^{-eta M} lambda_max(P2 Y_S(t)),   S the samples received in (t - M, t]

    Y_S is the inverse of the information that the window keeps of P2: in its norm |e(t)|^2 <= rho_S (|e(t - M)|^2 + N),
    N = e^{eta M} times the noise of the window in the certificate's cost, that of the samples which are expected.

    Parameters
    ----------
    certificate : Certificate
        On a periodic schedule; with `arrival_rate` on any, of which only the weights and the horizon are used.
    loss_probability : float
        p in [0, 1]: of every sample, all outputs together.
    arrival_rate : float, optional [1/time]
        Samples, of all outputs, come as a Poisson process of this rate. Default: at the times of the schedule.
    horizon : float, optional [time]
        M, a whole number of periods without `arrival_rate`. Default: the least that is not below
        `certificate.horizon().length`.

    Returns
    -------
    RandomArrivals

    Raises
    ------
    ArgumentError
        If the schedule is finite, `loss_probability` no probability, `horizon` not a whole number of periods, or a
        window holds more than `MOST_SAMPLES` samples, or more than 1024 time constants of the plant.

    Notes
    -----
    *Claim.* For windows that end at the samples of a period (of Poisson's arrivals, for all), whatever the noise:
    E|e(k M)|^2 <= r^k |e(0)|^2 + r N/(1 - r) with r = E[rho], since windows that follow each other share no sample. At
    p = 0 this is the certificate's own contraction. *Method.* Patterns are followed in classes, of each of which an
    upper bound of E[Y] and one of E[1/Y] are known; both are carried over a step by Jensen's inequality, since either
    is concave in what it was. What a class says of rho is of second order in how much its patterns differ. Up to
    eight samples of a schedule each class is a pattern, and the bounds coincide but for rounding, which either bound
    is moved outwards by: plants that grow by e^18 over a gap or two drown in it what is then seen. *Limits.* A rate of
    0 leaves the plant alone; as rates grow, all windows contract.

    References
    ----------
    Proof: docs/theory/horizon.md. Filters that lose samples: Sinopoli et al., IEEE TAC 49(9), 2004; whose samples are
    a Poisson process: Micheli and Jordan, MTNS 2002.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant, certify
    >>> swing = certify(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([0.5, 1.5]), eta=0.3)
    >>> found = random_arrivals(swing, 0.1)
    >>> found.contracts[0] > 0.99, random_arrivals(swing, 0.0).contracts
    (True, (1.0, 1.0))
    >>> random_arrivals(swing, arrival_rate=3.0).contracts[0] > 0.9
    True
    """
    p = checks.nonnegative("loss_probability", loss_probability)
    if p > 1:
        raise ArgumentError(f"`loss_probability` must lie between 0 and 1, got {p!r}.")
    c = certificate
    asked = c.horizon().length if horizon is None else checks.positive("horizon", horizon)
    problem = window_problem(c.plant, c.schedule, c.P2, c.Qw, c.R, c.Qv, c.eta)
    with np.errstate(over="ignore", invalid="ignore"):  # growth that no double holds bounds nothing
        if arrival_rate is None:
            schedule = period_of(c.schedule, FINITE)
            whole = _periods(asked, schedule.period, len(schedule), horizon is None)
            M, samples, ends = whole * schedule.period, float(whole * len(schedule)), np.array(schedule.times)
            bounds = [contraction_bounds(problem, planned_steps(problem, k, whole, p), M) for k in range(len(ends))]
        else:
            rate = checks.nonnegative("arrival_rate", arrival_rate)
            M, samples, ends = asked, rate * asked, np.array([asked])
            rows = np.linalg.solve(problem.root, whitened_rows(c.plant.C, c.R, c.Qv, None, 1)[0].T).T
            bounds = [contraction_bounds(problem, poisson_steps(problem, rows, rate * (1 - p), asked), M)]
    probability, factor = (np.array([each[k] for each in bounds]) for k in range(2))
    return RandomArrivals(
        loss_probability=p, arrival_rate=arrival_rate, length=M, samples=samples, ends=ends, probability=probability,
        factor=factor, time_unit=c.plant.time_unit,
    )  # fmt: skip


def _periods(asked: float, period: float, count: int, default: bool) -> int:
    """How many periods a window spans: the next whole number by default, else exactly what was asked."""
    periods = asked / period
    if (most := periods * (1 - 1e-9) * count) > MOST_SAMPLES:
        raise ArgumentError(
            f"`horizon` = {short(asked)} spans {short(np.ceil(most))} samples: at most {MOST_SAMPLES} are followed."
        )
    if default:
        return max(1, int(np.ceil(periods * (1 - 1e-9))))
    whole = round(periods)
    if whole < 1 or abs(periods - whole) > 1e-9 * whole:
        raise ArgumentError(
            f"`horizon` = {short(asked)} must be a whole number of periods ({short(period)}): windows that "
            "follow each other are alike then."
        )
    return whole
