"""What a file says of a schedule, and what a file of claim "assumption-7" holds: every key, as frozen records.

Sizes come from the plant: n states, p outputs. Nothing is proven here.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .parts import AROUND, MATRICES, NUMBERS, SOLVER, Plant, Weights, time_unit, weights_of
from .strict import (
    Array,
    Mask,
    Reader,
    Tree,
    anything,
    bit,
    is_table,
    is_text,
    label,
    list_of,
    nonnegative,
    number,
    or_nothing,
    positive,
    refuse,
    table,
    text,
    word,
)

NEAR = 1e-9  # what ends this near to the last sample, relative, ends there
MOST_PERIODS = 100_000  # that a witness is looked for in

_details: dict[str, Reader] = {
    "outputs": or_nothing(list_of(list_of(bit))),
    "time_unit": or_nothing(time_unit),
    "origin": or_nothing(text),
    "output_names": or_nothing(list_of(label)),
}
FINITE = table({"kind": word("finite"), "times": list_of(nonnegative)}, _details)
PERIODIC = table(
    {"kind": word("periodic")},
    {
        "gaps": list_of(positive),
        "first": or_nothing(nonnegative),
        "times": list_of(nonnegative),
        "period": positive,
        **_details,
    },
)


def of_kind(what: str, kinds: Mapping[str, Reader]) -> Reader:
    """Reader of a table that names its own kind."""

    def read(value: object, place: str) -> object:
        if not is_table(value):
            raise refuse(place or what, f"must be a table of keys and values, got a {type(value).__name__}")
        kind = value.get("kind")
        if not is_text(kind) or kind not in kinds:
            which = f"{place}.kind" if place else "kind"
            known = ", ".join(kinds)
            raise refuse(which, f"of {what} must be one of {known}, got {kind!r}")
        return kinds[kind](value, place)

    return read


schedule = of_kind("a schedule", {"finite": FINITE, "periodic": PERIODIC})


@dataclass(frozen=True)
class Times:
    """When and what a schedule measures: gaps before each sample, the first time, measured outputs (samples, p)."""

    periodic: bool
    gaps: Array
    first: float
    measured: Mask
    stated: Array  # the numbers of the file: gaps of a periodic schedule, times of a finite one

    @property
    def period(self) -> float:
        """Sum of the gaps."""
        return float(self.gaps.sum())

    @property
    def times(self) -> Array:
        """Of the first period."""
        return self.first + np.concatenate([[0.0], np.cumsum(self.gaps[1:])]) if self.periodic else self.stated

    @property
    def reach(self) -> Array:
        """How long before each sample a window may start with that sample next."""
        return np.maximum(self.gaps, np.where(np.arange(self.gaps.size) == 0, self.first, 0.0))

    @property
    def windows(self) -> str:
        """The windows of which something is proven."""
        last = "" if self.periodic else f" up to {self.times[-1]:.9g}, the last sample"
        return f"every real window start and every later t{last}"

    @property
    def primitive(self) -> "Times":
        """The same samples with the shortest period in which gaps and outputs repeat, to the last bit; else itself."""
        N = self.gaps.size
        for k in range(1, N if self.periodic else 1):
            gaps, measured = self.gaps[:k], self.measured[:k]
            same = N % k == 0 and np.array_equal(np.tile(gaps, N // k), self.gaps)
            if same and self.first <= gaps.sum() and np.array_equal(np.tile(measured, (N // k, 1)), self.measured):
                return Times(True, gaps, self.first, measured, gaps)
        return self


@dataclass(frozen=True)
class Witness:
    """Where lambda is attained."""

    t: float
    start: float
    direction: Array
    ratio: float


@dataclass(frozen=True)
class Sampled:
    """A file of claim "assumption-7": one schedule."""

    plant: Plant
    weights: Weights
    schedule: Times
    witness: Witness | None


_witness = table({"t": nonnegative, "start": nonnegative, "direction": list_of(number), "ratio": positive})
WEIGHED: dict[str, Reader] = {
    **AROUND,
    **MATRICES,
    **NUMBERS,
    "times": anything,
    "witness": or_nothing(_witness),
    "solver": SOLVER,
}
"""What files of weights on times hold; `times` is read again once the plant is known."""
SAMPLED = table(WEIGHED, whole="the certificate")


def of_schedule(read: Tree, plant: Plant) -> Sampled:
    """A file of claim "assumption-7"."""
    times = times_of(read["times"], plant)
    return Sampled(plant, weights_of(read, plant), times.primitive, witness_of(read["witness"], plant.n, times))


def witness_of(read: Tree | None, n: int, times: Times) -> Witness | None:
    """The witness, its direction of the plant's size, its window within the schedule."""
    if read is None:
        return None
    last = MOST_PERIODS * times.period if times.periodic else times.times[-1] * (1 + NEAR)
    if not read["start"] <= read["t"] <= last:
        raise refuse("witness", "must have 0 <= start <= t within the schedule")
    if len(read["direction"]) != n or not any(read["direction"]):
        raise refuse("witness.direction", f"must have {n} entries, not all zero")
    return Witness(**{**read, "direction": np.array(read["direction"])})


def times_of(value: object, plant: Plant) -> Times:
    """One schedule of a certificate: in the plant's unit, one column per output."""
    mask = or_nothing(list_of(list_of(bit, len(plant.C))))
    shapes = {
        "periodic": table({"kind": text, "gaps": list_of(positive), "first": nonnegative, "outputs": mask}),
        "finite": table({"kind": text, "times": list_of(nonnegative), "outputs": mask}),
    }
    return times_read(of_kind("a schedule", shapes)(value, "times"), plant, "times")


def times_read(read: Tree, plant: Plant, place: str) -> Times:
    """The schedule in a table that was read, its times judged."""
    periodic = read["kind"] == "periodic"
    stated = np.array(read["gaps" if periodic else "times"], dtype=np.float64)
    if not stated.size:
        raise refuse(place, "must hold at least one sample")
    gaps = stated if periodic else np.diff(stated, prepend=0.0)
    first = float(gaps[0]) if read.get("first") is None else read["first"]
    if not (np.all(gaps[not periodic :] > 0) and first <= gaps.sum() < np.inf):
        raise refuse(place, "must increase strictly, the first sample within the period")
    p, rows = len(plant.C), read.get("outputs")
    measured = np.ones((gaps.size, p), bool) if rows is None else np.array([row for row in rows if len(row) == p], bool)
    if measured.shape != (gaps.size, len(plant.C)) or not measured.any(axis=1).all():
        rows = f"{gaps.size} rows of {len(plant.C)} numbers"
        raise refuse(f"{place}.outputs", f"must have {rows} 0 or 1, each row with a 1")
    return Times(periodic, gaps, float(first), measured, stated)
