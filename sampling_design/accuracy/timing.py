"""The same accuracy for all real sample times within a tolerance d of the planned ones, known once samples are taken.

A sample that is planned at t_j and comes e late, |e| <= d, is one at t_j with more noise: of any trajectory

    C x(t_j + e) + v = C x(t_j) + v + [ C (e^{Ae} - I) x(t_j) + int C e^{A(e-s)} G w ds ],

and where every sample reads zero, x(t_j) is bounded: by g_j(u) = sup_e rho(C (e^{Ae} - I); t_j) + int h_W, with rho for
noise within v + u. If g(u) < u in every entry, u is noise enough: rho is concave in u, so that g(a u) <= a g(u) < a u
for a >= 1, and no trajectory's brackets can be a >= 1 times u where they are largest. In between, a row is known after
sample j from t_j + d on, and until t_{j+1} + d there may be no other. Where results come one after the other, x(t_j) is
bounded by what is in when that of the sample comes, and no more: later on only more is in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sampling_design.accuracy.adversary_program import Adversary, ConeWindow
from sampling_design.accuracy.between_samples import KnownIntegrals, RowBetweenSamples, RowSearch, open_row
from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.gains import whole_gains
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.sampled_system import GapDynamics, SampledSystem, make_gap
from sampling_design.accuracy.search import TOLERANCE, GainSearch
from sampling_design.accuracy.undetectable import DetectablePart
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, admissible, physical
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.linalg import expm_batch, extrapolated
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.record import short
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance

ENOUGH = 1.03  # noise that is so much more than what a tolerance adds is not sought closer

MORE = 0.015
"""Share by which noise that is enough is above what it bounds: room for proofs near by, where a plan is left."""

TURNS = 24  # times that noise which is enough is sought: beyond them nothing bounds what late samples do
FAR = 1e6  # so many times what a tolerance adds without it is no noise that is of use
RUSHED = 3  # turns that begin once the budget is spent, each with twice as much noise, at most
PANELS = 8  # panels of the time by which a sample may be late, at least
KEPT_ROOM = MORE / 3  # that share where the gains that were kept prove it again
FARTHEST = 64  # samples back of the gains that bound what a tolerance adds, at most
MOVED = 3  # turns in which the worst times and the disturbance that does most at them are sought


def refuse_tolerance(question: AccuracyQuestion, stochastic: bool) -> None:
    """Refuse a tolerance that does not keep samples in order and in the schedule, or what is of exact times only.

    Raises ArgumentError.
    """
    late, nodes = question.timing_tolerance, question.nodes
    gaps = np.diff(question.nodes[question.samples], append=[question.end] * (question.initial is None))
    late.require_order(float(np.min(gaps, initial=np.inf)) * (1 - KEPT))
    if late and (question.bounds.w_centre is not None or question.bounds.v_centre is not None):
        raise ArgumentError("`timing_tolerance` is for bounds centred at 0. Subtract their middle from the data.")
    if stochastic:
        raise ArgumentError(
            "`timing_tolerance` and `result_delay` are for errors that are guaranteed: leave out these, or "
            "`w_intensity` and `v_deviation`."
        )
    if question.initial is None:
        return
    if late and not question.initial.whole:
        raise ArgumentError(
            "`initial_error` must bound every state where samples may be early or late: what their times change "
            "depends on it."
        )
    first, last = question.nodes[question.samples][[0, -1]]
    planned = first - late.shift, last - late.shift
    hasty = nodes[0] > first - late.radius or (late and nodes[0] == first)
    rounding = KEPT * (question.last_result - nodes[0]) + 2 * np.spacing(question.last_result)
    if hasty or question.end < question.last_result - rounding:
        raise ArgumentError(
            f"`start` must lie before the first sample, `timing_tolerance` {short(max(late.early))} at least, and "
            f"`end` not before {short(question.last_result, 12)}, when the last result is in, got "
            f"{short(nodes[0], 12)} and {short(question.end, 12)} for samples from {short(planned[0], 12)} "
            f"to {short(planned[1], 12)}."
        )


def noise_enough(
    question: AccuracyQuestion, known: DetectablePart, budget: Budget
) -> tuple[Array, GainSearch, GainSearch]:
    """Return the noise u (N, p) that stands for the tolerance, and the search whose directions prove that it is enough.

    It is 0 where an output is not measured. Beside it the search without that noise.

    Raises UndecidedError if there is none: what a tolerance adds grows faster than itself, or a row that it takes is
    not known.
    """
    before, tried = np.zeros_like(question.bounds.v), np.zeros_like(question.bounds.v)
    kept: tuple[Array, GainSearch, GainSearch] | None = None
    least = 0.0
    rushed = 0
    search = planned = GainSearch(*question.filter_bounds(known.plant, known.moving), budget=budget)
    for turn in range(TURNS):
        rushed += budget.over
        if turn:
            search = GainSearch(*question.noisier(tried).filter_bounds(known.plant, known.moving), budget=budget)
        found = added(search, question, known, seek=True)
        enough = is_enough(tried, found)
        if not np.isfinite(found).all() or (rushed > RUSHED and not enough):
            break
        if enough:
            kept = tried, search, planned
            if np.all(tried <= ENOUGH * found) or rushed >= RUSHED:
                return kept
            before, tried = tried, found * (1 + (ENOUGH - 1) / 2)
            continue
        if kept is not None and turn:
            return kept
        least = least or float(found.max(initial=0.0))
        before, tried = tried, extrapolated(before, tried, found) * (2 if rushed else 1 + MORE)
        if np.any(tried > FAR * (least + 1e-300)):
            break
    if kept is not None:
        return kept
    why = "the error that makes their times matter grows with them. Ask for a smaller `timing_tolerance`."
    if rushed:
        why = "`budget` ended before noise was found that stands for their times. Ask with a larger one."
    if not np.isfinite(found).all():
        why = f"they may show {', '.join(known.modes)}, which samples on time do not. Change the period a little."
    raise UndecidedError(f"undecided: nothing bounds what samples {question.timing_tolerance.describe()} may do: {why}")


def is_enough(noise: Array, found: Array, room: float = MORE / 2) -> bool:
    """Whether a noise is more than all that it bounds, by a share."""
    return bool(np.all((noise >= found * (1 + room)) | (found == 0)))


def added(search: GainSearch, question: AccuracyQuestion, known: DetectablePart, seek: bool = False) -> Array:
    """Return g (N, p): what samples add at most that come so early or late, by directions of a search, or new ones.

    New ones look back as far as the filter remembers, whatever the search does for its rows, or go on as the filter
    does; once the budget is spent they are the filter's.
    """
    measured = {i for _, i in search.system.incoming}
    powers = _powers(question.plant.A) if known.unknown.shape[1] else []
    if any(known.touches(question.plant.C[i] @ power) for i in measured for power in powers):
        return np.full_like(question.bounds.v, np.inf)
    own = search.back
    if seek and search.system.start is None and not search.follows:
        search.back = int(np.clip(search.system.memory, search.back, FARTHEST))
    late, g = question.timing_tolerance, np.zeros_like(question.bounds.v)
    forward, back = (np.broadcast_to(side, question.plant.n_outputs) for side in (late.forward, late.back))
    tables: dict[int, tuple[KnownIntegrals, KnownIntegrals]] = {i: ({}, {}) for i in measured}
    together: dict[int, dict[tuple[int, int], list[RowBetweenSamples]]] = {}
    for (j, i), node in search.system.incoming.items():
        sides, row = (float(forward[i]), float(back[i])), question.plant.C[i] @ known.lift
        together.setdefault(node, {})[j, i] = [
            moved_row(search.system, node, row, side, bool(early), table)
            for early, (side, table) in enumerate(zip(sides, tables[i], strict=True))
            if side
        ]
    for node, moved in together.items():
        ends = [each.mu[-1] for opened in moved.values() for each in opened] if seek else []
        while ends and not search.budget.over:
            search.gains(node, ends.pop())
        if ends:
            search.sketch(node, np.array(ends))
        for at, opened in moved.items():
            g[at] = max((float(each.bound(search.directions[node])[1].max()) for each in opened), default=0.0)
    search.back = own
    if question.bounds.v_ball:
        g = np.where(np.isfinite(question.bounds.v), np.linalg.norm(g, axis=1, keepdims=True), 0.0)
    return g


def _powers(A: Array) -> list[Array]:
    """A, A^2, ...: where C A^k does not touch what is unknown, no time does."""
    found = [A / max(float(np.abs(A).max()), 1e-300)]
    while len(found) < len(A):
        following = found[-1] @ found[0]
        found.append(following / max(float(np.abs(following).max()), 1e-300))
    return found


def moved_row(
    system: SampledSystem, j: int, row: Array, late: float, back: bool, known: KnownIntegrals
) -> RowBetweenSamples:
    """C (e^{Ae} - I) and what w adds for 0 <= e <= `late`, or -`late` <= e <= 0 (`back`), at sample j."""
    opened = open_row(replace(system, A=-system.A) if back else system, j, row, late, known, PANELS)
    return replace(opened, mu=opened.mu - opened.mu[0])


def moved_witness(
    search: GainSearch, question: AccuracyQuestion, found: RowSearch, j: int, offset: int
) -> AccuracyWitness:
    """Return a witness at real times that are sought to make a row's error large at an offset after node j.

    Moving sample k by e changes the adversary's optimum by -lambda_k'H (A z_k + G w) e to first order: that sign is
    taken, with w in between what it is before and after that sample.
    """
    count = len(search.system.nodes(j, search.deep))
    mu = found.opened[j].mu[offset]
    gains, adversary = search.both_sides(j, mu)
    system, at, shift, until = search.system, j, np.zeros(1), float(found.opened[j].d[offset])
    system_of = moved_systems(system, search.cell_loss)
    best: AccuracyWitness | None = None
    for _ in range(MOVED):
        ahead = open_row(system, at, found.row, until).mu[-1] @ np.linalg.solve(system.L[at], system.G)
        whole, _ = whole_gains(system, system.latest(at, len(gains.gains)), mu, gains.gains)
        shift = _worst_times(system, at, whole, adversary, ahead, question.timing_tolerance, shift)
        moved, at = _moved_question(question, j, count, shift)
        system = system_of(moved)
        until = float(found.opened[j].d[offset]) - shift[-1]
        opened = open_row(system, at, found.row, until)
        nodes = system.nodes(at, count)
        start = InitialSet.box(np.zeros(system.D.size)) if system.start is None or nodes[0] else system.start
        mu = opened.mu[-1]
        gains, adversary = ConeWindow(system, nodes, start, tolerance=TOLERANCE).both(mu)
        witness = physical(found.row, opened, adversary, opened.d.size - 1)
        witness = admissible(witness, moved)
        if best is not None and witness.value <= best.value * (1 + KEPT):
            break
        best = replace(witness, last=at % len(question.bounds.v))
    assert best is not None  # the first turn keeps one
    return best


def moved_systems(planned: SampledSystem, loss: float) -> Callable[[AccuracyQuestion], SampledSystem]:
    """What makes the system of a question with other gaps, in the planned one's coordinates; those alike are made once.

    Its samples are those of some periods of the planned one, or of a finite one.
    """
    table, known = GapTable(planned.A, planned.G, np.ones(len(planned.A))), dict[tuple[int, int], GapDynamics]()

    def gap(j: int, h: float, tiny: float) -> GapDynamics:
        if abs(planned.gaps[j].length - h) <= tiny:
            return planned.gaps[j]
        key = j, round(h / tiny)
        if key not in known:
            L, following = planned.L[j], planned.L[(j + 1) % len(planned)]
            known[key] = make_gap(table, h, L, following, expm_batch(planned.A, [h])[0], loss)
        return known[key]

    def system(moved: AccuracyQuestion) -> SampledSystem:
        ends = moved.nodes if moved.initial is not None else np.append(moved.nodes, moved.end)
        tiny, at = 8 * float(np.spacing(np.abs(ends).max())), np.arange(len(moved.nodes)) % len(planned)
        gaps = tuple(gap(k % len(planned), h, tiny) for k, h in enumerate(np.diff(ends).tolist()))
        return replace(
            planned, bounds=moved.bounds, L=planned.L[at], samples=tuple(planned.samples[j] for j in at.tolist()),
            gaps=gaps, last=moved.end - float(moved.nodes[-1]), known_spans=(), again=(), before=(),
        )  # fmt: skip

    return system


def _worst_times(
    system: SampledSystem,
    at: int,
    gains: list[Array],
    adversary: Adversary,
    ahead: Array,
    late: TimingTolerance,
    before: Array,
) -> Array:
    """How late each sample of a window is, the latest last, so that the adversary gains; as before where none does.

    `ahead`: what moves the row after the last sample, for which w is largest.
    """
    nodes = system.nodes(at, len(adversary.z))
    size = float(np.linalg.norm(ahead))
    last = (ahead / size if size else ahead) if system.bounds.w_ball else np.sign(ahead)
    cells = [last[None], *adversary.w[::-1], np.zeros((1, last.size))][::-1]
    tilt = np.zeros(len(nodes))
    for k, (node, lam, z) in enumerate(zip(nodes, gains[-len(nodes) :], adversary.z, strict=True)):
        L, w = system.L[node], (cells[k][0] + cells[k + 1][-1]) / 2
        tilt[k] = lam @ system.samples[node].H @ np.linalg.solve(L, system.A @ (L @ z) + system.G @ w)
    return np.where(tilt == 0, before, np.where(tilt > 0, -late.back.min(), late.forward.min()))


def _moved_question(question: AccuracyQuestion, j: int, count: int, shift: Array) -> tuple[AccuracyQuestion, int]:
    """The question with the samples up to node j moved, those after it as late as can be; and where j is now."""
    late, number, times, at = question.timing_tolerance, len(question.nodes), question.nodes.copy(), j
    end, v = question.end, question.bounds.v
    if question.initial is None:
        periods, length = count // number + 3, question.end - question.nodes[0]
        times = (question.nodes + length * np.arange(periods)[:, None]).ravel()
        at, end, v = (periods - 2) * number + j, float(times[0] + periods * length), np.tile(v, (periods, 1))
    times[at + 1 - shift.size : at + 1] += shift
    times[at + 1 : at + 2] += late.forward.min()
    bounds = replace(question.bounds, v=freeze(v))
    return replace(question, bounds=bounds, nodes=freeze(times), end=end, timing_tolerance=ON_TIME), at


def keeps_times(witness: AccuracyWitness, question: AccuracyQuestion) -> bool:
    """Whether a witness ends before any result that it does not hide can be in.

    Its samples lie within the tolerance of the schedule's; of those up to its last one, and of later ones, what it does
    not hide is out until its end.
    """
    late, length, number = question.timing_tolerance, question.end - question.nodes[0], len(question.nodes)
    back, forward = float(late.back.min()), float(late.forward.min())  # of all outputs together
    count, comes, end = len(witness.samples), question.comes_after, float(witness.edges[-1])
    longest = float(np.max(comes[np.isfinite(comes)], initial=0.0))
    ahead = 1 + (number - 1 - witness.last if question.initial is not None else int(longest / length + 1) * number)
    places = witness.last + 1 - count + np.arange(count + ahead)
    planned = question.nodes[places % number] + places // number * length
    early, shift = planned[:count] - witness.samples, 0.0
    if question.initial is not None and places[0] == 0:
        shift, early = float(question.nodes[0]), early[question.samples[0] :]
    else:  # a schedule of this kind may have begun at any time: as early as can be
        shift = float(early.max()) - back
    tiny = KEPT * max(end, float(np.abs(planned).max()))
    in_at = planned[:, None] + comes[places % number] - shift
    if question.initial is not None:
        in_at[places >= number] = np.inf
        in_at = np.vstack([in_at, np.full((1, in_at.shape[1]), question.end - shift)])
    in_at[:count][witness.outputs] = np.inf
    near = np.all(early - shift <= back + tiny) and np.all(shift - early <= forward + tiny)
    return bool(near and end <= np.min(in_at) + tiny)
