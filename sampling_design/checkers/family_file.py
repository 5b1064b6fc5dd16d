"""What a file says of a family of schedules, and what a file of claim "family" holds: every key, as frozen records.

What a family's graph claims is only given its shape here; `cover.py` derives it from the family's own parameters and
compares. Nothing is proven here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .parts import Plant, Weights, symmetric, time_unit, weights_of
from .schedule_file import WEIGHED, Times, of_kind, schedule, times_read
from .strict import (
    Array,
    Reader,
    Tree,
    anything,
    bit,
    count,
    list_of,
    matrix,
    nonnegative,
    number,
    or_nothing,
    positive,
    printed,
    refuse,
    table,
    text,
)


def family(value: object, place: str) -> Tree:
    """The table of a family of any kind."""
    return dict(of_kind("a family", {kind: reader for kind, (reader, _) in FAMILIES.items()})(value, place))


class Family:
    """A family of any kind; `cover.py` says for each what its graph must hold."""

    apart: bool = False
    """Whether the outputs of a sample are read at times of their own."""

    def has_word(self, word: tuple[float, ...]) -> bool:
        """Whether that is a word of the family: lower bounds of gaps may be any numbers."""
        return True


@dataclass(frozen=True)
class GapRange(Family):
    """Gaps between two bounds."""

    shortest: float
    longest: float


@dataclass(frozen=True)
class SpacedWindows(Family):
    """At least `count` samples in every window, `spacing` apart."""

    window: float
    count: int
    spacing: float


@dataclass(frozen=True)
class LostSamples(Family):
    """At most `most` of any `of` samples in a row are lost."""

    nominal: Times
    most: int
    of: int

    def has_word(self, word: tuple[float, ...]) -> bool:
        """The number of a sample of the period, and for each of the last samples 1 if it was lost, else 0."""
        return word[:1] in _samples(self.nominal) and all(lost in (0, 1) for lost in word[1:])


@dataclass(frozen=True)
class Jitter(Family):
    """Reading i of every sample at most early[i] before and late[i] after the nominal time.

    What is read at once is output i where outputs are read at times of their own (`apart`), else the whole sample, 0.
    """

    nominal: Times
    early: tuple[float, ...]
    late: tuple[float, ...]
    apart: bool = False

    def readings(self, j: int) -> dict[int, tuple[bool, ...]]:
        """The readings of sample j of the period, and which outputs each of them measures."""
        measured = self.nominal.measured[j]
        if not self.apart:
            return {0: tuple(measured.tolist())}
        return {i: tuple((np.arange(measured.size) == i).tolist()) for i in np.flatnonzero(measured).tolist()}

    def has_word(self, word: tuple[float, ...]) -> bool:
        """The number of a sample, the ends of the last deviation in order, and the readings yet to come, in order."""
        if len(word) < 3 or word[:1] not in _samples(self.nominal) or word[1] > word[2]:
            return False
        read, left = self.readings(int(word[0])), word[3:]
        return left == tuple(i for i in read if i in left) and len(left) < len(read)


@dataclass(frozen=True)
class Edge:
    """From node `source` to node `target` in a time within [low, high]; `outputs` are measured at its end."""

    source: int
    target: int
    low: float
    high: float
    outputs: tuple[bool, ...]


@dataclass(frozen=True)
class Graph:
    """Words (what a node remembers), edges, and a matrix for each word, P2 first."""

    words: tuple[tuple[float, ...], ...]
    edges: tuple[Edge, ...]
    P: tuple[Array, ...]

    def leaving(self, u: int) -> list[Edge]:
        """Edges that leave node u."""
        return [edge for edge in self.edges if edge.source == u]

    def top(self, u: int) -> float:
        """Longest time that may pass at node u."""
        return max((edge.high for edge in self.leaving(u)), default=0.0)


@dataclass(frozen=True)
class OfFamily:
    """A file of claim "family"."""

    plant: Plant
    weights: Weights
    family: Family
    graph: Graph


_graph = table({"words": list_of(list_of(number)), "edges": list_of(list_of(anything, 5)), "P": list_of(matrix())})
OF_FAMILY = table({**WEIGHED, "graph": _graph}, whole="the certificate")


def of_family(read: Tree, plant: Plant) -> OfFamily:
    """A file of claim "family"; its graph has its shape only."""
    weights = weights_of(read, plant)
    if read["witness"] is not None:
        raise refuse("witness", "must be null: a family certificate has no witness")
    if weights.lam_samples < weights.lam:
        what = "must be at least `lam`: a family holds windows from samples to any first gap"
        raise refuse("lam_samples", what)
    family = family_of(read["times"], plant)
    if family.apart and any(np.any(np.diag(np.diag(M)) != M) for M in (weights.R, weights.Qv)):
        raise refuse("R", "must be diagonal, and `Qv`, where outputs are read one at a time")
    return OfFamily(plant, weights, family, graph_of(read["graph"], plant, weights, family))


def family_of(value: object, plant: Plant) -> Family:
    """The family, in the plant's unit, its parameters judged."""
    read = family(value, "times")
    kind, nominal = read["kind"], read.get("schedule")
    for place, unit in (("times", read.get("time_unit")), ("times.schedule", (nominal or {}).get("time_unit"))):
        if unit is not None and unit != plant.time_unit:
            raise refuse(f"{place}.time_unit", f"must be the plant's, {plant.time_unit!r}, got {unit!r}")
    return FAMILIES[kind][1](read, plant)


