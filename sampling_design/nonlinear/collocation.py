"""What a user says of a window over a nonlinear plant: how it becomes a program, and which samples count in it."""

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


def beyond(residual: Array, covariance: Array, gate: float) -> Mask:
    """Which entries of a residual (p,) exceed `gate` standard deviations, by the diagonal of its covariance."""
    size = np.sqrt(np.diag(covariance))
    return np.asarray(np.isfinite(size) & (np.abs(residual) > gate * size))


BETWEEN = ("held", "linear")  # what an input does between the times at which it is given


@dataclass(frozen=True, eq=False, repr=False)
class Collocation(Record):
    """Radau collocation of a window: pieces on which w is constant and the state a polynomial.

    Parameters
    ----------
    w_step : float, optional
        w is constant on pieces at most this long [time]; between two samples all pieces are equal. Default M/60.
    degree : int
        Radau points per piece: the state is a polynomial of this degree, exact to order 2 degree - 1. The least one: it
        grows where `accuracy` asks for it.
    capacity : int, optional
        Pieces that the program is built for; default M/w_step + 1. A window that needs more builds it anew.

    accuracy : float or None
        After each solve every piece is integrated anew from where it begins. Where the differences move the estimate by
        more than this share of its own standard deviation (weights read as inverse covariances), the degree grows, then
        the pieces are halved; if that is not enough, the estimate's note says so. None: the grid stays as it is.
    inputs : "held" or "linear"
        What an input does between the times at which it is given: keep its value, or run straight to the next one.
        After the last it is held, and an estimate there says that it assumes so.

    Raises
    ------
    ArgumentError
        If a value is not positive, or a word is unknown.

    Examples
    --------
    >>> Collocation(w_step=0.5, degree=3).explain()
    'A polynomial of degree 3 on each piece of at most 0.5.'
    """

    w_step: float | None = None
    degree: int = 2
    capacity: int | None = None
    accuracy: float | None = 0.01
    inputs: str = "held"

    _slip: ClassVar[str] = "Use Collocation(w_step=, degree=, capacity=, accuracy=, inputs=)."

    _table = {"degree": "{degree}", "pieces": "{w_step:or M/60}", "capacity": "{capacity}"}

    def __post_init__(self) -> None:
        self._check(w_step=checks.positive, capacity=checks.at_least_one, accuracy=checks.positive)
        self._hold(degree=checks.whole("degree", self.degree, 1))
        checks.word("inputs", self.inputs, BETWEEN)

    def explain(self) -> str:
        """Say what a piece is."""
        longest = "1/60 of the window" if self.w_step is None else short(self.w_step)
        return f"A polynomial of degree {self.degree} on each piece of at most {longest}."


@dataclass(frozen=True, eq=False, repr=False)
class WindowSolver(Record):
    """How the program of a window over a nonlinear plant is solved.

    Parameters
    ----------
    tolerance : float
        Of the conditions of a minimum, in scaled variables.
    max_iterations : int
    starts : int
        Other starts, along the axes of what the arrival weight leaves unknown, where the solve fails or the cost is
        out of line with the noise (4 times what the weights, read as inverse covariances, explain); 0 for none. Where
        they find nothing better they pause for a growing number of windows.

    Raises
    ------
    ArgumentError
        If a value is out of range.

    Examples
    --------
    >>> WindowSolver(starts=0).explain()
    "Newton's method where the last window is near, else IPOPT: to 1e-08 in at most 200 iterations."
    """

    tolerance: float = 1e-8
    max_iterations: int = 200
    starts: int = 4

    _slip: ClassVar[str] = "Use WindowSolver(tolerance=, max_iterations=, starts=)."

    _table = {"tolerance": "{tolerance}", "max_iterations": "{max_iterations}", "starts": "{starts}"}

    def __post_init__(self) -> None:
        most, starts = checks.whole("max_iterations", self.max_iterations, 1), checks.whole("starts", self.starts)
        self._hold(tolerance=checks.positive("tolerance", self.tolerance), max_iterations=most, starts=starts)

    def explain(self) -> str:
        """Say how a window is solved."""
        more = f", from up to {self.starts} other starts where the cost is out of line with the noise"
        way = "Newton's method where the last window is near, else IPOPT"
        return (
            f"{way}: to {self.tolerance:.3g} in at most {self.max_iterations} iterations{more if self.starts else ''}."
        )
