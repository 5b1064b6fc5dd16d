"""Cells of times: what they prove holds of every schedule, nearly as much as there is, and no more."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.observability.worst_case import spaced_times
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import search_worst, worst_of
from sampling_design.observability.worst_case.spaced_sphere import prove_worst
from sampling_design.observability.worst_case.spaced_tables import SphereTables
from sampling_design.observability.worst_case.spaced_times import has_few_times, prove_by_times
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.benchmarks.bench_worst_case import random_plant
from tests.cases import few
from tests.design.test_rounding import PLANTS
from tests.oracles.filters import matrix
from tests.oracles.worst_case import from_steps, is_admissible, sigma_of_times

PAIRS = np.kron(np.diag([1.0, 2.0, 3.0]), [[0.0, 1.0], [-1.0, 0.0]])
CASES = {
    "chain of five": (np.eye(5, k=1), np.eye(1, 5), 4.0, 7, 0.3),
    "three pairs": (PAIRS, np.tile([[1.0, 0.0]], 3), 4.0, 8, 0.3),
    "two outputs": (PAIRS - np.diag([0, 0, 0.3, 0.3, 0.9, 0.9]), np.tile(np.eye(2), 3), 4.0, 5, 0.3),
    "random": (*(np.random.default_rng(5).standard_normal(shape) for shape in ((6, 6), (1, 6))), 4.0, 8, 0.3),
}


def searched(name):
    A, C, window, count, spacing = CASES[name]
    rows = SpacedRows(Plant(A, C), window, count, spacing)
    return rows, search_worst(rows, np.random.default_rng(0))


def bounds_of(rows, found, forgiven=0.002):
    tables = SphereTables(rows, found.slacks, forgiven)
    return spaced_times._CellBounds(rows, *rows.within(tables.inverse), forgiven)


def narrow_cells(rows, slacks, wide):
    """One cell around each of the starts and slacks (m, k), `wide` points to each side as far as there are any."""
    finest = spaced_times._FINEST
    start = np.rint(slacks[:, 0] / rows.slack * finest).astype(int)
    at = np.rint(slacks / rows.slack * finest).astype(int) - start[:, None]
    first, last = np.clip(at - wide, 0, finest), np.clip(at + wide, 0, finest)
    first[:, 0] = last[:, 0] = 0
    early, late = np.clip(start - wide, 0, finest), np.clip(start + wide, 0, finest)
    return spaced_times.TimeWindows(first, last, early, late, np.ones(len(at)))


def sigma_in_digits(A, C, times):
    """Sigma of one schedule in 60 digits."""
    with mpmath.workdps(60):
        rows = [matrix(C) * mpmath.expm(matrix(A) * mpmath.mpf(float(t)), method="taylor") for t in times]
        gram = mpmath.zeros(len(A))
        for row in rows:
            gram += row.T * row
        return float(mpmath.sqrt(mpmath.eigsy(gram, eigvals_only=True)[0]))


def sigma_at_the_first_sample(rows, start, slacks):
    """Sigma of the window's start, each exponential by itself."""
    return sigma_of_times(rows.A, rows.C, np.minimum(start + slacks + rows.offsets, rows.window))


@pytest.mark.parametrize("name", few(CASES, 1))
def test_what_is_proven_of_a_cell_holds_of_all_that_is_in_it(name):
    rows, found = searched(name)
    bounds = bounds_of(rows, found)
    rng, proven = np.random.default_rng(1), 0
    slacks = np.sort(rng.uniform(0, rows.slack, (12, rows.count)), axis=1)
    for wide in (8, 60):
        cells = narrow_cells(rows, slacks, wide)
        for mu in found.sigma**2 * np.array([1.0, 4.0, 16.0, 64.0]):
            done, sure, *_ = bounds.of(cells, mu, 4.0 * mu)
            assert not np.any(sure & ~done)
            proven += int(np.sum(done))
            for i in np.flatnonzero(done):
                for _ in range(2):
                    inside = np.sort(rng.integers(cells.first[i], cells.last[i] + 1))
                    start = min(rng.integers(cells.earliest[i], cells.latest[i] + 1), spaced_times._FINEST - inside[-1])
                    least = sigma_at_the_first_sample(rows, bounds.slacks[start], bounds.slacks[inside])
                    assert least**2 >= mu * (4.0 if sure[i] else 1.0) * (1 - bounds.forgiven)
    assert proven > 20


