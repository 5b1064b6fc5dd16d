"""Where P(tau) has its nodes, and which samples are proven: the graph of the schedules, laid out in time.

Each word of the graph has a P(tau) of its own, linear between nodes from 0 to the longest gap that leaves the word. A
sample takes P(tau) of one word to P(0) of the next. Before its first sample a schedule is so far in a gap that it ends
as that sample comes: in a gap of the graph that is no shorter, else in one of the start's own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sampling_design.certificates.families.graphs import graph_of
from sampling_design.certificates.families.path_complete import Edge, PathCompleteGraph
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.jitter import Jitter
from sampling_design.schedules.schedule import PeriodicSchedule

Schedules = SamplingFamily | PeriodicSchedule

LEAST_PIECES = 2  # pieces of the P(tau) of a word whose gaps are much shorter than the longest
DECIMALS = 10  # of the nodes that are chosen here; the ends of gaps stay what they are


class WordLayout(NamedTuple):
    """The nodes of all words, one after the other; each jump leads from node `later` to node `base`, by outputs."""

    nodes: Array
    later: Index
    base: Index
    measured: Mask

    @property
    def pieces(self) -> Index:
        """The first node of each piece."""
        return np.flatnonzero(self.nodes[1:] != 0)


def family_of(schedules: Schedules) -> SamplingFamily:
    """The family; a periodic schedule is one of deviations 0."""
    return Jitter(schedules, 0.0) if isinstance(schedules, PeriodicSchedule) else schedules


def graph_for(schedules: Schedules, memory: int, outputs: int) -> PathCompleteGraph:
    """The graph of a family, or of a periodic schedule: all deviations 0 from it."""
    return graph_of(family_of(schedules), memory, outputs)


def longer(graph: PathCompleteGraph, first: Edge) -> bool:
    """Whether a first gap is the end of another one of the graph."""
    return any(
        edge.source and (edge.target, edge.outputs) == (first.target, first.outputs) and edge.high >= first.high
        for edge in graph.edges
    )


def layout_of(graph: PathCompleteGraph, pieces: int) -> WordLayout:
    """Nodes and jumps of a graph: so many pieces for the longest gap, fewer for shorter ones."""
    edges = [edge for edge in graph.edges if edge.source]
    own = [replace(edge, low=edge.high) for edge in graph.edges if not edge.source and not longer(graph, edge)]
    words = range(0 if own else 1, graph.count)
    edges = own + edges
    tops = {word: max((edge.high for edge in edges if edge.source == word), default=0.0) for word in words}
    longest, begins = max(tops.values()), dict[int, int]()
    nodes: list[Array] = []
    for word in words:
        ends = {end for edge in edges if edge.source == word for end in (edge.low, edge.high)}
        count = max(int(np.ceil(pieces * tops[word] / longest - 1e-9)), min(LEAST_PIECES, pieces))
        begins[word] = sum(part.size for part in nodes)
        nodes.append(grid(tops[word], sorted(ends), count))
    found: dict[tuple[int, int, tuple[bool, ...]], None] = {}
    for edge in edges:
        times = nodes[edge.source - words[0]]
        for at in np.flatnonzero((times >= edge.low) & (times <= edge.high)).tolist():
            found[begins[edge.source] + at, begins[edge.target], edge.outputs] = None
    later, base, measured = zip(*found, strict=True)
    return WordLayout(
        np.concatenate(nodes), np.array(later, np.intp), np.array(base, np.intp), np.array(measured, bool)
    )


def grid(top: float, ends: list[float], count: int) -> Array:
    """Equal pieces of [0, top], the nearest node moved to each end of a gap, or one put in where it is taken."""
    nodes = {float(f"{t:.{DECIMALS}g}"): False for t in np.linspace(0.0, top, count + 1)[1:-1].tolist()}
    for end in ends:
        if not 0 < end < top:
            continue
        free = [t for t, taken in nodes.items() if not taken]
        near = min((abs(t - end), t) for t in [*free, np.inf])
        if near[0] <= top / count / 2:
            del nodes[near[1]]
        nodes[end] = True
    return np.array([0.0, *sorted(nodes), top])
