"""Why data contradict the bounds: gains for the row 0, by which its bound would have to be negative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from sampling_design.accuracy.gains import AGAIN
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.readings import Readings
from sampling_design.accuracy.record_program import DISPROVED, WHICH_BOUNDS, RecordProgram
from sampling_design.errors import UndecidedError
from sampling_design.records.arrays import Array, Index, freeze
from sampling_design.records.record import PlainRecord, below, moment

LARGEST = 1e100  # number of a plant in coordinates: its third powers are doubles
MOSTLY = 0.9  # share of a contradiction that the samples named with it make


@dataclass(frozen=True, eq=False, repr=False)
class Disproof(PlainRecord):
    """Why the data contradict the bounds: gains for the row 0, whose bound would have to be negative.

        0 <= sum lambda'(y - ybar) + theta b(lambda)

    Attributes
    ----------
    readings : Readings
    factors : dict of str to float
        The least factor by which all bounds together ("all"), that on w alone ("w") or those on v alone ("v") would
        have to grow; infinity where no factor suffices. Each is proven by its gains.
    gains : dict of str to (R,) arrays
        One number for each row that was read.
    scales : (n,) array
        Sizes of the states in which the proof's integrals are evaluated; any will do.
    """

    readings: Readings
    factors: dict[str, float]
    gains: dict[str, Array]
    scales: Array = field(repr=False)

    _plain = "times factors gains"

    @property
    def times(self) -> Array:
        """Times of the samples that make nine tenths of it, the strongest first."""
        return freeze(self.readings.times[self.strongest])

    @property
    def samples(self) -> Index:
        """The same samples, counted from 0 among all times at which something was read."""
        sampled = np.cumsum(np.diff(self.readings.offsets) > 0) - 1
        return np.asarray(sampled[self.strongest])

    @property
    def strongest(self) -> Index:
        """Places of those times among all of the readings."""
        shares = np.zeros(len(self.readings.times))
        np.add.at(shares, self.readings.nodes, np.abs(self.gains["all"]) * self.readings.size)
        if not shares.any():
            np.add.at(shares, self.readings.nodes, np.abs(self.gains["all"] * self.readings.residuals))
        order = np.argsort(-shares, kind="stable")
        count = int(np.searchsorted(np.cumsum(shares[order]), MOSTLY * shares.sum())) + 1
        return np.asarray(order[:count])

    def verify(self) -> bool:
        """Whether the gains prove the factors, and that of all bounds above 1, evaluated without a solver."""
        program = program_of(self.readings, self.scales)
        proven = {which: program.growth(which, own, AGAIN) for which, own in self.gains.items()}
        kept = all(factor <= 0 or proven[which] >= factor for which, factor in self.factors.items())
        return kept and min(self.factors["all"], proven["all"]) > 1

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.readings.plant.time_unit
        return [
            ("samples at", f"{moment(self.times)} {unit}"),
            ("all bounds", _grown(self.factors["all"], " as large at least")),
            *((f"that on {k} alone", _grown(self.factors[k])) for k in ("w", "v")),
        ]

    def explain(self) -> str:
        """Say what contradicts what, and by how much."""
        when = ", ".join(moment(t) for t in self.times[:4])
        alone = ", ".join(f"that on {k} alone {_grown(self.factors[k])}" for k in ("w", "v"))
        together = "no factor of all bounds together suffices"
        if np.isfinite(self.factors["all"]):
            together = f"all bounds together would have to be {below(self.factors['all'], 3)} times as large; {alone}"
        return f"The data contradict the bounds, most of all the samples at {when}: {together}."


def program_of(readings: Readings, scales: Array) -> RecordProgram:
    """Return the program of a record in coordinates that a file states; UndecidedError where doubles cannot hold it."""
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.hstack([readings.A * scales, readings.G]) / scales[:, None]
    if not np.all(np.abs(scaled) < LARGEST):
        raise UndecidedError("undecided: in coordinates of these `scales` the plant is beyond the range of doubles")
    return RecordProgram(readings, GapTable(readings.A, readings.G, scales))


def _grown(factor: float, what: str = "") -> str:
    return f"{below(factor, 3)} times{what}" if np.isfinite(factor) else "never suffices"


def disprove(program: RecordProgram, others: Sequence[Array] = ()) -> Disproof | None:
    """Return the proof that the readings of a program contradict the bounds, by `others` too; None where there is none.

    Gains of a row and of the same with its sign changed add up to some of the row 0. What is sought for some bounds
    may prove more of others than what is sought for these: where all bounds must grow, one alone must by as much.
    """
    known = [program.leaving_nothing(np.zeros(len(program.table.D)), own) for own in others]
    known.append(program.least_growth("all"))
    if not max(program.growth("all", found) for found in known) > 1 + DISPROVED:
        return None
    known += [program.least_growth(which) for which in ("w", "v")]
    gains = {which: max(known, key=partial(program.growth, which)) for which in WHICH_BOUNDS}
    factors = {which: program.growth(which, found) for which, found in gains.items()}
    kept = {which: freeze(found) for which, found in gains.items()}
    return Disproof(program.readings, factors, kept, program.table.D)
