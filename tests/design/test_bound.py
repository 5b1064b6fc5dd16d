"""Any psd multipliers prove a bound: against plain sums over schedules, aligned with the jumps on purpose."""

from dataclasses import replace
from itertools import combinations, product

import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds import relaxation
from sampling_design.design.bounds import weak_duality as bound
from sampling_design.design.bounds.branching import narrowed
from sampling_design.design.bounds.evidence import BoundPart, UpperBound, local_part, ordered_part, zone_part
from sampling_design.design.bounds.local_bound import local_bound, relax_local
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.bounds.tied_windows import tied_windows
from sampling_design.design.bounds.zone_bound import relax_zones, zone_bound
from sampling_design.design.bounds.zones import (
    begins,
    flow_of,
    ordered_bound,
    origin_zones,
    regions,
    relax_ordered,
    tightened,
    zoned,
)
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.oracles.design import random_schedule, window_sigma_scan

A = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
C = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def problem(window=4.0, period=4.0, spacing=0.3, samples=5, forbidden=(), fixed=(), available=(None, None), late=0.0):
    span, at = np.array(forbidden, dtype=float).reshape(-1, 2), np.array(fixed, dtype=float)
    return DesignProblem(Plant(A, C), window, period, spacing, samples, span, at, available, late=late)


def multipliers(case, rng, count):
    """Random psd matrices in the scaled basis with sum <Z, S'S> = 1, and starts on tenths of the period."""
    F = rng.normal(size=(count, 3, 2))
    Z = F @ np.swapaxes(F, 1, 2)
    Z /= np.einsum("mij,ij->", Z, case.rows.S.T @ case.rows.S)
    return np.sort(rng.choice(20, count, replace=False)) * case.period / 20, Z


def plain_sum(case, starts, Z, times, origin=0.0):
    """sum_m <Z_m, W(origin + a_m)> over windows (start, start + T], by definition; of each the sample moves at will."""
    S = np.linalg.inv(case.rows.R)
    total = 0.0
    for a, weight in zip(starts, Z, strict=True):
        for t in times:
            r = np.mod(t - origin - a, case.period)
            r = r + case.period if r < 1e-9 else r
            mask = case.mask(np.array([t]))[0]
            while r <= case.window + 1e-9:
                seen = [C[mask] @ expm(A * (r + d)) @ S for d in {-case.late, 0.0, case.late}]
                total += min(float(np.trace(c @ weight @ c.T)) for c in seen)
                r += case.period
    return total


def schedules(case, rng):
    """Random ones, an even one, and one on tenths of the period, where windows start and end."""
    yield from (random_schedule(rng, case.period, case.spacing, case.samples) for _ in range(6))
    yield np.arange(case.samples) * case.period / case.samples
    yield np.sort(rng.choice(10, case.samples, replace=False)) * case.period / 10


def origin_of(case, times, side):
    """The sample after which all come late, or early, by definition."""
    late = times - np.arange(case.samples) * case.period / case.samples
    return int(np.argmin(late) if side == "late" else np.argmax(late))


def near(case, times, side, origin=None):
    """A box of zones that holds the schedule counted from its origin, and little else."""
    origin = origin_of(case, times, side) if origin is None else origin
    counted = np.concatenate([times[origin:], times[:origin] + case.period])
    if case.least_shift == 0:
        counted = counted - counted[0]
    zones = origin_zones(case, side)
    return tightened(case, np.clip(np.stack([counted - 0.1, counted + 0.2], axis=1), zones[:, :1], zones[:, 1:]), side)


@pytest.mark.parametrize(
    ("window", "period", "late"),
    few([(4.0, 4.0, 0.0), (4.0, 3.2, 0.0), (2.5, 4.0, 0.1), (9.0, 4.0, 0.0), (4.0, 4.0, 0.1), (9.0, 4.0, 0.02)], 1, 2),
)
def test_every_bound_exceeds_the_plain_sum(window, period, late):
    rng = np.random.default_rng(5)
    case = problem(window, period, late=late)
    starts, Z = multipliers(case, rng, 6)
    placed = bound.placed_bound(case, starts, Z) ** 2
    exact = bound.placed_bound(problem(window, period), starts, Z) ** 2
    assert placed < exact * (1 - late / 5) or not late
    for times in schedules(case, rng):
        assert plain_sum(case, starts, Z, times) <= placed * (1 + 1e-8)
        turns = [plain_sum(case, starts, Z, times, origin) for origin in times]
        every = tightened(case, origin_zones(case, "late"), "late")
        for side, zones in (("late", every), ("early", near(case, times, "early"))):
            origin = origin_of(case, times, side)
            assert turns[origin] <= zone_bound(case, starts, Z, zones) ** 2 * (1 + 1e-8)


