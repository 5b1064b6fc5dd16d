"""What a user says of how a window over a nonlinear plant becomes a program of finitely many unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sampling_design import _checks
from sampling_design._record import Record, short


@dataclass(frozen=True, eq=False, repr=False)
class Collocation(Record):
    """Radau collocation of a window: pieces on which w is constant and the state a polynomial.

    Parameters
    ----------
    w_step : float, optional
        w is constant on pieces at most this long [time]; between two samples all pieces are equal. Default M/60.
    degree : int
        Radau points per piece: the state is a polynomial of this degree, exact to order 2 degree - 1.
    capacity : int, optional
        Pieces that the program is built for; default M/w_step + 1. A window that needs more builds it anew.

    Raises
    ------
    ArgumentError
        If a value is not positive.

    Examples
    --------
    >>> Collocation(w_step=0.5, degree=3).explain()
    'A polynomial of degree 3 on each piece of at most 0.5.'
    """

    w_step: float | None = None
    degree: int = 2
    capacity: int | None = None

    _slip: ClassVar[str] = "Use Collocation(w_step=, degree=, capacity=)."

    def __post_init__(self) -> None:
        if self.w_step is not None:
            object.__setattr__(self, "w_step", _checks.positive("w_step", self.w_step))
        if self.capacity is not None:
            object.__setattr__(self, "capacity", _checks.whole("capacity", self.capacity, 1))
        object.__setattr__(self, "degree", _checks.whole("degree", self.degree, 1))

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("degree", str(self.degree)), ("pieces", "M/60" if self.w_step is None else short(self.w_step))]
        return rows + ([] if self.capacity is None else [("capacity", str(self.capacity))])

    def explain(self) -> str:
        """Say what a piece is."""
        longest = "1/60 of the window" if self.w_step is None else short(self.w_step)
        return f"A polynomial of degree {self.degree} on each piece of at most {longest}."
