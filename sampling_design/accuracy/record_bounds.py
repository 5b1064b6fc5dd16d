"""The least bounds that a record does not disprove, along a shape: a candidate for next time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.bounds import Bound
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.readings import Arrived, Readings, time_or_span
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.accuracy.record_readings import read_record
from sampling_design.accuracy.witness import KEPT
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.checks import freeze
from sampling_design.records.record import PlainRecord, short
from sampling_design.records.signatures import checked

GROWS = {"both": "all", "w": "w", "v": "v"}  # what may grow, and what the program calls it


@dataclass(frozen=True, eq=False, repr=False)
class RecordBounds(PlainRecord):
    """The least multiple of given bounds that a record does not disprove.

    What a record does not disprove need not hold next time: a candidate, no more than that.

    Attributes
    ----------
    readings : Readings
        The record with the bounds as they were given.
    grow : "both", "w" or "v"
        What was multiplied.
    factor : float
        Any smaller multiple is disproved by `gains`; 0 where the record is explained without any; infinity where no
        multiple explains it.
    enough : float
        A multiple under which the program finds a course of events that explains the record (w constant on cells).
    gains : (R,) array
        Proof of `factor`, one number for each row that was read.
    """

    readings: Readings
    grow: str
    factor: float
    enough: float
    gains: Array = field(repr=False)
    scales: Array = field(repr=False)

    _plain = "grow factor enough gains"

    @property
    def w_bound(self) -> Array:
        """The least bounds on w: half-widths, or the radius where they bound a norm together."""
        root = self.readings.push.root
        given = np.sqrt((root * root).sum(axis=1))
        return freeze(given * (self.factor if self.grow != "v" else 1.0))

    @property
    def v_bound(self) -> Array:
        """The least bounds on v, one for each row that was read."""
        return freeze(self.readings.size * (self.factor if self.grow != "w" else 1.0))

    def verify(self) -> bool:
        """Whether the gains disprove every smaller multiple, evaluated without a solver."""
        if self.factor == 0:
            return True
        table = GapTable(self.readings.A, self.readings.G, self.scales)
        return RecordProgram(self.readings, table).growth(GROWS[self.grow], self.gains) >= self.factor * (1 - KEPT)

    def _rows(self) -> list[tuple[str, str]]:
        what = {"both": "of all bounds", "w": "of that on w", "v": "of those on v"}[self.grow]
        return [
            (f"least multiple {what}", short(self.factor)),
            ("explains the record", short(self.enough)),
            ("it is", "a candidate for next time, no more than that"),
        ]

    def explain(self) -> str:
        """Say what the record disproves."""
        what = {"both": "the bounds", "w": "the bound on w", "v": "the bounds on v"}[self.grow]
        if np.isinf(self.factor):
            return f"No multiple of {what} explains the record."
        return (
            f"The record disproves {what} times less than {short(self.factor)} and does not disprove them times "
            f"{short(self.enough)}: a candidate for next time, no more than that."
        )


@checked
def bounds_from_record(
    plant: Plant,
    record: Iterable[Arrived],
    *,
    w_bound: Bound = None,
    v_bound: Bound = None,
    initial_error: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    prior_time: float | None = None,
    grow: str = "both",
) -> RecordBounds:
    """Return the least bounds along a given shape that a record does not disprove.

        min theta such that some start, w and v within theta times their bounds explain every measurement

    Parameters
    ----------
    plant : Plant
    record : Measurements or iterable of (t, y, u)
    w_bound, v_bound
        The shape, as for `state_interval`: their multiples are looked at.
    initial_error : float or (n,) array, optional
        Joins what grows where `grow` is "both". Default: nothing is known of the start.
    prior, prior_time
        As for `state_interval`.
    grow : "both", "w" or "v"
        What is multiplied; the other stays as it is given.

    Returns
    -------
    RecordBounds
        `factor` with gains that prove it: `verify()` needs no solver.

    Raises
    ------
    ArgumentError
        As `state_interval`, or if `grow` is unknown.

    Notes
    -----
    *Claim.* Every multiple below `factor` is disproved by the record. *Assumptions.* None: but that a record does not
    disprove a bound does not make it true, and bounds found so hold the less for the future the shorter the record is.

    References
    ----------
    Milanese, Norton, Piet-Lahanier and Walter (eds), Bounding Approaches to System Identification (1996).

    Examples
    --------
    >>> from sampling_design import Plant
    >>> record = [(0.0, [0.0], None), (1.0, [1.0], None), (2.0, [0.0], None)]
    >>> found = bounds_from_record(Plant([[0.0]], [[1.0]]), record, w_bound=0.0, v_bound=1.0)
    >>> round(found.factor, 6), found.verify()
    (0.5, True)
    """
    checks.word("grow", grow, GROWS)
    record = list(record)
    if any(time_or_span(item[0])[1] for item in record if isinstance(item, (tuple, list)) and item):
        raise ArgumentError("`record` must have exact times: what uncertain ones say rests on the bounds themselves.")
    readings = read_record(plant, record, w_bound, v_bound, initial_error, prior, prior_time)
    program = RecordProgram(readings)
    factor, enough, gains = program.least_multiple(GROWS[grow])
    return RecordBounds(readings, grow, factor, enough, freeze(gains), program.table.D)
