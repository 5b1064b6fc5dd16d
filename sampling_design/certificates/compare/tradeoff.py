"""Horizon against noise gain: the infimum of the horizon is not attained, so the choice is a curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.certification import chosen
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.given_weights import certifiable_schedule, weights_of
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import TableRecord, above, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import AnySchedule

NOISE_GAINS = (1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0)
"""Default of the curve: dense where horizons change, to a thousand, where they have stopped to."""


@dataclass(frozen=True, eq=False, repr=False)
class TradeoffCurve(TableRecord):
    """One certificate per noise gain.

    Attributes
    ----------
    noise_gains : (k,) array
    horizons : (k,) array [time]
        M must exceed these, by the improved theorem.
    C_w, C_v : (k,) arrays
        Noise gains of each.
    lam : (k,) array
    certificates : tuple of Certificate
    """

    noise_gains: Array
    horizons: Array
    C_w: Array
    C_v: Array
    lam: Array
    certificates: tuple[Certificate, ...]

    _frame = "noise_gains horizons C_w C_v lam"
    _answers = (
        "horizons and gains of one certificate for each noise gain",
        "proven: each by its certificate",
        "{_good}",
        "`.verify()` of each of `.certificates`",
    )

    def _good(self) -> str:
        return f"the shortest horizon is {above(self.horizons.min())} {self.certificates[0].plant.time_unit}"

    def _rows(self) -> list[tuple[str, str]]:
        columns = zip(self.noise_gains, self.horizons, self.C_w, self.C_v, strict=True)
        unit = self.certificates[0].plant.time_unit
        return [
            (f"noise gain {short(b, 4)}", f"M > {above(M)} {unit}, C_w = {above(w, 3)}, C_v = {above(v, 3)}")
            for b, M, w, v in columns
        ]

    def explain(self) -> str:
        """Say what the curve trades."""
        unit = self.certificates[0].plant.time_unit
        if len(self.noise_gains) == 1:
            given = f"With a noise gain of {short(self.noise_gains[0])} times its least value"
            return f"{given} the horizon is {above(self.horizons[0])} {unit} and C_w = {above(self.C_w[0], 3)}."
        return (
            f"If the noise gain may be {short(self.noise_gains[-1])} instead of {short(self.noise_gains[0])} times its "
            f"least value, the horizon falls from {above(self.horizons[0])} to {above(self.horizons[-1])} {unit}, "
            f"and C_w rises from {above(self.C_w[0], 3)} to {above(self.C_w[-1], 3)}."
        )


@checked
def tradeoff_curve(
    plant: Plant,
    schedule: AnySchedule,
    eta: float,
    noise_gains: npt.ArrayLike = NOISE_GAINS,
    *,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TradeoffCurve:
    """Return the least horizon against the noise gain, at one rate.

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
    eta : float [1/time]
    noise_gains : (k,) array
        Increasing, above 1: how many times its least the noise gain may be.
    Qw, R, Qv : arrays, optional
        As for `certify`.
    progress : callable, optional

    Returns
    -------
    TradeoffCurve

    Raises
    ------
    ArgumentError
        If the gains do not increase.

    Notes
    -----
    *Method.* The search of `certify` once for all of them: shapes of P2 found at reference gains, each scaled to the
    gain. *Claim.* Every point is a proven certificate, and no horizon is longer than that of a smaller gain; that
    no smaller horizon exists at that gain is not claimed.

    Examples
    --------
    >>> from sampling_design.schedules.schedule import PeriodicSchedule
    >>> curve = tradeoff_curve(Plant([[0.0]], [[1.0]]), PeriodicSchedule([1.0]), eta=0.4, noise_gains=[2.0, 8.0])
    >>> bool(curve.horizons[1] < curve.horizons[0])
    True
    """
    steps = checks.vector("noise_gains", noise_gains)
    if not steps.size or np.any(np.diff(steps) <= 0):
        raise ArgumentError("`noise_gains` must increase strictly and hold at least one value.")
    if np.any(steps <= 1):
        raise ArgumentError(
            f"`noise_gains` must be above 1, got {float(steps[0])!r}: no P2 attains the least noise gain."
        )
    schedule = certifiable_schedule(plant, schedule)
    weights, rate = weights_of(plant, Qw, R, Qv), checks.positive("eta", eta)
    certificates = chosen(plant, schedule, weights, rate, steps.tolist(), progress)
    horizons = [made.horizon() for made in certificates]
    return TradeoffCurve(
        steps, freeze([h.minimum for h in horizons]), freeze([h.C_w for h in horizons]),
        freeze([h.C_v for h in horizons]), freeze([made.lam for made in certificates]),
        tuple(certificates),
    )  # fmt: skip
