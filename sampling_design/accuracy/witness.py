"""An adversary in the plant's own units: from rest, every sample zero, the row as far off as it gets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.adversary_program import Adversary
from sampling_design.accuracy.between_samples import NEGLIGIBLE, RowBetweenSamples, RowSearch
from sampling_design.accuracy.bounds import InitialSet, SignalBounds
from sampling_design.accuracy.lasting import AMONG, LastingTrajectory, beyond
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.undetectable import open_modes
from sampling_design.numerics.linalg import discounted_flow, expm_batch, forced_flow, products
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.declarations import below, selected
from sampling_design.records.record import Plain, Record, short

KEPT = 1e-9  # relative rounding within which a witness keeps its bounds and reaches its value when it is simulated anew
SHOWN = 1e-9  # what an exact sensor may show, as a share of what w or the start does to it: rounding and last digits

SHRUNK = 12
"""Times that a witness is made smaller, by twice as much more than it exceeds its bounds by each time, until what
closes its gaps keeps them too; else it is at rest."""

CLOSED = 1e-13
"""What may be left open at the end of a gap, as a share of the terms that make the state there: rounding alone."""

LAST_DIGIT = float(np.finfo(float).eps)
"""So much of what w can move a state by may be left open of it, too: the last digit of w does that."""


class WitnessRun(NamedTuple):
    """v (K, p) = -C x at the samples (NaN where not measured), x (n,) at the end, and w (M, q)."""

    v: Array
    x: Array
    w: Array


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyWitness(Record):
    """A disturbance and a noise that keep their bounds and that no estimator can tell from nothing at all.

    The state starts at 0 (or within what is known at the start; on an endless schedule also on responses that have
    gone on for ever, within the bounds); every sample shows y = C x + v = 0, so that +x and -x look alike, and any
    estimator errs by `value` on one of them.

    Attributes
    ----------
    plant : Plant
    row : (n,) array
    edges : (M+1,) array
        Ends of the cells on which w is constant, from 0 on [the plant's time unit].
    w : (M, q) array
    samples : (K,) array
        Sample times after the start; the last at most a gap before the end.
    last : int
        Place of the last sample in the schedule's period.
    states : (K, n) array
        x at those samples; the first is where it starts.
    outputs : (K, p) array of bool
        What each sample measures.
    value : float
        row'x at the end.
    past : LastingTrajectory, optional
        What has gone on for ever before the first sample, and ends in its state.
    """

    plant: Plant
    row: Array
    edges: Array
    w: Array
    samples: Array
    last: int
    states: Array
    outputs: Mask
    value: float
    past: LastingTrajectory | None = None

    _table = {"value": "{value:down}", "samples": "{samples.size}", "duration": "{edges[-1]} {plant.time_unit}"}

    def simulate(self, units: Array | None = None) -> WitnessRun:
        """Return what happens: the noise that hides the state at the samples, its end, and the disturbance.

        Every gap is simulated anew from the state at its first sample. What rounding leaves open at its end is closed
        by a change of w within that gap, so that what is returned is one trajectory even where the plant grows: its
        state at the samples is exactly `states`, its w is `w` but for that change. NaN in w: no change closes it.

        Parameters
        ----------
        units : (q,) array, optional
            In which the change is least, such as the bounds on w; an entry of 0 does not change. Default: the largest
            of each entry of `w`.
        """
        plant, scale = self.plant, self.scales()
        size = np.max(np.abs(self.w), axis=0, initial=0.0) if units is None else units
        A, G = plant.A * scale / scale[:, None], plant.G * size / scale[:, None]  # what is 0 cannot close a gap
        moves, size = size > 0, np.where(size > 0, size, 1.0)
        flows, which = _cell_flows(A, G, self.edges)
        ends = np.searchsorted(self.edges, self.samples)
        z, w = self.states / scale, self.w / size
        for at, inside, ahead, flat in _alike(flows, which, ends):  # each gap is simulated from its own state
            own = w[inside].reshape(len(at), -1)
            terms = np.abs(z[at]) @ np.abs(ahead).T + np.abs(own) @ np.abs(flat).T
            terms = np.maximum(terms, LAST_DIGIT / CLOSED * np.abs(flat).sum(axis=1))
            unit, left = terms.clip(1e-300), z[at + 1] - (z[at] @ ahead.T + own @ flat.T)
            change = _least_change(flat / unit[:, :, None], left / unit)
            change[:, np.tile(~moves, inside.shape[1])] = 0.0  # of what does not drive: rounding
            open_still = np.abs(left - change @ flat.T)
            change[~np.all(open_still <= CLOSED * terms, axis=1)] = np.nan
            w[inside] += change.reshape(*inside.shape, -1)
        first, count = int(ends[-1]), len(w)
        some = np.append(np.arange(first, count, max(math.isqrt(count - first), 1)), count)  # alike, as a rule
        x = _carried(flows, which, some, z[-1], w)[-1]
        return WitnessRun(np.where(self.outputs, -self.states @ plant.C.T, np.nan), scale * x, w * size)

    def propagated(self) -> AccuracyWitness:
        """Return the witness with states that follow from the first one by its disturbance."""
        scale, size = self.scales(), np.max(np.abs(self.w), axis=0, initial=0.0)
        A, G = self.plant.A * scale / scale[:, None], self.plant.G * size / scale[:, None]
        (flows, which), w = _cell_flows(A, G, self.edges), self.w / np.where(size > 0, size, 1.0)
        z = _carried(flows, which, np.searchsorted(self.edges, self.samples), self.states[0] / scale, w)
        return replace(self, states=freeze(scale * z))

    def within(self, excess: float, value: float) -> AccuracyWitness:
        """Return the witness made so small that bounds which it exceeds by a factor are kept; `value` is its row."""
        factor = max(excess, 1.0)
        w, states = freeze(self.w / factor), freeze(self.states / factor)
        past = None if self.past is None else self.past.scaled(1 / factor)
        return replace(self, w=w, states=states, value=value / factor, past=past)

    def scales(self) -> Array:
        """How far w carries each state over the longest cell, so that units play no part in the flow."""
        moved, balance = self._moved
        return np.where(moved > 0, moved, balance)

    def sizes_at_samples(self, initial: InitialSet | None) -> Array:
        """(K, n) how large states are at the samples, of which a share of `SHOWN` is rounding.

        What w does within a cell; of a state that it does not move, what the start leaves of it by then.
        """
        moved, balance = self._moved
        if initial is None or not self.states[0].any():
            return np.where(moved > 0, moved, balance)[None]
        bounded = np.linalg.norm(initial.rows, axis=0)
        start = np.divide(1.0, bounded, out=np.abs(self.states[0]), where=bounded > 0)
        passed = self.samples - self.samples[0]
        with np.errstate(over="ignore", invalid="ignore"):
            left = np.abs(expm_batch(self.plant.A * balance / balance[:, None], passed)) @ (start / balance) * balance
        return np.where(moved > 0, moved, np.where(np.isfinite(left), left, 0.0))

    @cached_property
    def _moved(self) -> tuple[Array, Array]:
        """How far w carries each state over the longest cell, and sizes that balance A."""
        balance = balanced_schur(self.plant.A).d
        G = self.plant.G * np.max(np.abs(self.w), axis=0, initial=0.0) / balance[:, None]
        longest = np.max(np.diff(self.edges), initial=0.0)
        _, W = discounted_flow(self.plant.A * balance / balance[:, None], G @ G.T, [longest])
        return balance * np.sqrt(longest * np.diag(W[0])), balance

    def explain(self) -> str:
        """Say what the witness does."""
        start, count = "an admissible start" if self.states[0].any() else "rest", self.samples.size
        return (
            f"From {start}, a disturbance within its bound moves the row to {below(self.value)} in "
            f"{short(self.edges[-1])} {self.plant.time_unit} while noise within its bound makes "
            f"{'the one sample' if count == 1 else f'all {count} samples'} read zero."
        )

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        outputs = self.outputs.astype(int).tolist()
        plain = {**selected(self, "row edges w samples last states value"), "outputs": outputs}
        return plain if self.past is None else {**plain, "past": selected(self.past, "rates multiples x w")}


def _cell_flows(A: Array, G: Array, edges: Array) -> tuple[Array, Index]:
    """Flows over cells (k, n, n + q), each once, and which of them each cell (M,) has.

    Cells whose lengths differ by the rounding of their ends alone share one.
    """
    if edges.size < 2:
        return forced_flow(A, G, []), np.zeros(0, dtype=np.intp)
    lengths, digit = np.diff(edges), 2 * np.spacing(edges[-1])
    _, first, which = np.unique(np.rint(lengths / digit), return_index=True, return_inverse=True)
    return forced_flow(A, G, lengths[first]), which


def _alike(flows: Array, which: Index, ends: Index) -> Iterator[tuple[Index, Index, Array, Array]]:
    """Gaps of the same cells, those of a period: which (K,), their cells (K, m), and the flow over one of them.

    Gap k is from ends[k] to ends[k + 1].
    """
    cells = np.diff(ends)
    for count in np.unique(cells):
        at = np.flatnonzero(cells == count)
        inside = ends[at][:, None] + np.arange(count)
        kinds, kind = np.unique(which[inside], axis=0, return_inverse=True)
        for k, (ahead, flat) in enumerate(zip(*_over_gaps(flows[kinds]), strict=True)):
            own = kind.ravel() == k
            yield at[own], inside[own], ahead, flat


def _over_gaps(flows: Array) -> tuple[Array, Array]:
    """Flow over whole gaps (K, n, n), and what a constant w in each of their cells adds (K, n, m q); m cells each.

    `flows` (K, m, n, n + q) are those of the cells.
    """
    count, m, n = flows.shape[:3]
    ahead, blocks = np.tile(np.eye(n), (count, 1, 1)), np.zeros((count, n, m, flows.shape[3] - n))
    for cell in range(m - 1, -1, -1):
        blocks[:, :, cell] = ahead @ flows[:, cell, :, n:]
        ahead = ahead @ flows[:, cell, :, :n]
    return ahead, blocks.reshape(count, n, -1)


def _carried(flows: Array, which: Index, ends: Index, z: Array, w: Array) -> Array:
    """Where cells carry a state z (n,) with w (M, q), at some of their ends (K, n); there it is at the first."""
    states, moved = np.tile(z, (ends.size, 1)), np.zeros((ends.size, z.size))
    onward = np.zeros((*states.shape, z.size))
    for at, inside, ahead, flat in _alike(flows, which, ends):
        onward[at], moved[at] = ahead, w[inside].reshape(len(at), -1) @ flat.T
    for k in range(ends.size - 1):
        states[k + 1] = onward[k] @ states[k] + moved[k]
    return states


def _least_change(rows: Array, wanted: Array) -> Array:
    """The shortest solutions (K, m) of rows (K, n, m) x = wanted (K, n), in the sense of least squares.

    What rows hardly move, rounding alone where states are turned, is moved only where more than rounding is wanted.
    """
    if not rows.size:
        return np.zeros((len(rows), rows.shape[2]))
    U, s, V = np.linalg.svd(rows, full_matrices=False)
    wanted = products(np.swapaxes(U, 1, 2), wanted)
    rest = np.maximum.accumulate(np.abs(wanted[:, ::-1]), axis=1)[:, ::-1]
    needed = rest > CLOSED / rows.shape[1]
    regular = s > np.where(needed, np.finfo(float).eps * max(rows.shape[1:]), KEPT) * s[:, :1]
    part = np.divide(wanted, s, out=np.zeros_like(s), where=regular)
    return products(np.swapaxes(V, 1, 2), part)


def attains(
    witness: AccuracyWitness, bounds: SignalBounds, initial: InitialSet | None = None, gaps: Array | None = None
) -> tuple[float, float]:
    """Return row'x at the end of a witness simulated anew, and the factor by which w, v and start exceed their bounds.

    Without `initial` the schedule is endless and the witness starts from rest, or from what has gone on for ever
    within the bounds, in time with `gaps` (N,) behind the samples unless it is constant; with it, one that starts at
    the first node may start anywhere in that set.
    """
    v, x, moved = witness.simulate(bounds.w)  # an entry that the witness hardly uses may close a gap, too
    period = [(witness.last - k) % len(bounds.v) for k in range(len(v))][::-1]
    legal = not np.any(witness.outputs & ~np.isfinite(bounds.v[period]))  # what it does not hide must be out
    begun = 0.0
    if initial is not None and witness.last + 1 == len(v):
        begun = initial.excess(witness.states[0])
    elif initial is not None and (witness.states[0].any() or witness.last + 1 < len(v)):
        legal = False
    elif witness.past is not None:
        ends = np.abs(witness.states[0] - witness.past.state) <= AMONG * np.abs(witness.past.x[-1]).sum(axis=1)
        begun = witness.past.excess(witness.plant, bounds, gaps, period[0]) if ends.all() else np.inf
    elif witness.states[0].any():
        legal = False
    if not legal or np.isnan(moved).any():
        return 0.0, np.inf
    w = np.linalg.norm(moved, axis=1, keepdims=True) if bounds.w_ball else np.abs(moved)
    noise, limit = np.where(witness.outputs, np.abs(v), 0.0), np.where(witness.outputs, bounds.v[period], np.inf)
    rounding = SHOWN * witness.sizes_at_samples(initial) @ np.abs(witness.plant.C).T
    noise = np.where((limit <= rounding) & (noise <= rounding), 0.0, noise)
    if bounds.v_ball:
        noise, limit = np.linalg.norm(noise, axis=1), limit.min(axis=1)
    return float(witness.row @ x), max(beyond(w, bounds.w), beyond(noise, limit), begun)


def physical(row: Array, opened: RowBetweenSamples, adversary: Adversary, offset: int) -> AccuracyWitness:
    """Return an adversary with its best end after the last sample, in the plant's units."""
    system, count = adversary.system, len(adversary.w) + 1
    reached = float(opened.mu[offset] @ adversary.end)
    sign = -1.0 if reached < 0 else 1.0
    nodes = system.latest(adversary.sample, count)
    scale = system.bounds.w
    edges, w, samples, now = [np.zeros(1)], [], [0.0], 0.0
    for j, u in zip(nodes[:-1], adversary.w, strict=True):
        gap = system.gap(j)
        edges.append(now + (gap.length - gap.edges[::-1])[1:])
        w.append(sign * u[::-1] * scale)
        now += gap.length
        samples.append(now)
    if opened.d[offset] > 0:
        d = opened.d[: offset + 1]
        if d[0] > 0:
            d = np.append(np.linspace(0.0, d[0], opened.d.size)[:-1], d)
        flows, which = _cell_flows(system.A, system.G, d)
        ahead, mean = row * system.D, np.zeros((which.size, scale.size))
        for k, cell in enumerate(which.tolist()):
            both = ahead @ flows[cell]
            ahead, mean[k] = both[: row.size], both[row.size :]
        if system.bounds.w_ball:
            size = np.linalg.norm(mean, axis=1, keepdims=True)
            u = np.divide(mean, size, out=np.zeros_like(mean), where=size > 0)
        else:
            u = np.sign(mean)
        edges.append(now + (d[-1] - d[::-1])[1:])
        w.append(u[::-1] * scale)
    measured = np.zeros((len(system.samples), system.plant.n_outputs), dtype=bool)
    for j in set(nodes):
        measured[j, system.samples[j].outputs] = True
    states = np.array([sign * system.D * (system.L[j] @ z) for j, z in zip(nodes, adversary.z, strict=True)])
    if system.start is not None and nodes[0] == 0:  # of what is known exactly, coordinates leave rounding
        states[0, system.exact_at_start] = states[:, system.exact_for_ever] = 0.0
        first, unit = system.samples[0], np.abs(states[0])
        shown = system.plant.C[first.outputs[first.exact]]  # what a solver leaves there is no rounding of C x
        states[0] -= unit * np.linalg.lstsq(shown * unit, shown @ states[0])[0]
    w_cells, last = freeze(np.concatenate(w) if w else np.zeros((0, scale.size))), system.sample_of(adversary.sample)
    ends, value = freeze(np.concatenate(edges)), float(abs(reached) + opened.below[offset])
    past = None if adversary.past is None else adversary.past.scaled(sign)
    if past is not None:
        states[0] = past.state
    return AccuracyWitness(
        plant=system.plant,
        row=freeze(row),
        edges=ends,
        w=w_cells,
        samples=freeze(samples),
        last=last,
        states=freeze(states),
        outputs=measured[nodes],
        value=value,
        past=past,
    )


def left_open(question: AccuracyQuestion, finder: GainSearch | None, upper: Array) -> tuple[str, ...]:
    """Return the eigenvalues that the samples of a finite schedule leave open, if a wanted row is infinite."""
    if finder is None or np.isfinite(upper).all():
        return ()
    system, last = finder.system, finder.system.spans[-1].node
    basis = finder.directions[last].basis
    free = np.linalg.svd(basis, full_matrices=True)[0][:, basis.shape[1] :]
    return open_modes(question.plant.A, system.D[:, None] * system.L[last] @ free)


def strongest_witness(
    finder: GainSearch, row: Array, question: AccuracyQuestion, found: RowSearch, limit: Budget
) -> tuple[AccuracyWitness, int, int]:
    """Return the strongest adversary as a witness, simulated anew and made admissible, its sample and its offset.

    Of those that were simulated within the limit: one at least, and the one of the shortest history if nothing else
    attains anything.
    """
    best: tuple[AccuracyWitness, int, int] | None = None
    adversaries = []
    for j, opened in found.opened.items():
        sure = np.isfinite(found.nodes[j])
        if not sure.any():
            continue
        for adversary in finder.adversaries[j] or [finder.idle(j)]:
            values = np.where(sure, np.abs(opened.mu @ adversary.end) + opened.below, -1.0)
            adversaries.append((float(np.max(values)), int(np.argmax(values)), adversary))
    top = (1 - KEPT) * max(value for value, *_ in adversaries)
    nothing = NEGLIGIBLE**2 * float(np.abs(row * finder.system.D).sum())
    ranked = sorted(adversaries, key=lambda a: (-min(a[0], top), a[2].sample))  # of equals the first
    shortest = min(ranked, key=lambda a: len(a[2].w))
    for value, offset, adversary in ranked:
        if best is not None and (best[0].value >= (1 - KEPT) * value or value <= nothing):
            break
        if best is not None and limit.over and (best[0].value > 0 or adversary is not shortest[2]):
            continue  # where nothing was attained yet, the shortest history costs little
        witness = admissible(physical(row, found.opened[adversary.sample], adversary, offset), question)
        if best is None or witness.value > best[0].value * (1 + KEPT):
            best = witness, adversary.sample, offset
    assert best is not None
    return best


def admissible(witness: AccuracyWitness, question: AccuracyQuestion) -> AccuracyWitness:
    """Return a witness simulated anew, its gaps closed, so small that it keeps the bounds of a question.

    Rounding that no disturbance closes, where the start is no rest or w does not drive all states, is left out: states
    are what w makes of the first one.
    """
    if question.initial is None and witness.states[0].any():
        return _within(witness.propagated(), question)
    found = _within(witness, question)
    if found.value > witness.value / 2:
        return found
    return max(found, _within(witness.propagated(), question), key=lambda one: one.value)


def _within(witness: AccuracyWitness, question: AccuracyQuestion) -> AccuracyWitness:
    closed = witness.simulate(question.bounds.w).w
    witness = replace(witness, w=closed) if np.isfinite(closed).all() else witness
    value, excess = attains(witness, question.bounds, question.initial, question.gaps)
    witness = witness.within(excess, value)
    for k in range(1, SHRUNK):  # a smaller one is simulated anew, and other rounding closes its gaps
        value, excess = attains(witness, question.bounds, question.initial, question.gaps)
        if excess <= 1 + KEPT / 2 or not witness.value:
            return replace(witness, value=value)
        witness = witness.within(1 + (excess - 1) * 2.0**k, value)
    return witness.within(np.inf, 0.0)
