"""The grammar of certificate files: every key, type, unit and size, as frozen records. Nothing is proven here.

Sizes come from the plant: n states, p outputs, q disturbances. What a family's graph claims is only given its shape
here; `cover.py` derives it from the family's own parameters and compares.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .inclusion_file import INCLUSION, inclusion
from .interval_file import INTERVAL, of_interval
from .parts import (
    AROUND,
    FORMAT,
    MATRICES,
    NUMBERS,
    RATES,
    SOLVER,
    Plant,
    Weights,
    digest,
    plant_of,
    sized,
    time_unit,
    weights_of,
)
from .strict import (
    Altered,
    Array,
    BadFile,
    Mask,
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
    plain,
    positive,
    refuse,
    table,
    text,
    word,
)

METHODS = ("riccati", "lmi", "proof", "given")


# --- plants, schedules, families: also the grammar of their own files ------------------------------------------------

_details: dict[str, Reader] = {
    "outputs": or_nothing(list_of(list_of(bit))),
    "time_unit": or_nothing(time_unit),
    "origin": or_nothing(text),
    "output_names": or_nothing(list_of(text)),
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


def schedule(value: object, place: str) -> Tree:
    """The table of a schedule of either kind."""
    kinds = {"finite": FINITE, "periodic": PERIODIC}
    return dict(_of_kind(value, place, kinds, "a schedule"))


def family(value: object, place: str) -> Tree:
    """The table of a family of any kind."""
    return _of_kind(value, place, {kind: one.read for kind, one in FAMILIES.items()}, "a family")


def _of_kind(value: object, place: str, kinds: Mapping[str, Reader], what: str) -> Tree:
    if not isinstance(value, Mapping):
        raise refuse(place or what, f"must be a table of keys and values, got a {type(value).__name__}")
    kind = value.get("kind")
    if not isinstance(kind, str) or kind not in kinds:
        which = f"{place}.kind" if place else "kind"
        known = ", ".join(kinds)
        raise refuse(which, f"of {what} must be one of {known}, got {kind!r}")
    return dict(kinds[kind](value, place))


# --- certificates ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Times:
    """When and what a schedule measures: gaps before each sample, the first time, measured outputs (samples, p)."""

    periodic: bool
    gaps: Array
    first: float
    seen: Mask
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


@dataclass(frozen=True)
class Witness:
    """Where lambda is attained."""

    t: float
    start: float
    direction: Array
    ratio: float


class Family:
    """A family of any kind; `cover.py` says for each what its graph must hold."""


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


@dataclass(frozen=True)
class Jitter(Family):
    """Every sample at most `radius` early or late."""

    nominal: Times
    radius: float


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
class Sampled:
    """A file of claim "assumption-7": one schedule."""

    plant: Plant
    weights: Weights
    schedule: Times
    witness: Witness | None


@dataclass(frozen=True)
class OfFamily:
    """A file of claim "family"."""

    plant: Plant
    weights: Weights
    family: Family
    graph: Graph


@dataclass(frozen=True)
class Detectability:
    """A file of claim "detectability": A'P + PA + (1 + margin) eta P - c_y C'C etc., no schedule."""

    plant: Plant
    P: Array
    eta: float
    c_w: float
    c_y: float
    margin: float


_witness = table({"t": nonnegative, "start": nonnegative, "direction": list_of(number), "ratio": positive})
_graph = table({"words": list_of(list_of(number)), "edges": list_of(list_of(anything, 5)), "P": list_of(matrix())})
_sampled = {**AROUND, **MATRICES, **NUMBERS, "times": anything, "witness": or_nothing(_witness), "solver": SOLVER}
_detectability = table(
    {
        **AROUND,
        **RATES,
        **{"P": matrix(), "c_w": positive, "c_y": positive, "method": word(*METHODS)},
        "solver": or_nothing(SOLVER),
    },
    whole="the certificate",
)


def certificate(data: Mapping[str, object]) -> object:
    """Return the certificate in the plain data of a file, as the record of its claim, or raise BadFile."""
    data = plain(data)
    if data.get("format") != FORMAT:
        raise refuse("format", f"must be {FORMAT!r}, got {data.get('format')!r:.60}. Is this a certificate file?")
    claim = data.get("claim")
    if not isinstance(claim, str) or claim not in CLAIMS:
        known = ", ".join(map(repr, CLAIMS))
        raise BadFile(f"`claim` must be {known} here, got {claim!r:.60}")
    read = CLAIMS[claim].table(data, "")
    if data["digest"] != digest(data):
        raise Altered("the digest does not fit the content: something was altered after it was written")
    return CLAIMS[claim].record(read, data, plant_of(read["plant"]))


def witness_of(read: Tree | None, n: int) -> Witness | None:
    """The witness, its direction of the plant's size."""
    if read is None:
        return None
    if len(read["direction"]) != n or not any(read["direction"]):
        raise refuse("witness.direction", f"must have {n} entries, not all zero")
    return Witness(**{**read, "direction": np.array(read["direction"])})


