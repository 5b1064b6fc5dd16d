"""What a finished search says: the strongest row_adversary as a witness, and what a finite schedule leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.search import GainSearch, RowSearch
from sampling_design.accuracy.undetectable import open_modes
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, attains, physical
from sampling_design.records.arrays import Array


def left_open(question: AccuracyQuestion, finder: GainSearch | None, upper: Array) -> tuple[str, ...]:
    """Return the eigenvalues that the samples of a finite schedule leave open, if a wanted row is infinite."""
    if finder is None or np.isfinite(upper).all():
        return ()
    system, last = finder.system, finder.system.spans[-1].node
    basis = finder.directions[last].basis
    free = np.linalg.svd(basis, full_matrices=True)[0][:, basis.shape[1] :]
    return open_modes(question.plant.A, system.D[:, None] * system.L[last] @ free)


def strongest_witness(
    finder: GainSearch, row: Array, question: AccuracyQuestion, found: RowSearch
) -> tuple[AccuracyWitness, int, int]:
    """Return the strongest adversary as a witness, simulated anew and made admissible, its sample and its offset."""
    best: tuple[AccuracyWitness, int, int] | None = None
    adversaries = []
    for j, opened in found.opened.items():
        sure = np.isfinite(found.nodes[j])
        if not sure.any():
            continue
        for row_adversary in finder.adversaries[j] or [finder.idle(j)]:
            values = np.where(sure, np.abs(opened.mu @ row_adversary.end) + opened.below, -1.0)
            adversaries.append((float(np.max(values)), int(np.argmax(values)), row_adversary))
    top = (1 - KEPT) * max(value for value, *_ in adversaries)
    for value, offset, row_adversary in sorted(
        adversaries, key=lambda a: (-min(a[0], top), a[2].sample)
    ):  # of equals the first
        if best is not None and best[0].value >= (1 - KEPT) * value:
            break
        witness = admissible(physical(row, found.opened[row_adversary.sample], row_adversary, offset), question)
        if best is None or witness.value > best[0].value * (1 + KEPT):
            best = witness, row_adversary.sample, offset
    assert best is not None
    return best


def admissible(witness: AccuracyWitness, question: AccuracyQuestion) -> AccuracyWitness:
    """Return a witness simulated anew, its gaps closed, so small that it keeps the bounds of a question."""
    if question.initial is None and witness.states[0].any():
        witness = witness.propagated()  # rounding that no disturbance closes
    closed = witness.simulate(question.bounds.w).w
    witness = replace(witness, w=closed) if np.isfinite(closed).all() else witness
    value, excess = attains(witness, question.bounds, question.initial)
    return witness.within(excess, value)
