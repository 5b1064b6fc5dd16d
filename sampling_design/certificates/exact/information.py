"""The information that a window keeps, relative to what its certificate promises, as a curve over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.riccati_peak import located
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.errors import ArgumentError
from sampling_design.numerics.filtering import measurement_update, propagate
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import TableRecord, moment, short
from sampling_design.records.signatures import checked


@dataclass(frozen=True, eq=False, repr=False)
class InformationCurve(TableRecord):
    """Least eigenvalue of the information Pi(t) relative to P1, along one window.

    Attributes
    ----------
    t : (N,) array [time]
        On the schedule's clock, from `start` on; a sample's time stands twice, before and after the sample.
    least : (N,) array
        lambda_min(Pi(t), P1); the certificate promises at least 1.
    start : float
        Start of the window, on the same clock.
    samples : (k,) array [time]
        The times of the samples in it, likewise.
    time_unit : str
    """

    t: Array
    least: Array
    start: float
    samples: Array
    time_unit: str

    _frame = "time:t least"
    _answers = (
        "how much of the information that a certificate promises one window has",
        "sampled: at {t.size} times",
        "{_good}",
        "`.verify()` of the certificate proves at least 1",
    )

    def _good(self) -> str:
        return f"at least {short(self.least.min())} times what is promised"

    def _rows(self) -> list[tuple[str, str]]:
        at = int(np.argmin(self.least))
        return [
            ("window from", f"{moment(self.start)} {self.time_unit}"),
            ("least", f"{short(self.least[at])} at {moment(self.t[at])} {self.time_unit}"),
            ("until", f"{moment(self.t[-1])} {self.time_unit}"),
        ]

    def explain(self) -> str:
        """Say how near the window comes to the promise."""
        return (
            f"From {moment(self.start)} to {moment(self.t[-1])} {self.time_unit} the window keeps at least "
            f"{short(self.least.min())} times the information that the certificate promises."
        )


@checked
def information_curve(
    certificate: Certificate, start: float | None = None, samples: int | None = None, points: int = 24
) -> InformationCurve:
    """Return lambda_min(Pi(t), P1) along the window that starts at `start`.

        Pi = P2 at the start,   Pi' = -A'Pi - Pi A - eta Pi - Pi G Qw^-1 G' Pi between samples,
        Pi+ = Pi + C' R~ C at a sample

    Parameters
    ----------
    certificate : Certificate
    start : float, optional [time]
        Default the start of the certificate's worst window, or 0.
    samples : int, optional
        How many samples to follow; default two periods of a periodic schedule, or the whole finite one.
    points : int
        Points in each gap.

    Returns
    -------
    InformationCurve

    Raises
    ------
    ArgumentError
        If `start` is negative or beyond the last sample, or a count is not positive.

    Notes
    -----
    *Claim.* None: the values are exact at the points, and only sampled in between. `verify()` proves the inequality.

    References
    ----------
    The paper, Assumption 7.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant, certify
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> curve = information_curve(certify(plant, PeriodicSchedule([1.0]), eta=0.3))
    >>> bool(1.0 <= curve.least.min() < 1.01)
    True
    """
    worst = 0.0 if certificate.witness is None else certificate.witness.start
    begin = worst if start is None else checks.nonnegative("start", start)
    fractions = np.linspace(0.0, 1.0, checks.whole("points", points, 2))
    made = certificate
    problem = window_problem(made.plant, made.schedule, made.P2, made.Qw, made.R, made.Qv, made.eta)
    if problem.period is None and begin >= problem.times[-1]:
        raise ArgumentError(f"`start` must lie before the last sample at {float(problem.times[-1])!r}, got {begin!r}.")
    peak = located(problem, begin, begin)
    left = 2 * problem.count if problem.period is not None else problem.count - peak.index
    count = left if samples is None else checks.whole("samples", samples, 1)
    if problem.period is None:
        count = min(count, left)
    half = np.linalg.solve(problem.root, made.P1)
    factor = np.linalg.cholesky(symmetrise(np.linalg.solve(problem.root, half.T)))
    Y, now, at = np.eye(problem.size), begin, peak.index
    times, least, hits = [], [], []
    for step in range(count):
        duration = peak.remaining if step == 0 else float(problem.gaps[at])
        path = propagate(Y, *problem.flow(duration * fractions))
        times.append(now + duration * fractions)
        least.append(1.0 / np.linalg.eigvalsh(factor.T @ path @ factor)[:, -1])
        now += duration
        hits.append(now)
        Y = measurement_update(path[-1], problem.rows[at])
        at = (at + 1) % problem.count
    return InformationCurve(np.concatenate(times), np.concatenate(least), begin, np.array(hits), made.plant.time_unit)
