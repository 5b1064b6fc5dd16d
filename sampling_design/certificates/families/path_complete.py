"""Graphs of gap words: every schedule of a family, from every window start, is a path in one.

Node 0 is the window's start. Along an edge u -> v some time h in [low, high] passes and a sample with the outputs of
the edge is taken (none of them: the sample is lost). With one information matrix P_v per node, P_0 = P2, the
family certificate is this list of inequalities, F_h = e^{(A + eta/2) h}, Phi_h(P) = (F_h P^-1 F_h' + W_h)^-1:

1. edges u -> v, all h in [low, high]:   Phi_h(P_u) + C_e' R~_e C_e >= P_v,    R~_e = (V restricted to e)^-1,
   V = R^-1 + Qv^-1
2. nodes u, all s in [0, top_u]:         Phi_s(P_u) >= (1 + margin) P1  and  Phi_s(P_u) >= (1 - 1e-3) P2/lam,
   top_u the largest `high` of the edges that leave u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Plain
from sampling_design.errors import ArgumentError

Array = npt.NDArray[np.float64]
Word = tuple[Any, ...]


@dataclass(frozen=True)
class Edge:
    """From node `source` to node `target` in a time within [low, high]; `outputs` are measured at its end."""

    source: int
    target: int
    low: float
    high: float
    outputs: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class GapGraph:
    """Nodes named by what they remember of the schedule since the window's start, and edges between them.

    `words[0]` is the start itself. What the other words mean depends on the family: lower ends of the last gaps
    ("gap-range", "spaced-windows"; newest first), the phase and the losses ("lost-samples"; newest first), the phase
    and the ends of the deviation ("jitter").
    """

    words: tuple[Word, ...]
    edges: tuple[Edge, ...]

    @property
    def count(self) -> int:
        """Nodes, the start included."""
        return len(self.words)

    @property
    def tops(self) -> Array:
        """Longest time that may pass at each node before the next edge ends."""
        tops = np.zeros(self.count)
        for edge in self.edges:
            tops[edge.source] = max(tops[edge.source], edge.high)
        return tops

    def to_dict(self, P: Array) -> dict[str, Plain]:
        """Plain data, with the information matrix of each node but the start (that one is P2)."""
        return {
            "words": [list(word) for word in self.words],
            "edges": [[e.source, e.target, e.low, e.high, [int(on) for on in e.outputs]] for e in self.edges],
            "P": [matrix.tolist() for matrix in P[1:]],
        }


def unrolled(graph: GapGraph, layers: int) -> GapGraph:
    """Return the graph that also remembers how many samples ago the window started, up to `layers`.

    Without this one matrix per word has to lie below the whole transient that starts at P2.
    """
    inner = graph.count - 1
    words = (graph.words[0], *(graph.words[1:] * layers))
    edges = [edge for edge in graph.edges if edge.source == 0]
    for layer in range(layers):
        here, there = layer * inner, min(layer + 1, layers - 1) * inner
        edges += [
            Edge(edge.source + here, edge.target + there, edge.low, edge.high, edge.outputs)
            for edge in graph.edges
            if edge.source
        ]
    return GapGraph(words, tuple(edges))


def graph_from_dict(data: Any, P2: Array) -> tuple[GapGraph, Array]:
    """Return the graph and its matrices (P2 first) in plain data.

    Raises
    ------
    ArgumentError
        If a key is missing or unknown, an edge leads nowhere, or a matrix is not positive definite.
    """
    if not isinstance(data, dict):
        raise ArgumentError(f"`graph` must be a table with words, edges and P, got {type(data).__name__}.")
    _checks.known_keys("`graph`", data, ("words", "edges", "P"))
    missing = [key for key in ("words", "edges", "P") if key not in data]
    if missing:
        raise ArgumentError(f"`{missing[0]}` is missing in `graph`. Was the file cut off?")
    words = tuple(tuple(word) for word in data["words"])
    if len(data["P"]) != len(words) - 1:
        raise ArgumentError(f"`graph.P` must hold {len(words) - 1} matrices, one per word, got {len(data['P'])}.")
    P = np.stack([P2, *(_checks.definite("graph.P", matrix, len(P2)) for matrix in data["P"])])
    return GapGraph(words, tuple(_edge(item, len(words)) for item in data["edges"])), P


def _edge(item: Any, count: int) -> Edge:
    try:
        source, target, low, high, outputs = item
        edge = Edge(int(source), int(target), float(low), float(high), tuple(bool(on) for on in outputs))
    except (TypeError, ValueError):
        raise ArgumentError(
            f"`graph.edges` must be lists [source, target, low, high, outputs], got {item!r}."
        ) from None
    if not (0 <= edge.source < count and 0 < edge.target < count and 0 <= edge.low <= edge.high < np.inf):
        raise ArgumentError(f"`graph.edges` must join words in a time 0 <= low <= high, got {item!r}.")
    return edge
