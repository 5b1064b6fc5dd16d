"""Graphs of schedules: what a path-complete graph is, and that of each family.

Graphs of gap words: every schedule of a family, from every window start, is a path in one.

Node 0 is the window's start. Along an edge u -> v some time h in [low, high] passes and a sample with the outputs of
the edge is taken (none of them: the sample is lost). With one information matrix P_v per node, P_0 = P2, the
family certificate is this list of inequalities, F_h = e^{(A + eta/2) h}, Phi_h(P) = (F_h P^-1 F_h' + W_h)^-1:

1. edges u -> v, all h in [low, high]:   Phi_h(P_u) + C_e' R~_e C_e >= P_v,    R~_e = (V restricted to e)^-1,
   V = R^-1 + Qv^-1
2. nodes u, all s in [0, top_u]:         Phi_s(P_u) >= (1 + margin) P1  and  Phi_s(P_u) >= (1 - 1e-3) P2/lam,
   top_u the largest `high` of the edges that leave u.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.checkers.cover import COVERED
from sampling_design.checkers.family_file import FAMILIES, Edge, family_of
from sampling_design.checkers.parts import Plant as FilePlant
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.schedules.family import START, SamplingFamily, Steps, Word, period_of
from sampling_design.schedules.schedule import PeriodicSchedule


@dataclass(frozen=True, eq=False)
class PathCompleteGraph:
    """Nodes named by what they remember of the schedule since the window's start, and edges between them.

    `words[0]` is the start itself. What the other words mean depends on the family: lower ends of the last gaps
    ("gap-range", "spaced-windows"; newest first), the phase and the losses ("lost-samples"; newest first), the phase
    and the ends of the deviation ("jitter"), and the outputs that are yet to be read ("output-jitter").

    Notes
    -----
    The graph is path-complete: every schedule of the family is a path in it, so that one inequality per edge is enough.

    References
    ----------
    Ahmadi, Jungers, Parrilo and Roozbehani 2014.
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

    def to_dict(self, P: Array) -> dict[str, object]:
        """What a file holds: the information matrix of each node but the start (that one is P2), too."""
        return {
            "words": [list(word) for word in self.words],
            "edges": [[e.source, e.target, e.low, e.high, [int(on) for on in e.outputs]] for e in self.edges],
            "P": list(P[1:]),
        }


def unrolled(graph: PathCompleteGraph, layers: int) -> PathCompleteGraph:
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
    return PathCompleteGraph(words, tuple(edges))


MOST_NODES = 400  # a graph with more nodes than this is not built: its matrix inequalities would take minutes


def in_plant_terms(plant: Plant, family: SamplingFamily) -> SamplingFamily:
    """Return `family` with the schedule that it is built around in the plant's terms.

    Raises ArgumentError if it is no family, its unit of time differs, the schedule that it is built around is finite,
    its tolerances are those of other outputs, or no auditor reads its kind.
    """
    if not isinstance(family, SamplingFamily):
        raise ArgumentError(
            "`schedule` must be a Schedule, a PeriodicSchedule or a family (GapRange, SpacedWindows, LostSamples, "
            f"Jitter), got {type(family).__name__}."
        )
    if family.planned is not None:
        names = family.planned.output_names
        if family.by_output and (len(family.by_output) != plant.n_outputs or names not in (None, plant.outputs.names)):
            raise ArgumentError(
                f"`schedule` must have the plant's outputs {', '.join(plant.outputs.names)} in their order, as its "
                f"tolerances have, got {len(family.by_output) if names is None else ', '.join(names)}."
            )
        planned = align(plant, period_of(family.planned))  # its columns are the plant's outputs, and need no names
        family = family.replanned(
            PeriodicSchedule(planned.gaps, planned.first, planned.outputs, time_unit=planned.time_unit)
        )
    elif family.time_unit not in (None, plant.time_unit):
        raise ArgumentError(
            f"`family` is in {family.time_unit} and the plant in {plant.time_unit}. Give it in that unit."
        )
    judged = family.kind in FAMILIES
    with suppress(BadFile):  # parameters that its auditor refuses are refused where they are used
        judged = type(family_of(family.to_dict(), FilePlant(plant.A, plant.C, plant.G, plant.time_unit))) in COVERED
    if not judged:
        raise ArgumentError(
            f"`schedule` must be of a kind that an auditor reads, got {family.kind!r}: another kind needs its entry in "
            "`FAMILIES` (checkers/family_file.py) and one in `COVERED` (checkers/cover.py)."
        )
    return family


def family_in_words(plant: Plant, family: SamplingFamily) -> str:
    """Say which schedules belong, with the plant's names for outputs that have tolerances of their own."""
    if family.planned is None or not family.by_output:
        return family.explain()
    planned = period_of(family.planned)
    mask = np.ones((len(planned), plant.n_outputs), dtype=bool) if planned.outputs is None else planned.outputs
    return family.replanned(replace(planned, outputs=mask, output_names=plant.outputs.names)).explain()


def graph_of(family: SamplingFamily, memory: int, outputs: int) -> PathCompleteGraph:
    """Return the graph of a family with level `memory` of memory (0 is the least) for a plant with `outputs` outputs.

    Raises ArgumentError if the level does not exist or the graph has more than `MOST_NODES` nodes.
    """
    most = family.levels_of_memory
    if not 0 <= memory < most:
        raise ArgumentError(f"`memory` must be a whole number from 0 to {most - 1} for this family, got {memory!r}.")
    return _reachable_words(family.steps(memory, outputs))


def _reachable_words(steps: Steps) -> PathCompleteGraph:
    """All words that can be reached from the start."""
    words: dict[Word, int] = {START: 0}
    edges: list[Edge] = []
    queue = [START]
    for word in queue:
        for step in steps(word):
            if step.word not in words:
                words[step.word] = len(words)
                queue.append(step.word)
                if len(words) > MOST_NODES:
                    raise ArgumentError(
                        f"`memory`: the graph of this family has more than {MOST_NODES} nodes. They are fewer with "
                        "less memory, fewer samples a period, and fewer outputs at times of their own."
                    )
            edges.append(Edge(words[word], words[step.word], step.low, step.high, step.outputs))
    return PathCompleteGraph(((), *list(words)[1:]), tuple(edges))