def test_of_a_fast_plant_it_is_not_decided_without_end_who_is_late(monkeypatch):
    """A million turns in a period: the multipliers are carried to no more than about a thousand times."""
    turn = np.array([[0.0, 1e6], [-1e6, 0.0]])
    case = DesignProblem(Plant(turn, np.eye(2)), 4.0, 4.0, 0.3, 4, np.zeros((0, 2)), np.zeros(0), (None,) * 2, late=0.1)
    carried, own = [], bound._multipliers_over
    monkeypatch.setattr(bound, "_multipliers_over", lambda *given: carried.append(given[3].size) or own(*given))
    edges = np.linspace(0.0, 4.0, 40_001)
    bound.profile(case, np.array([0.0, 1.7]), np.eye(2)[None] * np.full((2, 1, 1), 0.25), edges)
    assert carried[0] <= 1000


def test_what_windows_see_is_the_plain_sum_at_both_ends_of_every_piece():
    rng = np.random.default_rng(3)
    case = problem(window=9.0)
    starts, Z = multipliers(case, rng, 6)
    edges = bound.piece_edges(case.period, np.concatenate([bound.jump_times(case, starts), [0.301, 3.3]]))
    g = bound.profile(case, starts, Z, edges)
    for k in range(0, edges.size - 1, 3):
        inside = (edges[[k, k + 1]] + 1e-9 * np.array([1, -1]) * case.period)[:, None]
        left, right = (plain_sum(case, starts, Z, t) for t in inside)
        assert [g.left[k].sum(), g.right[k].sum()] == pytest.approx([left, right], rel=1e-6)
    bend = g.bend.sum(axis=1)
    for k in range(edges.size - 1):  # a chord with the remainder lies above the form inside its piece
        at = edges[k] + np.linspace(0.0, 1.0, 9)[1:-1] * (edges[k + 1] - edges[k])
        fine = bound.profile(case, starts, Z, np.unique([*edges, *at]))
        inner = np.sum(fine.left, axis=1)[(fine.edges[:-1] > edges[k]) & (fine.edges[:-1] < edges[k + 1])]
        share = np.linspace(0.0, 1.0, 9)[1:-1]
        chord = (1 - share) * g.left[k].sum() + share * g.right[k].sum()
        assert np.all(
            inner <= (chord + share * (1 - share) / 2 * (edges[k + 1] - edges[k]) ** 2 * bend[k]) * (1 + 1e-9)
        )


@pytest.mark.parametrize("forbidden", few([[[1.2, 1.6]], [[0.0, 0.5], [1.0, 1.5], [2.0, 2.5], [3.0, 3.5]]], 1))
def test_zones_bound_schedules_with_closed_times_where_they_are(forbidden):
    rng = np.random.default_rng(11)
    case = problem(forbidden=forbidden, available=(None, np.array([[0.5, 4.0]])), spacing=0.05)
    starts, Z = multipliers(case, rng, 6)
    tried = 0
    for _ in range(4000):
        times = np.sort(rng.integers(0, 40, 5) / 10)
        gaps = np.diff(np.append(times, times[0] + 4.0))
        if gaps.min() < 0.05 or not case.mask(times).any(axis=-1).all() or tried == 20:
            continue
        tried += 1
        for side in ("late", "early"):
            origin = origin_of(case, times, side)
            shift = case.least_shift * np.floor((times[origin] - begins(case, side)) / case.least_shift + 1e-9)
            moved = times - shift  # allowed there too: what is forbidden repeats
            zones = near(case, moved, side, origin)
            assert plain_sum(case, starts, Z, np.mod(moved, 4.0)) <= zone_bound(case, starts, Z, zones) ** 2 * (
                1 + 1e-8
            )
    assert tried == 20


