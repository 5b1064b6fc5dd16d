"""What an estimator does with samples that fit nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import Record, short


@dataclass(frozen=True, eq=False, repr=False)
class OutlierRejection(Record):
    """How samples that fit nothing else are kept from spoiling an estimate.

        huber:  sum_i 2 c^2 (sqrt(1 + e_i^2/c^2) - 1) in place of sum_i e_i^2,    e = U (y - h), U'U a sample's weight
        gate:   an output is left out where |y - h(xhat)| exceeds `gate` times its predicted standard deviation

    Both read the weights as inverse covariances, so that e_i = 1 is one standard deviation of the noise.

    Parameters
    ----------
    huber : float, optional
        c: from about here on a residual counts linearly, as large ones of pseudo-Huber's loss do. 1 to 3 is usual.
    gate : float, optional
        Standard deviations; 4 to 6 is usual.
    patience : int
        So many samples in a row may be left out whole; the next one counts, since then the estimate is what is off.

    Raises
    ------
    ArgumentError
        If a value is not positive.

    References
    ----------
    Huber 1964, robust estimation of a location parameter.

    Examples
    --------
    >>> OutlierRejection(huber=2.0, gate=5.0).explain()
    'Residuals beyond 2 standard deviations count linearly; an output beyond 5 is left out, at most 3 samples in a row.'
    """

    huber: float | None = None
    gate: float | None = None
    patience: int = 3

    _slip: ClassVar[str] = "Use OutlierRejection(huber=, gate=, patience=)."

    _table = {"huber": "{huber:or -}", "gate": "{gate:or -}", "patience": "{patience}"}

    def __post_init__(self) -> None:
        self._check(huber=checks.positive, gate=checks.positive)
        self._hold(patience=checks.whole("patience", self.patience, 1))

    def explain(self) -> str:
        """Say what happens to a large residual."""
        words = []
        if self.huber is not None:
            words.append(f"residuals beyond {short(self.huber)} standard deviations count linearly")
        if self.gate is not None:
            words.append(f"an output beyond {short(self.gate)} is left out, at most {self.patience} samples in a row")
        text = "; ".join(words) or "every residual counts by its square"
        return f"{text[0].upper()}{text[1:]}."


def beyond(residual: Array, spread: Array, gate: float) -> Mask:
    """Which entries of a residual (p,) exceed `gate` standard deviations, by the diagonal of its covariance."""
    size = np.sqrt(np.diag(spread))
    return np.asarray(np.isfinite(size) & (np.abs(residual) > gate * size))