def times_of(value: object, plant: Plant, place: str = "times") -> Times:
    """One schedule of a certificate: in the plant's unit, one column per output."""
    mask = or_nothing(list_of(list_of(bit, len(plant.C))))
    shapes = {
        "periodic": table({"kind": text, "gaps": list_of(positive), "first": nonnegative, "outputs": mask}),
        "finite": table({"kind": text, "times": list_of(nonnegative), "outputs": mask}),
    }
    return times_read(_of_kind(value, place, shapes, "a schedule"), plant, place)


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
    seen = np.ones((gaps.size, p), bool) if rows is None else np.array([row for row in rows if len(row) == p], bool)
    if seen.shape != (gaps.size, len(plant.C)) or not seen.any(axis=1).all():
        rows = f"{gaps.size} rows of {len(plant.C)} numbers"
        raise refuse(f"{place}.outputs", f"must have {rows} 0 or 1, each row with a 1")
    return Times(periodic, gaps, float(first), seen, stated)


# --- families --------------------------------------------------------------------------------------------------------


def of_family(read: Tree, plant: Plant, weights: Weights) -> OfFamily:
    """A file of claim "family"; its graph has its shape only."""
    if read["witness"] is not None:
        raise refuse("witness", "must be null: a family certificate has no witness")
    if weights.lam_samples < weights.lam:
        what = "must be at least `lam`: a family holds windows from samples to any first gap"
        raise refuse("lam_samples", what)
    return OfFamily(plant, weights, family_of(read["times"], plant), graph_of(read["graph"], plant, weights))


def family_of(value: object, plant: Plant) -> Family:
    """The family, in the plant's unit, its parameters judged."""
    read = family(value, "times")
    kind, nominal = read["kind"], read.get("schedule")
    for place, unit in (("times", read.get("time_unit")), ("times.schedule", (nominal or {}).get("time_unit"))):
        if unit is not None and unit != plant.time_unit:
            raise refuse(f"{place}.time_unit", f"must be the plant's, {plant.time_unit!r}, got {unit!r}")
    return FAMILIES[kind].build(read, plant)


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
    """Deviations that change no order."""
    path = nominal_of(read["schedule"], plant)
    if 2 * read["radius"] >= path.gaps.min():
        raise refuse("times.radius", "must be less than half of the least gap")
    return Jitter(path, read["radius"])


@dataclass(frozen=True)
class Kind:
    """How families of one kind are read: their table, and the record of its judged parameters."""

    read: Reader
    build: Callable[[Tree, Plant], Family]


_unit: dict[str, Reader] = {"time_unit": or_nothing(time_unit)}
FAMILIES: dict[str, Kind] = {
    "gap-range": Kind(table({"kind": text, "shortest": positive, "longest": positive}, _unit), gap_range),
    "spaced-windows": Kind(
        table({"kind": text, "window": positive, "count": count, "spacing": positive}, _unit), spaced_windows
    ),
    "lost-samples": Kind(table({"kind": text, "schedule": schedule, "most": count, "of": count}), lost_samples),
    "jitter": Kind(table({"kind": text, "schedule": schedule, "radius": nonnegative}), jitter),
}
"""What a certificate file may say of its family; another kind is another line here, and one in `cover.COVERED`."""


def graph_of(read: Tree, plant: Plant, weights: Weights) -> Graph:
    """Words, edges and matrices of sizes that fit each other."""
    words = tuple(tuple(entries) for entries in read["words"])
    if len(words) != len(read["P"]) + 1 or words[0] != ():
        raise refuse("graph", "must have an empty word for the window's start, and one matrix per word after it")
    P = [sized(M, f"graph.P[{k}]", plant.n) for k, M in enumerate(read["P"])]
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


@dataclass(frozen=True)
class Claim:
    """What a file of a claim holds, no more and no less, and its judged content: `record(read, data, plant)`."""

    table: Reader
    record: Callable[..., object]


_RATES = ("eta", "c_w", "c_y", "margin")
CLAIMS: dict[str, Claim] = {
    "assumption-7": Claim(
        table(_sampled, whole="the certificate"),
        lambda read, data, plant: Sampled(
            plant, weights_of(read, plant), times_of(read["times"], plant), witness_of(read["witness"], plant.n)
        ),
    ),
    "family": Claim(
        table({**_sampled, "graph": _graph}, whole="the certificate"),
        lambda read, data, plant: of_family(read, plant, weights_of(read, plant)),
    ),
    "detectability": Claim(
        _detectability,
        lambda read, data, plant: Detectability(
            plant, sized(read["P"], "P", plant.n), **{key: read[key] for key in _RATES}
        ),
    ),
    "inclusion": Claim(INCLUSION, lambda read, data, plant: inclusion(data, plant)),
    "interval": Claim(INTERVAL, lambda read, data, plant: of_interval(data, plant)),
}
"""Every claim; `proofs.py` says for each how it is proven."""