@pytest.mark.parametrize("name", few(CASES, 0))
def test_a_cell_of_one_schedule_proves_nearly_its_sigma_and_no_more(name):
    rows, found = searched(name)
    bounds = bounds_of(rows, found)
    point = narrow_cells(rows, found.slacks[None], 0)
    sigma = sigma_at_the_first_sample(rows, bounds.slacks[point.earliest[0]], bounds.slacks[point.first[0]])
    below, above = (sigma**2 * (1 + sign * 1e-6) for sign in (-1, 1))
    done, sure, *_ = bounds.of(point, below, above)
    assert done.all()
    assert not sure.any()
    assert not bounds.of(point, above, above)[0].any()


@pytest.mark.parametrize("name", few(CASES, 0, 2))
def test_no_schedule_that_is_drawn_is_below_the_bound(name):
    A, C, window, count, spacing = CASES[name]
    found = worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), rtol=0.2)
    assert (found.status, found.method) == ("closed", "branch and bound over times")
    assert 0.8 * found.upper <= found.lower < found.upper
    assert found.upper == pytest.approx(sigma_of_times(A, C, found.witness), rel=1e-6)
    rng, slack = np.random.default_rng(2), window - (count - 1) * spacing
    near = (found.witness - spacing * np.arange(count)) / slack
    for wide in (0.01, 0.1, 1.0):
        for _ in range(6):
            times = from_steps(near + wide * rng.standard_normal(count), window, count, spacing)
            assert is_admissible(times, window, spacing)
            assert sigma_of_times(A, C, times) >= found.lower


@pytest.mark.parametrize("name", few(list(CASES)[:1] + list(CASES)[2:3], 1))
def test_times_and_directions_prove_the_same(name):
    rows, found = searched(name)
    by_times, by_directions = (prove(rows, found, 0.2, 60.0) for prove in (prove_by_times, prove_worst))
    assert by_times.status == by_directions.status == "closed"
    assert by_times.lower == pytest.approx(by_directions.lower, rel=0.2)


def test_a_schedule_that_is_not_the_worst_raises_no_bound():
    rows, true = searched("two outputs")
    even = worst_of(rows, np.linspace(0, rows.slack, rows.count)[None])
    assert even.sigma > 1.5 * true.sigma
    proof = prove_by_times(rows, even, 0.1, 60.0)
    assert proof.status == "closed"
    assert proof.lower <= true.sigma * (1 + 1e-9)
    assert proof.attained.sigma == pytest.approx(true.sigma, rel=0.1)


@pytest.mark.parametrize(("states", "time"), few([(1.0, 1e-9), (1e6, 1e6), (1e-12, 1e12)], 2))
def test_units_change_no_bound(states, time):
    A, C, window, count, spacing = CASES["two outputs"]
    as_it_is = worst_case_sigma(Plant(A, C), SpacedWindows(window, count, spacing), rtol=0.2)
    rule = SpacedWindows(window * time, count, spacing * time)
    scaled = worst_case_sigma(Plant(A / time, C * states), rule, rtol=0.2)
    assert scaled.closed
    assert scaled.lower == pytest.approx(as_it_is.lower * states, rel=1e-3)


def test_an_interrupt_leaves_the_stage_that_all_cells_have_passed(monkeypatch):
    rows, found = searched("two outputs")
    stages, stepped = [], spaced_times._TimeSearch._stepped

    def rung(search, budget, progress):
        stages.append(search.stage)
        if search.stage == 1:
            raise KeyboardInterrupt
        return stepped(search, budget, progress)

    monkeypatch.setattr(spaced_times._TimeSearch, "_stepped", rung)
    left = prove_by_times(rows, found, 0.2, 60.0)
    assert left.status == "interrupted"
    assert 0.19 * found.sigma < left.lower < 0.25 * found.sigma
    monkeypatch.setattr(spaced_times, "_MOST_CELLS", 0)
    monkeypatch.setattr(spaced_times._TimeSearch, "_stepped", stepped)
    crowded = prove_by_times(rows, found, 0.2, 60.0)
    assert (crowded.status, crowded.lower) == ("budget", 0.0)