def test_bound_with_forbidden_fixed_and_partly_available_times():
    rng = np.random.default_rng(6)
    spans = (np.array([[0.0, 2.0]]), np.array([[1.0, 4.0]]))
    case = problem(samples=4, forbidden=[[1.2, 1.6]], fixed=[0.4, 2.0], available=spans)
    starts, Z = multipliers(case, rng, 5)
    limit = bound.placed_bound(case, starts, Z) ** 2
    tried = 0
    for _ in range(400):
        times = np.sort(np.concatenate([[0.4, 2.0], rng.integers(0, 40, 2) / 10]))
        gaps = np.diff(np.append(times, times[0] + 4.0))
        if gaps.min() < 0.3 or np.any((times >= 1.2) & (times < 1.6)):
            continue
        tried += 1
        assert plain_sum(case, starts, Z, times) <= limit * (1 + 1e-8)
    assert tried > 50


@pytest.mark.parametrize(("end", "other"), [(0, None), (-1, np.array([[0.0, 1.1], [3.3, 4.0]]))])
def test_a_box_at_an_end_of_the_period_is_bounded_as_one_that_ends_just_before(end, other):
    """The first sample does not measure what closes at the origin, nor the last one what opens there a period later."""
    plant = Plant(np.eye(3, k=1), [[1.0, 0.0, 0.0], [0.3, 1.0, 0.0]])
    hours = np.array([[1.1, 3.3]]), other
    case = DesignProblem(plant, 5.5, 4.0, 1.2, 2, np.zeros((0, 2)), np.zeros(0), hours)
    (whole,) = regions(case, "sorted")
    box = case.origin + np.array([[[0.0, 0.5], [1.9, 2.45]], [[1.3, 1.8], [3.6, 4.0]]])[end]
    box[end, end] = whole[end, end]
    inside = box.copy()
    inside[end, end] = case.origin + (1e-6 if end == 0 else 4.0 - 1e-6)
    assert zone_part(case, box, "sorted")[0].value <= 1.001 * zone_part(case, inside, "sorted")[0].value
    assert local_part(case, box, "sorted", 0.15)[0].value <= 1.001 * local_part(case, inside, "sorted", 0.15)[0].value


def test_the_bound_is_attained_by_a_single_sample():
    case = problem(samples=1)
    rng = np.random.default_rng(7)
    starts, Z = multipliers(case, rng, 3)
    best = max(plain_sum(case, starts, Z, [t]) for t in np.linspace(0, 4.0, 2001)[:-1])
    limit = bound.placed_bound(case, starts, Z) ** 2
    assert best <= limit <= best * 1.01


def test_best_cycle_is_the_best_by_enumeration():
    rng = np.random.default_rng(8)
    values = rng.normal(size=14)
    for apart in (0, 1, 3, 4):
        best = max(sum(values[list(c)]) for c in combinations(range(14), 3) if min(np.diff([*c, c[0] + 14])) >= apart)
        found = bound.best_cycle(values, apart, 3, 14.0)
        assert found >= best - 1e-12
        if apart:
            assert found == pytest.approx(best)


def test_what_is_barred_stays_barred_beside_what_is_unknown():
    values = np.array([np.inf, 1.0, -np.inf, 2.0, -np.inf])
    with np.errstate(invalid="raise"):
        assert bound.best_chain(values, 3, 2).tolist() == [0.0, np.inf, np.inf]
        assert bound.best_chain(values, 4, 2).tolist() == [0.0, np.inf, -np.inf]
        assert bound.best_cycle(values[1:], 1, 2, 4.0) == 3.0


def test_reachable_is_a_sliding_maximum():
    x = np.random.default_rng(0).normal(size=30)
    for near, far in ((0, 0), (0, 3), (2, 2), (2, 5), (3, 7), (1, 40)):
        plain = [max(x[max(0, i - far) : i - near + 1], default=-np.inf) if i >= near else -np.inf for i in range(30)]
        assert np.array_equal(bound.reachable(x, near, far), plain)


