"""Which graph of gap words stands for which family, with how much memory; one builder per family."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from sampling_design.certificates.families.path_complete import Edge, GapGraph, Word
from sampling_design.errors import ArgumentError
from sampling_design.observability.meeting import meet
from sampling_design.plants.plant import Plant
from sampling_design.schedules.family import SamplingFamily
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.jitter import Jitter
from sampling_design.schedules.lost_samples import LostSamples
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.schedules.spaced_windows import SpacedWindows

MOST_NODES = 400
"""A graph with more nodes than this is not built: its matrix inequalities would take minutes."""
GAP_MEMORY = ((0, 1), (1, 2), (1, 4), (2, 4), (3, 4))
"""(gaps remembered, cells per gap) of each level of memory."""
DEVIATION_CELLS = (1, 2, 4, 8)
"""Cells of a sample's deviation, per level of memory."""
OUTWARD = 8 * float(np.finfo(float).eps)
"""Ends of an edge that are sums of times are moved outward by this fraction, so that rounding loses no schedule."""

Moves = Callable[[Word], list[tuple[Word, float, float, tuple[bool, ...]]]]


def levels_of_memory(family: SamplingFamily) -> int:
    """Return how many graphs of growing memory there are for a family."""
    if isinstance(family, SpacedWindows):
        return sum(1 for m, _ in GAP_MEMORY if m <= max(family.count - 1, 1))
    if isinstance(family, LostSamples):
        return family.of - family.most
    return len(DEVIATION_CELLS) if isinstance(family, Jitter) else len(GAP_MEMORY)


def in_plant_terms(plant: Plant, family: Any) -> Any:
    """Return `family` with its nominal schedule in the plant's terms.

    Raises
    ------
    ArgumentError
        If it is no known family, its unit of time differs, or its nominal schedule is finite.
    """
    if isinstance(family, (Jitter, LostSamples)):
        if not isinstance(family.schedule, PeriodicSchedule):
            raise ArgumentError("`schedule` of the family must be a PeriodicSchedule: a finite one has no long run.")
        nominal = meet(plant, family.schedule)  # its columns are the plant's outputs, and need no names
        nominal = PeriodicSchedule(nominal.gaps, nominal.first, nominal.outputs, time_unit=nominal.time_unit)
        if isinstance(family, Jitter):
            return Jitter(nominal, family.radius)
        return LostSamples(nominal, family.most, family.of)
    if not isinstance(family, (GapRange, SpacedWindows)):
        raise ArgumentError(
            "`schedule` must be a Schedule, a PeriodicSchedule or a family (GapRange, SpacedWindows, LostSamples, "
            f"Jitter), got {type(family).__name__}."
        )
    if family.time_unit not in (None, plant.time_unit):
        raise ArgumentError(
            f"`family` is in {family.time_unit} and the plant in {plant.time_unit}. Give it in that unit."
        )
    return family


def graph_of(family: Any, memory: int, outputs: int) -> GapGraph:
    """Return the graph of a family with level `memory` of memory (0 is the least) for a plant with `outputs` outputs.

    Raises
    ------
    ArgumentError
        If the level does not exist or the graph has more than `MOST_NODES` nodes.
    """
    most = levels_of_memory(family)
    if not 0 <= memory < most:
        raise ArgumentError(f"`memory` must be a whole number from 0 to {most - 1} for this family, got {memory!r}.")
    if isinstance(family, LostSamples):
        return _walk(_losses(family, family.most + 1 + memory, outputs))
    if isinstance(family, Jitter):
        return _walk(_deviations(family, DEVIATION_CELLS[memory], outputs))
    kept, cells = GAP_MEMORY[memory]
    if isinstance(family, SpacedWindows):
        family.nominal  # noqa: B018  # refuses a family without endless members
        longest = family.d_max + OUTWARD * family.window
        return _walk(_gaps(family.spacing, longest, _room(family), kept, cells, outputs))
    return _walk(_gaps(family.shortest, family.longest, lambda word: family.longest, kept, cells, outputs))


START: Word = ("start",)


def _walk(moves: Moves) -> GapGraph:
    """All words that can be reached from the start."""
    words: dict[Word, int] = {START: 0}
    edges: list[Edge] = []
    queue = [START]
    for word in queue:
        for target, low, high, outputs in moves(word):
            if target not in words:
                words[target] = len(words)
                queue.append(target)
                if len(words) > MOST_NODES:
                    raise ArgumentError(f"`memory`: the graph of this family has more than {MOST_NODES} nodes.")
            edges.append(Edge(words[word], words[target], low, high, outputs))
    return GapGraph(((), *list(words)[1:]), tuple(edges))