def test_where_times_do_not_serve_directions_do():
    slow = SpacedRows(Plant(PAIRS, CASES["three pairs"][1]), 4.0, 8, 1e-4)
    many = SpacedRows(Plant(PAIRS, CASES["three pairs"][1]), 40.0, 13, 1.0)
    assert not has_few_times(slow)
    assert not has_few_times(many)
    A = np.diag([8.0, 1.0, 0.0, -1.0, -8.0])  # e^{At} spans e^64: no state is carried back
    steep = SpacedRows(Plant(A, np.ones((5, 5))), 4.0, 3, 0.3)
    assert has_few_times(steep)
    assert prove_by_times(steep, search_worst(steep, np.random.default_rng(0)), 0.2, 1.0) is None


def test_growth_within_a_window_of_starts_is_no_less_than_it_is():
    rows, found = searched("random")
    stretch = bounds_of(rows, found).stretch
    for point in (0, 1, 7, 300, 2048):  # half of the grid: nothing in a window lies farther from its middle
        for s in np.linspace(-1, 1, 7) * point / 4096 * rows.slack:
            assert np.linalg.norm(expm(rows.A * s), 2) ** 2 <= stretch[point] * (1 + 1e-12)


STEEP = random_plant(8, 3)  # an eigenvalue of 4.4 beside what is hardly seen: growth of 1e7 over the window


def test_what_grows_costs_the_other_states_no_digits():
    """|C||e^{At}| alone would leave sigma, 6e-5, an error of 2e-4."""
    rows = SpacedRows(Plant(*STEEP), 4.0, 10, 0.3)
    slacks = np.full(10, rows.slack)
    exact = sigma_in_digits(*STEEP, rows.times(slacks))
    assert exact == pytest.approx(6.0122e-5, rel=1e-4)
    assert np.linalg.norm(rows.blur(rows.plant.transition(rows.times(slacks)))) > 3 * exact
    sigma = worst_of(rows, slacks[None]).sigma
    assert abs(sigma - exact) <= rows.rounding(slacks) < 1e-4 * exact
    assert not rows.counts_as_zero(sigma, slacks)


@pytest.mark.parametrize("name", few([*PLANTS, "steep"], 0, 2))
def test_rows_in_coordinates_that_see_alike_are_as_exact_as_they_say(name):
    plant, window = PLANTS.get(name, (Plant(*STEEP), 4.0))
    rows = SpacedRows(plant, window, max(8, plant.n_states), window / 20)
    slacks = np.linspace(0.0, rows.slack, rows.count)
    _, inverse = rows.coordinates(slacks)
    inner, back = rows.within(inverse)
    times = inner.times(slacks)[[0, 3, -1]]
    allowed = inner.blur(inner.plant.transition(times))
    with mpmath.workdps(80):
        R = matrix(np.linalg.qr(inverse, mode="r"))
        true = mpmath.inverse(R)
        assert mpmath.norm(true - matrix(back)) <= 1e-15 * mpmath.norm(true)
        for t, seen, most in zip(times, inner.at(times), allowed, strict=True):
            exact = matrix(plant.C) * mpmath.expm(matrix(plant.A) * mpmath.mpf(float(t)), method="taylor") * true
            assert mpmath.norm(exact - matrix(seen)) <= most


def test_coordinates_that_lose_every_digit_leave_sigma_below_rounding():
    plant, window = PLANTS["growth e^100 beside an oscillator"]
    rows = SpacedRows(plant, window, 8, window / 20)
    slacks = np.linspace(0.0, rows.slack, rows.count)
    assert rows.counts_as_zero(worst_of(rows, slacks[None]).sigma, slacks)
    beyond = SpacedRows(Plant(np.diag([140.0, 0.0]), [[1.0, 1.0]]), 1.0, 2, 0.3)  # e^{At} overflows in coordinates of z
    assert beyond.within(np.diag([1e-200, 1e120])) is None


@pytest.mark.long
@pytest.mark.parametrize("seed", [8, 0])
def test_eight_states_close(seed):
    found = worst_case_sigma(Plant(*random_plant(8, seed)), SpacedWindows(4.0, 10, 0.3), rtol=0.2, budget=None)
    assert (found.status, found.method) == ("closed", "branch and bound over times")
    assert 0.8 * found.upper <= found.lower < found.upper
    assert found.upper == pytest.approx(sigma_in_digits(*random_plant(8, seed), found.witness), rel=1e-4)
