"""The graph of a family: every schedule of it, from every window start, is a path in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.certificates.families.path_complete import Edge, PathCompleteGraph
from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.schedules.family import START, SamplingFamily, Steps, Word, period_of
from sampling_design.schedules.schedule import PeriodicSchedule

MOST_NODES = 400  # a graph with more nodes than this is not built: its matrix inequalities would take minutes


def in_plant_terms(plant: Plant, family: SamplingFamily) -> SamplingFamily:
    """Return `family` with the schedule that it is built around in the plant's terms.

    Raises ArgumentError if it is no family, its unit of time differs, the schedule that it is built around is finite,
    or its tolerances are those of other outputs.
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
        return family.replanned(
            PeriodicSchedule(planned.gaps, planned.first, planned.outputs, time_unit=planned.time_unit)
        )
    if family.time_unit not in (None, plant.time_unit):
        raise ArgumentError(
            f"`family` is in {family.time_unit} and the plant in {plant.time_unit}. Give it in that unit."
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