def nominal_of(read: Tree, plant: Plant) -> Times:
    """The nominal schedule of a family: periodic, with gaps, and columns that are the plant's outputs."""
    place = "times.schedule"
    if read["kind"] != "periodic" or "gaps" not in read:
        raise refuse(place, "must be periodic and have `gaps`")
    if read.get("output_names") is not None:
        raise refuse(f"{place}.output_names", "must be left out: the columns are the plant's outputs, without names")
    found = times_read(read, plant, place)
    room = 1e-9 * found.period
    if ("times" in read) != ("period" in read):
        raise refuse(place, "must have `times` and `period` together, or neither")
    times, period = read.get("times"), read.get("period", found.period)
    wrong = times is not None and (len(times) != len(found.times) or np.abs(found.times - times).max() > room)
    if wrong or abs(period - found.period) > room:
        raise refuse(place, "must have times and period that do not contradict its gaps")
    return found


def gap_range(read: Tree, plant: Plant) -> GapRange:
    """Gaps between two bounds."""
    if read["shortest"] > read["longest"]:
        raise refuse("times.longest", "must be at least `times.shortest`")
    return GapRange(read["shortest"], read["longest"])


def spaced_windows(read: Tree, plant: Plant) -> SpacedWindows:
    """Windows that an endless schedule can fill."""
    T, k, spacing = read["window"], read["count"], read["spacing"]
    if k < 1 or k * spacing > T * (1 + 1e-9):
        raise refuse("times", "must have room for an endless schedule: count >= 1, count * spacing <= window")
    return SpacedWindows(T, k, spacing)


def lost_samples(read: Tree, plant: Plant) -> LostSamples:
    """Fewer losses than samples."""
    if not read["most"] < read["of"]:
        raise refuse("times.most", "must be less than `times.of`")
    return LostSamples(nominal_of(read["schedule"], plant), read["most"], read["of"])


def jitter(read: Tree, plant: Plant) -> Jitter:
    """Deviations, of whole samples or of each output, that keep the order of nominal samples."""
    path, p = nominal_of(read["schedule"], plant), len(plant.C)
    if read["kind"] == "jitter":
        most = read["timing_tolerance"]
        if 2 * most >= path.gaps.min():
            raise refuse("times.timing_tolerance", "must be less than half of the least gap")
        return Jitter(path, (most,), (most,))
    early, late = read["early"], read["late"]
    for key, side in (("early", early), ("late", late)):
        if len(side) != p:
            raise refuse(f"times.{key}", f"must have {p} entries, one for each output, got {len(side)}")
    if max(early) + max(late) >= path.gaps.min():
        raise refuse("times.late", "must, with `times.early`, be less than the least gap, the largest of each")
    return Jitter(path, tuple(early), tuple(late), apart=True)


_unit: dict[str, Reader] = {"time_unit": or_nothing(time_unit)}
_count = table({"kind": text, "window": positive, "count": count, "spacing": positive}, _unit)
_sides = dict.fromkeys(("early", "late"), list_of(nonnegative))
FAMILIES: dict[str, tuple[Reader, Callable[[Tree, Plant], Family]]] = {
    "gap-range": (table({"kind": text, "shortest": positive, "longest": positive}, _unit), gap_range),
    "spaced-windows": (_count, spaced_windows),
    "lost-samples": (table({"kind": text, "schedule": schedule, "most": count, "of": count}), lost_samples),
    "jitter": (table({"kind": text, "schedule": schedule, "timing_tolerance": nonnegative}), jitter),
    "output-jitter": (table({"kind": text, "schedule": schedule, **_sides}), jitter),
}
"""How a certificate file says each kind of family: its table, and the record of its judged parameters.

Another kind is another line here, and one in `cover.COVERED`.
"""


def _samples(nominal: Times) -> list[tuple[float, ...]]:
    """The numbers of the samples of a period, as words begin with them."""
    return [(float(k),) for k in range(nominal.gaps.size)]


def fitting(words: tuple[tuple[float, ...], ...], family: Family) -> None:
    """Refuse a word, other than the start's, that says nothing of this family."""
    for k, word in enumerate(words[1:], 1):
        if not family.has_word(word):
            raise refuse(f"graph.words[{k}]", f"must be a word of the family, got {printed(list(word))}")


def graph_of(read: Tree, plant: Plant, weights: Weights, family: Family) -> Graph:
    """Words, edges and matrices of sizes that fit each other."""
    words = tuple(tuple(entries) for entries in read["words"])
    if len(words) != len(read["P"]) + 1 or words[0] != ():
        raise refuse("graph", "must have an empty word for the window's start, and one matrix per word after it")
    fitting(words, family)
    P = [symmetric(M, f"graph.P[{k}]", plant.n) for k, M in enumerate(read["P"])]
    edges = [edge_of(item, f"graph.edges[{k}]", len(words), len(plant.C)) for k, item in enumerate(read["edges"])]
    return Graph(words, tuple(edges), (weights.P2, *P))


def edge_of(value: list[object], place: str, nodes: int, p: int) -> Edge:
    """One edge [source, target, low, high, outputs]."""
    readers: tuple[Reader, ...] = (count, count, nonnegative, nonnegative, list_of(bit, p))
    source, target, low, high, outputs = (
        read(item, f"{place}[{k}]") for k, (read, item) in enumerate(zip(readers, value, strict=True))
    )
    if not (source < nodes and 0 < target < nodes and low <= high):
        raise refuse(place, f"must join two of {nodes} nodes, not back to the start, in a time low <= high")
    return Edge(source, target, low, high, tuple(outputs))