def _gaps(shortest: float, longest: float, room: Callable[[Word], float], kept: int, cells: int, outputs: int) -> Moves:
    """Words of the lower ends of the last `kept` gaps; the first one, cut by the window's start, may be short."""
    borders = np.linspace(shortest, longest, cells + 1)
    every = (True,) * outputs

    def moves(word: Word) -> list[tuple[Word, float, float, tuple[bool, ...]]]:
        old = () if word == START else word
        found = []
        for k, (low, high) in enumerate(pairwise(borders.tolist())):
            low = 0.0 if word == START and k == 0 else low
            high = min(high, room(old))
            if low <= high:
                found.append(((low, *old)[:kept], low, high, every))
        return found

    return moves


def _room(family: SpacedWindows) -> Callable[[Word], float]:
    """Longest gap after gaps of at least these lengths (newest first).

    Any k consecutive gaps sum to at most T, and gaps to come are at least epsilon: of the k gaps that hold the
    new one, i are old and k - 1 - i are to come.
    """
    T, k, spacing = family.window, family.count, family.spacing

    def room(word: Word) -> float:
        least = min(T - sum(word[:i]) - (k - 1 - i) * spacing for i in range(min(len(word), k - 1) + 1))
        return float(least + OUTWARD * T)

    return room


def _losses(family: LostSamples, remembered: int, outputs: int) -> Moves:
    """Words (phase, last losses newest first): at most `most` of any `remembered` lost, which the family implies."""
    schedule = family.schedule
    assert isinstance(schedule, PeriodicSchedule)
    masks = _masks(schedule, outputs)
    lost = (False,) * outputs
    reach = _reach(schedule)

    def moves(word: Word) -> list[tuple[Word, float, float, tuple[bool, ...]]]:
        start = word == START
        phases = range(len(schedule)) if start else [(word[0] + 1) % len(schedule)]
        bits = () if start else word[1:]
        found = []
        for j in phases:
            low, high = (0.0, reach[j]) if start else (float(schedule.gaps[j]),) * 2
            found.append(((j, *_recent((0, *bits), remembered)), low, high, masks[j]))
            if sum(bits[: remembered - 1]) < family.most:
                found.append(((j, *_recent((1, *bits), remembered)), low, high, lost))
        return found

    return moves


def _recent(bits: tuple[int, ...], remembered: int) -> tuple[int, ...]:
    """The losses that count, without the zeros before the oldest one."""
    recent = bits[: remembered - 1]
    while recent and not recent[-1]:
        recent = recent[:-1]
    return recent


def _deviations(family: Jitter, cells: int, outputs: int) -> Moves:
    """Words (phase, lower and upper end of the last deviation)."""
    schedule, radius = family.schedule, family.radius
    assert isinstance(schedule, PeriodicSchedule)
    masks, reach = _masks(schedule, outputs), _reach(schedule)
    borders = np.linspace(-radius, radius, cells + 1).tolist()
    borders = borders if radius else [0.0, 0.0]

    def moves(word: Word) -> list[tuple[Word, float, float, tuple[bool, ...]]]:
        start = word == START
        phases = range(len(schedule)) if start else [(word[0] + 1) % len(schedule)]
        found = []
        for j in phases:
            gap = float(schedule.gaps[j])
            for a, b in pairwise(borders):
                low, high = (0.0, reach[j] + radius + b) if start else (gap + a - word[2], gap + b - word[1])
                wider = OUTWARD * (gap + radius)
                found.append(((j, a, b), max(low - wider, 0.0), high + wider, masks[j]))
        return found

    return moves


def _masks(schedule: PeriodicSchedule, outputs: int) -> list[tuple[bool, ...]]:
    if schedule.outputs is None:
        return [(True,) * outputs] * len(schedule)
    return [tuple(bool(on) for on in row) for row in schedule.outputs]


def _reach(schedule: PeriodicSchedule) -> list[float]:
    """Longest time before each sample of the lap at which a window may start with that sample next."""
    reach = [float(gap) for gap in schedule.gaps]
    reach[0] = max(reach[0], float(schedule.times[0]))
    return reach