def test_multipliers_that_prove_nothing_give_an_infinite_bound():
    case, closed = problem(), problem(forbidden=[[0.0, 1.0]])
    every = origin_zones(case, "late")
    good = BoundPart("zones", np.zeros(1), np.eye(3)[None] / 3, every)
    assert np.isfinite(UpperBound(1.0, (good,)).value_for(case))
    indefinite = BoundPart("zones", np.zeros(1), np.diag([1.0, 1.0, -0.5])[None], every)
    assert UpperBound(1.0, (indefinite,)).value_for(case) == np.inf
    less = every.copy()
    less[3, 1] -= 0.1
    part = BoundPart("zones", np.zeros(1), np.eye(3)[None] / 3, less)
    assert np.isfinite(part.value_for(case))
    assert UpperBound(1.0, (part,)).value_for(case) == np.inf  # a late fourth sample is left uncovered
    other = BoundPart("zones", np.zeros(1), np.eye(3)[None], every, side="early")
    assert UpperBound(1.0, (other,)).value_for(case) == np.inf
    assert UpperBound(1.0, (other, good)).value_for(case) == np.inf
    assert good.value_for(closed) == np.inf  # its zones are those of schedules that may be shifted
    assert good.value_for(problem(samples=4)) == np.inf
    assert UpperBound(1.0, ()).value_for(case) == np.inf
    assert zoned(problem(fixed=[0.0, 1.0]))
    assert part.value_for(problem(fixed=[0.0, 1.0])) == np.inf
    assert UpperBound(1.0, (part,)).value_for(problem(fixed=[0.0, 1.0])) == np.inf


def test_a_part_without_schedules_bounds_them_by_nothing():
    case = problem()
    zones = origin_zones(case, "late")
    zones[2] = 3.99, 4.0
    assert BoundPart("zones", np.zeros(1), np.eye(3)[None], zones).value_for(case) == 0.0


MATRICES = {
    "turning": (A, C),
    "growing": (np.array([[2.0, 1.0], [-1.0, 2.0]]), np.array([[1.0, 0.2]])),
    "growing apart": (np.array([[3.0, 1.0], [0.0, 0.1]]), np.array([[1.0, 0.4]])),
    "fading": (np.array([[-1.0, 1.0], [0.0, -1.5]]), np.array([[1.0, 1.0]])),
}


@pytest.mark.parametrize(
    ("name", "window", "late"),
    few([(name, *each) for name in MATRICES for each in ((4.0, 0), (6.0, 0), (3.1, 0), (4.0, 0.1))], 0, 5, 10, 13),
)
def test_windows_that_follow_their_samples_bound_every_schedule_of_the_box(name, window, late):
    """Any psd multipliers, any windows, any anchors: random schedules of the box see no more, by a plain scan."""
    rng = np.random.default_rng(2)
    A, C = MATRICES[name]
    case = DesignProblem(Plant(A, C), window, 4.0, 0.3, 4, np.zeros((0, 2)), np.zeros(0), (None,) * len(C), late=late)
    middle = np.array([0.0, 1.1, 1.9, 3.0])
    for width in (0.02, 0.2):
        zones = middle[:, None] + np.array([-width, width]) / 2 * (np.arange(4) > 0)[:, None]
        box = zones
        drawn = [rng.uniform(*box.T) for _ in range(6)]
        reached = max(window_sigma_scan(A, C, times, 4.0, window, places=0, late=late) for times in drawn)
        windows, roots, nu, _ = relax_local(case, box, reached)
        assert reached <= local_bound(case, box, windows, roots, nu) * (1 + 1e-9)
        every = tied_windows(case, box)
        for _ in range(3):
            chosen = every[rng.choice(len(every), 3, replace=False)]
            chosen[:, 3] = chosen[:, 0] + rng.integers(-2, 5, 3)
            roots = rng.normal(size=(3, len(A), 2))
            assert reached <= local_bound(case, box, chosen, roots, rng.uniform(0, 0.1, 4)) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("name", "late"), few([*((name, 0.0) for name in MATRICES), *((name, 0.1) for name in MATRICES)], 0, 1, 2, 3, 4)
)
def test_windows_that_follow_their_samples_are_exact_in_a_box_that_shrinks(name, late):
    A, C = MATRICES[name]
    case = DesignProblem(Plant(A, C), 4.0, 4.0, 0.3, 4, np.zeros((0, 2)), np.zeros(0), (None,) * len(C), late=late)
    times = np.array([0.0, 1.1, 1.9, 3.0])
    sigma = window_sigma_scan(A, C, times, 4.0, 4.0, places=0, late=late)
    excess = []
    for width in (2e-3, 1e-3):
        zones = times[:, None] + np.array([-width, width]) / 2 * (np.arange(4) > 0)[:, None]
        best = max(window_sigma_scan(A, C, t, 4.0, 4.0, places=0, late=late) for t in (times, zones[:, 0], zones[:, 1]))
        windows, roots, nu, _ = relax_local(case, zones, sigma)
        excess.append(local_bound(case, zones, windows, roots, nu) / best - 1)
    assert excess[1] <= 0.02  # at an arbitrary schedule the first order is left, and nothing else


