"""What a file of claim "inclusion" holds: a plant that is not exactly known, and P(tau) at finitely many times.

Three models of which Jacobians A, disturbance inputs G and outputs C may occur: parameters in a box (all enter
linearly), a list of vertices, or a nonlinear plant as a list of instructions with the region in which it stays.

The schedules are those of a family, or one that is periodic: a family of one. Each word of its graph has a P(tau) of
its own. What comes before the first sample is the end of a longer gap of the graph, or the start has a P(tau) too.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from . import programs
from .family_file import Edge, Family, GapRange, Graph, Jitter, edge_of, family_of, fitting
from .half_spaces import holds_a_point
from .parts import AROUND, MATRICES, NUMBERS, SOLVER, Plant, Weights, shaped, symmetric, weights_of
from .programs import Program
from .schedule_file import times_of
from .strict import (
    Array,
    Index,
    Mask,
    Reader,
    Tree,
    anything,
    flag,
    is_table,
    is_text,
    label,
    list_of,
    matrix,
    nonnegative,
    number,
    or_nothing,
    refuse,
    table,
    text,
)

MOST_NODES = 2000
_graph = table({"words": list_of(list_of(number)), "edges": list_of(list_of(anything, 5))})
_optional = {"A": matrix(), "C": matrix(), "G": matrix()}
PARAMETER = table({"name": label, "low": number, "nominal": number, "high": number}, _optional)
_side = list_of(or_nothing(number))
_box = table({"low": _side, "high": _side})
MODELS: dict[str, Reader] = {
    "box": table({"kind": text, "varying": flag, "parameters": list_of(anything)}),
    "vertices": table({"kind": text, "varying": flag, **dict.fromkeys("ACG", list_of(matrix()))}),
    "nonlinear": table(
        {
            "kind": text,
            "f": anything,
            "h": anything,
            "x": _box,
            "u": _box,
            "w": _box,
            "rows": matrix(),
            "offsets": list_of(number),
        }
    ),
}
INCLUSION = table(
    {
        **AROUND,
        **MATRICES,
        **NUMBERS,
        "times": anything,
        "witness": or_nothing(anything),
        "model": anything,
        "nodes": list_of(nonnegative),
        "P": list_of(matrix()),
        "multipliers": or_nothing(list_of(list_of(list_of(nonnegative)))),
        "solver": SOLVER,
    },
    {"graph": _graph},
    whole="the certificate",
)


@dataclass(frozen=True)
class Parameter:
    """A number in [low, high]; what a deviation from `nominal` of 1 adds to A, C and G."""

    name: str
    low: float
    nominal: float
    high: float
    A: Array
    C: Array
    G: Array


@dataclass(frozen=True)
class Box:
    """A + sum (theta_k - nominal_k) A_k with every theta in its range, likewise C and G."""

    parameters: tuple[Parameter, ...]
    kind: ClassVar[Literal["box"]] = "box"


@dataclass(frozen=True)
class Vertices:
    """All convex combinations of (A_k, C_k, G_k)."""

    A: Array
    C: Array
    G: Array
    kind: ClassVar[Literal["vertices"]] = "vertices"


@dataclass(frozen=True)
class Region:
    """x' = f(x, u, w), y = h(x, u) + v, with x in the region: a box and rows'x <= offsets; infinite: no bound."""

    f: Program
    h: Program
    low: dict[str, Array]
    high: dict[str, Array]
    rows: Array
    offsets: Array
    kind: ClassVar[Literal["nonlinear"]] = "nonlinear"


@dataclass(frozen=True)
class Inclusion:
    """A file of claim "inclusion": P(tau) of each word, one after the other, linear between `nodes`.

    Samples that are proven: at node `later` the next word begins, at its node `base`, with what is `measured`.
    """

    plant: Plant
    weights: Weights
    model: Box | Vertices | Region
    family: Family
    graph: Graph
    nodes: Array
    P: Array
    later: Index
    base: Index
    measured: Mask
    multipliers: Array | None

    @property
    def pieces(self) -> Index:
        """The first node of each piece: a node at time 0 begins the next word."""
        return np.flatnonzero(self.nodes[1:] != 0)

    @property
    def longest(self) -> float:
        """The longest time without a sample."""
        return float(self.nodes.max())


def inclusion(read: Tree, plant: Plant) -> Inclusion:
    """The judged content of a file's table."""
    weights = weights_of(read, plant)
    if plant.part:
        raise refuse("plant.part_of", "must be left out: no map carries every plant of a model")
    if read["witness"] is not None:
        raise refuse("witness", "must be null: a certificate for an inclusion has no witness")
    if weights.lam_samples < weights.lam:
        raise refuse("lam_samples", "must be at least `lam` for an inclusion")
    family = schedules_of(read["times"], plant)
    nodes = np.array(read["nodes"], dtype=np.float64)
    starts = np.flatnonzero(nodes == 0)
    if not 2 <= nodes.size <= MOST_NODES or nodes[0] != 0 or not np.all(np.diff(nodes)[nodes[1:] != 0] > 0):
        raise refuse("nodes", f"must be 2 to {MOST_NODES} times that increase from 0, for each word of the graph")
    stated = read.get("graph", {})
    graph = graph_of(stated.get("words"), stated.get("edges", []), family, plant)
    if len(starts) not in (len(graph.words), len(graph.words) - 1):
        raise refuse("nodes", "must begin at 0 once for each word of the graph; for the start too, or not")
    if len(read["P"]) != nodes.size:
        raise refuse("P", f"must hold one matrix per node, {nodes.size}, got {len(read['P'])}")
    P = np.array([symmetric(M, f"P[{k}]", plant.n) for k, M in enumerate(read["P"])]).reshape(-1, plant.n, plant.n)
    model, jumps = model_of(read["model"], plant), jumps_of(graph, nodes, starts, len(plant.C))
    found = Inclusion(plant, weights, model, family, graph, nodes, P, *jumps, multipliers=None)
    return found if read["multipliers"] is None else with_multipliers(found, read["multipliers"])


