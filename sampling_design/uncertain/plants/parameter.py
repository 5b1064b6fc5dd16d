"""A number that is only known to lie in a range."""

from __future__ import annotations

from dataclasses import field

import numpy.typing as npt

from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import PlainRecord, short

_MOVED = ("A", "C", "G")


@frozen
class UncertainParameter(PlainRecord):
    """A number that is only known to lie in a range, and how it enters a plant.

    Parameters
    ----------
    name : str
    low, high : float
        low <= high.
    A : (n, n) array, C : (p, n) array, G : (n, q) array, optional
        What a change of the parameter by 1 adds to the matrices of the plant; None: nothing.
    nominal : float, optional
        The value that the plant's own matrices stand for; default the middle of the range.

    Raises
    ------
    ArgumentError
        If the range is empty, the nominal value lies outside, or the parameter moves nothing.
    """

    name: str
    low: float
    high: float
    A: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    C: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    G: Converted[npt.ArrayLike | None, Array | None] = None  # type: ignore[assignment]
    nominal: Converted[float | None, float] = field(default=None, kw_only=True)  # type: ignore[arg-type]

    _plain = "name low nominal high A? C? G?"

    def __post_init__(self) -> None:
        if not is_text(self.name) or not self.name:
            raise ArgumentError(f"`name` of a parameter must be a text, got {checks.described(self.name)}.")
        low, high = checks.number("low", self.low), checks.number("high", self.high)
        if low > high:
            raise ArgumentError(f"`high` of {self.name} must be at least `low` = {low!r}, got {high!r}. Swapped?")
        middle = low / 2 + high / 2 if self.nominal is None else checks.number("nominal", self.nominal)
        if not low <= middle <= high:
            raise ArgumentError(f"`nominal` of {self.name} must lie in [{low!r}, {high!r}], got {middle!r}.")
        given = {key: value for key in _MOVED if (value := getattr(self, key)) is not None}
        moved = {key: checks.matrix(key, value) for key, value in given.items()}
        if not any(M.any() for M in moved.values()):
            raise ArgumentError(f"parameter {self.name!r} must move an entry of A, C or G.")
        self._hold(low=low, high=high, nominal=middle, **moved)

    def _rows(self) -> list[tuple[str, str]]:
        moved = ", ".join(key for key in _MOVED if getattr(self, key) is not None)
        return [
            ("name", self.name),
            ("range", short([self.low, self.high])),
            ("nominal", short(self.nominal)),
            ("moves", moved),
        ]

    def explain(self) -> str:
        """Say what is known of the number."""
        return f"{self.name} lies between {short(self.low)} and {short(self.high)}."