def turning(speeds, outputs, seed=3):
    """Undamped oscillators in random coordinates."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(2 * len(speeds),) * 2))[0]
    return Q @ np.kron(np.diag(speeds), [[0.0, 1.0], [-1.0, 0.0]]) @ Q.T, rng.normal(size=(outputs, len(Q)))


def before_each_sample(A, C, times, period, window):
    """Gram matrices, in the state at time 0, of the windows [s_m, s_m + T) of sorted times, by definition."""
    every = (times + period * np.arange(int(np.ceil(window / period)) + 1)[:, None]).ravel()
    rows = [C @ expm(A * t) for t in every]
    held = [(every >= s - 1e-9) & (every < s + window - 1e-9) for s in times]
    return np.array([sum(c.T @ c for c, inside in zip(rows, each, strict=True) if inside) for each in held])


@pytest.mark.parametrize(("width", "window"), few(product([0.0, 0.3, 1.2], [4.0, 8.0]), 1, 2, 5))
def test_windows_before_each_sample_bound_every_schedule_of_the_box(window, width):
    """Any psd multipliers, zones that overlap: what a schedule of the box gives them is no more, and nearly that."""
    A, C = turning((0.7, 1.9, 2.6), 2)
    case = DesignProblem(Plant(A, C), window, 4.0, 0.3, 4, np.zeros((0, 2)), np.zeros(0), (None,) * 2)
    rng, middle = np.random.default_rng(1), np.array([0.0, 1.1, 1.9, 3.0])
    zones = middle[:, None] + np.array([-width, width]) / 2 * (np.arange(4) > 0)[:, None]
    grids = [times for times in rng.uniform(*zones.T, size=(60, 4)) if np.all(np.diff(times) > 0)]
    grams = [before_each_sample(A, C, times, 4.0, window) for times in [*grids, middle]]
    found = [relax_ordered(case, case.orthogonal_flow, zones, aim, Budget(None))[0] for aim in (0.5, 1.5)]
    roots = rng.normal(size=(3, 4, 6, 1))
    for Z in [*found, *(roots @ np.swapaxes(roots, 2, 3))]:
        Z = Z / np.trace(Z, axis1=1, axis2=2).sum()
        bound = ordered_bound(case, case.orthogonal_flow, Z, zones) ** 2
        sums = [np.einsum("mij,mij->", W, Z) for W in grams]
        assert max(sums) <= bound
        assert width or bound == pytest.approx(sums[-1], rel=2e-8)
    reached = max(np.linalg.eigvalsh(W)[:, 0].min() for W in grams)
    assert np.sqrt(reached) == pytest.approx(max(window_sigma_scan(A, C, t, 4.0, window) for t in [*grids, middle]))
    assert reached <= ordered_bound(case, case.orthogonal_flow, found[0], zones) ** 2 <= (1.001 + 3 * width) * reached


def test_a_bound_by_order_is_what_each_term_is_at_most_however_little_is_seen():
    """Frequencies that hardly differ: sigma^2 is a millionth of the rows, and between times nothing is left of them."""
    A, C = turning((1.0, 1.03, 1.06), 1)
    middle, zones = np.arange(6) * 0.7, np.arange(6)[:, None] * 0.7 + np.array([0.0, 0.3])
    case = DesignProblem(Plant(A, C), 4.5, 4.5, 0.1, 6, np.zeros((0, 2)), np.zeros(0), (None,))
    least = np.linalg.eigh(before_each_sample(A, C, middle, 4.5, 4.5))[1][:, :, :1]
    Z = least @ np.swapaxes(least, 1, 2) / 6

    def total(place, time):
        times = np.where(np.arange(6) == place, time, middle)
        return np.einsum("mij,mij->", Z, before_each_sample(A, C, times, 4.5, 4.5))

    most = [max(total(place, t) for t in np.linspace(*zones[place], 61)) for place in range(6)]
    known = sum(most) - 5 * total(0, 0.0)
    assert known < 1e-6 * np.sum(C**2)
    assert known <= ordered_bound(case, case.orthogonal_flow, Z, zones) ** 2 <= 1.002 * known


def fourteen_states(**changes):
    A, C = turning((0.5, 0.9, 1.3, 1.7, 2.1, 2.5, 2.9), 3)
    P = 2 * np.pi
    return replace(DesignProblem(Plant(A, C), P, P, 0.2, 7, np.zeros((0, 2)), np.zeros(0), (None,) * 3), **changes)


def test_bounds_by_order_close_in_on_the_best_schedule():
    case, reached = fourteen_states(), 1.1446  # by a design's search
    anything = BoundPart("placed", np.zeros(1), np.eye(14)[None] / 14).judged(case)
    bound = narrowed(case, UpperBound(anything.value, (anything,)), reached, 20)
    assert bound.method == "ordered"
    assert reached <= bound.value <= 1.01 * reached < 0.9 * anything.value
    assert bound.value_for(case) == pytest.approx(bound.value, rel=1e-12)
    assert replace(bound, parts=bound.parts[1:]).value_for(case) == np.inf
    rng = np.random.default_rng(0)
    drawn = np.array([random_schedule(rng, case.period, case.spacing, 7) for _ in range(500)])
    assert np.sqrt(case.orthogonal_flow.worst(drawn, case.mask(drawn))[0].max()) <= bound.value


def test_a_bound_by_order_needs_states_that_keep_their_size_and_samples_that_may_lie_anywhere():
    case = fourteen_states()
    whole = regions(case, "late")[0]
    part, cut = ordered_part(case, whole, "late", 0.0)
    assert whole[cut.place, 0] < cut.at < whole[cut.place, 1] == pytest.approx(whole[cut.place, 0] + cut.width)
    assert part.method == "ordered"
    assert part.value_for(case) == part.value < np.inf
    others = {
        "late": replace(case, late=0.01),
        "closed": replace(case, forbidden=np.array([[1.0, 1.5]])),
        "of one and a half periods": replace(case, window=1.5 * case.period),
        "damped": replace(case, plant=Plant(case.plant.A - 1e-3 * np.eye(14), case.plant.C)),
    }
    assert all(flow_of(other) is None and part.value_for(other) == np.inf for other in others.values()), others
    assert replace(part, weights=part.weights[1:]).value_for(case) == np.inf  # a window less than there are samples


def test_a_bound_of_a_state_that_is_hardly_seen_does_not_drown_in_rounding():
    """Seven samples that fill their period evenly are one schedule; forty digits say what it sees."""
    period, window = 1.653790634073867, 0.8268953170369335
    C = [[-0.0169938116788843, -0.7481702866843318, 0.7358671926519933]]
    requirement = Requirement(window=window, period=period, spacing=0.2362558048676953, samples=7)
    design = design_schedule(Plant(np.eye(3, k=1), C), requirement, starts=3, branches=8)
    with mp.workdps(40):
        h, c = mp.mpf(period) / 7, [mp.mpf(v) for v in C[0]]
        rows = [[c[0], c[0] * t + c[1], c[0] * t * t / 2 + c[1] * t + c[2]] for t in (h, 2 * h, 3 * h)]
        truth = float(min(mp.svd_r(mp.matrix(rows), compute_uv=False)))
    assert truth == pytest.approx(1.9333e-7, rel=1e-3)
    assert design.sigma <= truth * (1 + 1e-8)
    assert truth <= design.upper_bound <= truth * 1.01


def test_what_counts_of_samples_share_of_a_bound_is_worked_out_once(monkeypatch):
    """The same g to the last digit for six and for seven samples, and another one for another plant."""
    none = np.zeros((0, 2)), np.zeros(0), (None,)
    A, edges = np.array([[0.0, 1.0], [-1.37, 0.0]]), np.linspace(0.0, 4.0, 801)
    worked, ahead = [], bound.rows_ahead
    monkeypatch.setattr(bound, "rows_ahead", lambda *given: (worked.append(1), ahead(*given))[1])
    cases = [DesignProblem(Plant(a, np.eye(1, 2)), 4.0, 4.0, 0.08, k, *none) for a, k in ((A, 6), (A, 7), (2 * A, 7))]
    found, much = [], []
    for case in cases:
        found.append(bound.profile(case, np.zeros(1), np.eye(2)[None] / 2, edges))
        much.append(len(worked))
    assert 0 < much[0] == much[1] < much[2]
    assert all(np.array_equal(getattr(found[0], name), getattr(found[1], name)) for name in ("left", "right", "bend"))
    assert not np.allclose(found[1].left, found[2].left)


def test_a_peak_that_no_sample_meets_does_not_make_the_rest_coarse(monkeypatch):
    """Eight integrators: just after a sample g is a thousand times what all others bring, and no measure for these."""
    none = np.zeros((0, 2)), np.zeros(0), (None,)
    case = DesignProblem(Plant(np.eye(8, k=1), np.eye(1, 8)), 4.0, 4.0, 0.08, 10, *none)
    zones = tightened(case, origin_zones(case, "late"), "late")
    zones[1, 0], zones[2, 1] = 1.29 * 0.4, 2.04 * 0.4
    zones = tightened(case, zones, "late")
    found, _ = relax_zones(case, zones, np.mod(zones[:5, 1] + 1e-9, 4.0))
    at = {}
    for loose in (1e-5, bound._LOOSE, 0.0):
        monkeypatch.setattr(bound, "_LOOSE", loose)
        at[loose] = zone_bound(case, found.starts, found.Z, zones)
    first, used, finest = at.values()
    assert used <= finest * (1 + 1e-4)
    assert first >= finest * (1 + 1e-3)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"window": 9.0},
        {"fixed": (0.5, 2.5), "forbidden": ((3.0, 3.6),)},
        {"fixed": (0.0, 1.0, 2.0, 2.5, 3.2)},
        {"forbidden": ((0.3, 1.0), (1.3, 2.0), (2.3, 3.0), (3.3, 4.0)), "samples": 4},
    ],
    ids=["any", "longer window", "fixed and closed", "all fixed", "repeating hours"],
)
def test_relaxations_of_many_states_are_those_of_a_general_solver(monkeypatch, given):
    """Of any number of states: the same value, and weights and multipliers that are worth as much."""
    case = problem(**given)
    general = relax_placed(case)
    monkeypatch.setattr(relaxation, "MANY_STATES", 0)
    found = relax_placed(case)
    assert (found.record.name, general.record.name) == ("sampling_design", "Clarabel")
    assert found.value == pytest.approx(general.value, rel=1e-5)
    assert found.weights.sum() == pytest.approx(case.samples - case.fixed.size, abs=1e-6)
    shares = np.einsum("mij,ij->", found.Z, case.rows.N) * case.rows.unit
    assert shares == pytest.approx(1.0)
    values = [bound.placed_bound(case, each.starts, each.Z) for each in (found, general)]
    assert values[0] <= values[1] * (1 + 1e-5)


@pytest.mark.parametrize("side", few(["late", "early"], 1))
def test_zones_of_many_states_are_bounded_as_by_a_general_solver(monkeypatch, side):
    """The first sample's zone is a time, so that no weights lie inside all limits."""
    case = problem(samples=4)
    zones = regions(case, side)[0]
    general = zone_part(case, zones, side)[0].value
    monkeypatch.setattr(relaxation, "MANY_STATES", 0)
    assert zone_part(case, zones, side)[0].value <= general * (1 + 1e-4)


@pytest.mark.parametrize("given", [{}, {"late": 0.05}, {"window": 9.0}], ids=["exact", "late", "longer window"])
def test_how_many_matrices_are_held_at_once_changes_no_bound(monkeypatch, given):
    case = problem(**given)
    starts, Z = multipliers(case, np.random.default_rng(8), 4)
    whole = bound.placed_bound(case, starts, Z)
    monkeypatch.setattr(bound, "AT_ONCE", 0)
    assert bound.placed_bound(case, starts, Z) == pytest.approx(whole, rel=1e-12)