def schedules_of(value: object, plant: Plant) -> Family:
    """The family; one periodic schedule is the family of deviations 0 from it."""
    if is_table(value) and value.get("kind") == "periodic":
        return Jitter(times_of(value, plant), (0.0,), (0.0,))
    family = family_of(value, plant)
    if family.apart:
        raise refuse("times.kind", "must be another one for an inclusion: its samples are read together")
    return family


def graph_of(stated: list[list[float]] | None, listed: list[list[object]], family: Family, plant: Plant) -> Graph:
    """Words and edges, of sizes that fit each other; a range of gaps needs but one word, and need not say so."""
    if stated is None:
        if not isinstance(family, GapRange):
            raise refuse("graph", "is missing: only a range of gaps goes without")
        measured = (True,) * len(plant.C)
        both = Edge(0, 1, 0.0, family.longest, measured), Edge(1, 1, family.shortest, family.longest, measured)
        return Graph(((), ()), both, ())
    words = tuple(tuple(entries) for entries in stated)
    if len(words) < 2 or words[0] != ():
        raise refuse("graph.words", "must begin with an empty word for the start, and hold another one")
    fitting(words, family)
    edges = [edge_of(item, f"graph.edges[{k}]", len(words), len(plant.C)) for k, item in enumerate(listed)]
    return Graph(words, tuple(edges), ())


def jumps_of(graph: Graph, nodes: Array, starts: Index, outputs: int) -> tuple[Index, Index, Mask]:
    """Later, base and measured of all samples to be proven.

    These are at every node within an edge, and at the end of a first gap that no longer one holds.

    Before its first sample a schedule is so far in a gap that it ends as that sample comes: only its end counts.
    """
    last, skip = np.append(starts[1:], nodes.size), len(graph.words) - len(starts)
    found: dict[tuple[int, int, tuple[bool, ...]], None] = {}
    for k, edge in enumerate(graph.edges):
        low = edge.low if edge.source else edge.high
        if not edge.source and any(
            other.source and (other.target, other.outputs) == (edge.target, edge.outputs) and other.high >= edge.high
            for other in graph.edges
        ):
            continue
        mode = edge.source - skip
        if mode < 0:
            raise refuse(f"graph.edges[{k}]", "is a first gap that no longer one holds: the start needs its own P")
        at = np.arange(starts[mode], last[mode])
        if low not in nodes[at] or edge.high not in nodes[at]:
            raise refuse(f"graph.edges[{k}]", "must have ends that are nodes of its source")
        for node in at[(nodes[at] >= low) & (nodes[at] <= edge.high)].tolist():
            found[node, int(starts[edge.target - skip]), edge.outputs] = None
    later, base, measured = zip(*found, strict=True) if found else ((), (), ())
    return np.array(later, int), np.array(base, int), np.array(measured, bool).reshape(len(later), outputs)


def with_multipliers(c: Inclusion, read: list[list[list[float]]]) -> Inclusion:
    """The same with a diagonal per end of each piece: one number for each column that a parameter moves."""
    if c.model.kind != "box":
        raise refuse("multipliers", "must be null unless the model is a box of parameters")
    shape = (c.pieces.size, 2, sum(len(moved(each)) for each in c.model.parameters))
    fits = len(read) == shape[0] and all(len(ends) == 2 and all(len(d) == shape[2] for d in ends) for ends in read)
    if not fits:
        raise refuse("multipliers", f"must have shape {shape}: pieces, their ends, columns that parameters move")
    return Inclusion(**{**vars(c), "multipliers": np.array(read, dtype=np.float64).reshape(shape)})


def moved(parameter: Parameter) -> list[int]:
    """Columns of (A, G) that a parameter moves."""
    return [int(k) for k in np.flatnonzero(np.any(np.hstack([parameter.A, parameter.G]) != 0, axis=0))]


def model_of(value: object, plant: Plant) -> Box | Vertices | Region:
    """The model, of sizes that fit the plant."""
    kind = value.get("kind") if is_table(value) else None
    if not is_text(kind) or kind not in MODELS:
        raise refuse("model.kind", f"must be one of {', '.join(MODELS)}, got {kind!r:.40}")
    if kind == "nonlinear":
        return region(value, plant)
    read = MODELS[kind](value, "model")
    if kind == "box":
        listed = enumerate(read["parameters"])
        found = tuple(parameter(item, f"model.parameters[{k}]", plant) for k, item in listed)
        if not found or len({each.name for each in found}) < len(found):
            raise refuse("model.parameters", "must hold at least one parameter, each with a name of its own")
        return Box(found)
    shapes = {"A": plant.A.shape, "C": plant.C.shape, "G": plant.G.shape}
    count = len(read["A"])
    if not count or any(len(read[key]) != count for key in shapes):
        raise refuse("model", "must list as many A as C and G, at least one")
    stacks = {
        key: [shaped(M, f"model.{key}[{k}]", *size) for k, M in enumerate(read[key])] for key, size in shapes.items()
    }
    return Vertices(**{key: np.array(stack) for key, stack in stacks.items()})


def parameter(value: object, place: str, plant: Plant) -> Parameter:
    """One parameter, its range in order."""
    read = PARAMETER(value, place)
    if not read["low"] <= read["nominal"] <= read["high"]:
        raise refuse(place, "must have low <= nominal <= high")
    shapes = {"A": plant.A.shape, "C": plant.C.shape, "G": plant.G.shape}
    parts = {
        key: shaped(read[key], f"{place}.{key}", *size) if key in read else np.zeros(size)
        for key, size in shapes.items()
    }
    if not read["name"] or not any(M.any() for M in parts.values()):
        raise refuse(place, "must have a name, and move an entry of A, C or G")
    return Parameter(read["name"], read["low"], read["nominal"], read["high"], **parts)


def region(value: object, plant: Plant) -> Region:
    """A nonlinear plant; as many states, disturbances and outputs as the linear plant beside it."""
    read = MODELS["nonlinear"](value, "model")
    n, q, p = plant.n, plant.G.shape[1], len(plant.C)
    sizes = {"x": n, "u": len(read["u"]["low"]), "w": q}
    low, high = {}, {}
    for key, size in sizes.items():
        sides = []
        for side, none in (("low", -np.inf), ("high", np.inf)):
            if len(read[key][side]) != size:
                raise refuse(f"model.{key}.{side}", f"must have {size} entries, got {len(read[key][side])}")
            sides.append(np.array([none if item is None else item for item in read[key][side]], dtype=np.float64))
        low[key], high[key] = sides
        if np.any(low[key] > high[key]):
            raise refuse(f"model.{key}", "must have low <= high")
    rows = read["rows"]
    if len(read["offsets"]) != len(rows) or (len(rows) and rows.shape[1] != n):
        raise refuse("model.rows", f"must have {n} columns, and one of `offsets` per row")
    offsets = np.array(read["offsets"], dtype=np.float64)
    some = holds_a_point(low["x"], high["x"], rows.reshape(len(rows), n), offsets)
    if some is None:
        raise refuse("model.rows", "has too many half-spaces to be judged")
    if not some:
        raise refuse("model", "has an empty region: no state is in its box and its half-spaces")
    f = programs.read(read["f"], "model.f", sizes)
    h = programs.read(read["h"], "model.h", {"x": n, "u": sizes["u"]})
    for place, program, size in (("f", f, n), ("h", h, p)):
        if len(program.outputs) != size:
            raise refuse(f"model.{place}.outputs", f"must have {size} entries, got {len(program.outputs)}")
    return Region(f, h, low, high, rows.reshape(len(rows), n), offsets)
