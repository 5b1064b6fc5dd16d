"""Law: no admissible schedule over all real times, however it is found, beats the proven upper bound."""

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds import branching
from sampling_design.design.bounds.branching import narrowed
from sampling_design.design.bounds.evidence import (
    UpperBound,
    alone_part,
    gap_bounded,
    local_part,
    placed_part,
    slow_part,
    slow_states,
    zone_part,
)
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.bounds.zones import regions
from sampling_design.design.problem.posing import pose
from sampling_design.plants.plant import Signals
from sampling_design.records.budget import ENDLESS
from tests.cases import few
from tests.oracles.design import best_on_grid, is_allowed, random_schedule, window_sigma_scan

OSCILLATOR = ([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
INTEGRATOR = ([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
PAIR = (
    [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, -2.0, 0.0]],
    [[1.0, 0.0, 1.0, 0.0]],
)
UNSTABLE = ([[2.0, 1.0], [0.0, 0.1]], [[1.0, 0.3]])


def designed(case, window, spacing, samples, **more):
    A, C = case
    return design_schedule(Plant(A, C), Requirement(window=window, spacing=spacing, samples=samples, **more), starts=4)


@pytest.mark.long
@pytest.mark.parametrize("case", [OSCILLATOR, INTEGRATOR, UNSTABLE])
def test_enumeration_of_a_grid_stays_below_the_bound_and_within_the_gap(case):
    A, C = case
    asked = Requirement(window=4.0, spacing=0.5, samples=3)
    design = design_schedule(Plant(A, C), asked, starts=4, branches=60)
    best, _ = best_on_grid(*case, 4.0, 4.0, 0.5, 3, 24)
    assert best <= design.upper_bound * (1 + 1e-9)
    assert best <= design.sigma_attained * (1 + 1e-6)
    assert design.sigma_attained <= design.upper_bound * (1 + 1e-9)


@pytest.mark.long
def test_enumeration_with_forbidden_and_fixed_times():
    rules = {"forbidden": [[0.5, 1.5]], "fixed": [0.0]}
    design = designed(OSCILLATOR, 4.0, 0.5, 3, **rules)
    best, times = best_on_grid(*OSCILLATOR, 4.0, 4.0, 0.5, 3, 24, **rules)
    assert is_allowed(times, 4.0, 0.5, **rules)
    assert best <= design.sigma_attained * (1 + 1e-6) <= design.upper_bound * (1 + 2e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("case", "window", "period", "samples"),
    [(PAIR, 4.0, 4.0, 8), (PAIR, 4.0, 3.0, 6), (OSCILLATOR, 3.0, 5.0, 7), (INTEGRATOR, 6.0, 4.0, 3)],
)
def test_random_schedules_stay_below_the_bound(case, window, period, samples):
    design = designed(case, window, 0.2, samples, period=period)
    rng = np.random.default_rng(3)
    draws = [random_schedule(rng, period, 0.2, samples) for _ in range(25)]
    reached = max(window_sigma_scan(*case, times, period, window, places=0) for times in draws)
    assert 0 < reached <= design.upper_bound
    assert reached <= design.sigma_attained * (1 + 1e-6)


def test_differential_evolution_beats_neither_the_bound_nor_the_schedule():
    design = designed(OSCILLATOR, 4.0, 0.3, 3)

    def cost(gaps):
        times = np.concatenate([[0.0], np.cumsum(0.3 + gaps * (4.0 - 0.9) / max(np.sum(gaps), 1.0))[:2]])
        return -window_sigma_scan(*OSCILLATOR, times, 4.0, 4.0, places=0)

    found = -differential_evolution(cost, [(0, 1)] * 3, seed=1, maxiter=12, popsize=8, polish=False).fun
    assert found <= design.upper_bound
    assert found <= design.sigma_attained * (1 + 1e-6)


def test_the_bound_is_tight_for_four_samples_on_the_oscillator():
    design = designed(OSCILLATOR, 2 * np.pi, 0.2, 4)
    assert design.upper_bound == pytest.approx(np.sqrt(2), rel=1e-6)
    assert design.sigma == pytest.approx(np.sqrt(2), rel=2e-3)


SPIRAL = ([[2.0, 1.5], [-1.5, 2.0]], [[1.0, 0.0]])
CLOSED = [[0.0, 0.3], [1.0, 1.3], [2.0, 2.3], [3.0, 3.3]]


@pytest.mark.long
@pytest.mark.parametrize(
    ("case", "window", "rules"),
    [
        (OSCILLATOR, 4.0, {}),
        (OSCILLATOR, 3.0, {"forbidden": [[0.5, 1.5]]}),
        (OSCILLATOR, 4.0, {"fixed": [0.0, 1.75]}),
        (INTEGRATOR, 3.0, {}),
        (INTEGRATOR, 4.0, {"forbidden": CLOSED}),
        (UNSTABLE, 4.0, {}),
        (UNSTABLE, 3.0, {"fixed": [0.5], "forbidden": [[1.0, 2.1]]}),
        (SPIRAL, 4.0, {}),
        (SPIRAL, 3.0, {"forbidden": [[0.5, 1.5]]}),
        (SPIRAL, 4.0, {"fixed": [0.0, 1.75]}),
    ],
)
def test_boxes_cut_again_and_again_stay_above_every_schedule_of_a_grid(monkeypatch, case, window, rules):
    requirement = Requirement(window=window, period=4.0, spacing=0.4, samples=3, **rules)
    problem = pose(Plant(*case), requirement, 3)
    first = UpperBound(np.inf, (placed_part(problem, relax_placed(problem)),))
    best, _ = best_on_grid(*case, 4.0, window, 0.4, 3, 16, **rules)
    monkeypatch.setattr("sampling_design.design.bounds.branching._MET", 0.0)
    loose, tight = (narrowed(problem, first, best, steps) for steps in (3, 7))
    assert best <= tight.value * (1 + 1e-9) <= loose.value * (1 + 2e-9)
    assert {part.method for part in tight.parts} <= {"zones", "local"}
    assert tight.value_for(problem) == pytest.approx(tight.value)
    assert UpperBound(tight.value, tight.parts[1:]).value_for(problem) == np.inf  # one box less covers too little


class Scripted:
    """A tree of boxes whose bound falls as it is told, a cut at a time."""

    budget, bound = ENDLESS, branching._ZoneBoxTree.bound

    def __init__(self, values):
        self.values, self.spent, self.parts = values, 0, ()

    @property
    def value(self):
        return self.values(self.spent)

    def cut(self):
        self.spent += 1
        return True


@pytest.mark.parametrize(
    ("falls", "cuts"),
    [
        (lambda done: 1.0 + 0.5 * 0.9**done, 27),  # wide at first: until it is within 3 %
        (lambda done: 1.02, 0),  # near enough
        (lambda done: 1.5 - 0.0001 * done, 40),  # hopeless: once more, and no more than that
        (lambda done: 1.3 - 0.0021 * done, 129),  # slow, and it helps
        (lambda done: 2.0 * 0.997**done, 150),  # for ever
    ],
)
def test_a_wide_gap_is_cut_on_as_long_as_that_helps(monkeypatch, falls, cuts):
    tree = Scripted(falls)
    monkeypatch.setattr(branching, "_rooted", lambda *given: tree)
    problem = pose(Plant(*OSCILLATOR), Requirement(window=4.0, period=4.0, spacing=0.4, samples=3), 3)
    found = narrowed(problem, UpperBound(np.inf, ()), 1.0, 20, most=150, near=0.03)
    assert tree.spent == cuts
    assert found.value == falls(cuts)


FAR_APART = ([[3.0, 1.0], [0.0, 0.02]], [[0.05, 1.0]])  # e^12 and e^.08 over a window of four


@pytest.mark.parametrize("rules", few([{}, {"forbidden": [[0.5, 1.5]]}, {"fixed": [0.0, 1.75]}], 2))
def test_states_that_grow_slowly_alone_bound_every_schedule(rules):
    requirement = Requirement(window=4.0, period=4.0, spacing=0.4, samples=3, **rules)
    problem = pose(Plant(*FAR_APART), requirement, 3)
    found = slow_part(problem)
    best, _ = best_on_grid(*FAR_APART, 4.0, 4.0, 0.4, 3, 16, **rules)
    assert best <= found.value * (1 + 1e-9)
    assert found.value_for(problem) == pytest.approx(found.value)
    least = 0.9999 * np.linalg.norm([1 / 2.98, 1.0])  # of such a state: its output is a constant that hardly grows
    assert found.value <= 1.02 * np.sqrt(3) * (1 - 0.05 / 2.98) * np.exp(0.08) / least


def test_modes_that_grow_alike_are_not_told_apart():
    for A, C in (SPIRAL, OSCILLATOR, INTEGRATOR, ([[2.0, 1.0], [0.0, 2.0]], [[1.0, 0.0]])):
        assert slow_part(pose(Plant(A, C), Requirement(window=9.0, period=4.0, spacing=0.4, samples=3), 3)) is None
    fast = pose(Plant(*FAR_APART), Requirement(window=4.0, period=4.0, spacing=0.4, samples=3), 3)
    assert np.allclose(np.abs(slow_states(fast)[:, 0]), np.array([1 / 2.98, 1.0]) / np.linalg.norm([1 / 2.98, 1.0]))


CONSTANTS = np.zeros((2, 2)), np.array([[1.0, 1.0], [0.0, 1.0]])  # every sample shows x1 + x2, and x2
"""|O x|^2 = 3 (x1 + x2)^2 + 3 x2^2 for three samples, wherever they lie: at least 3/2 x1^2 for every x2."""


def with_a_decaying_mode(A, C):
    return np.block([[A, np.zeros((2, 1))], [np.zeros((1, 2)), -1.0]]), np.hstack([C, [[1.0], [0.0]]])


@pytest.mark.parametrize(
    ("case", "scale"), [(CONSTANTS, 1.0), (with_a_decaying_mode(*CONSTANTS), 1.0), (CONSTANTS, 1e6)]
)
def test_sigma_of_rows_never_exceeds_its_bound_however_little_other_states_count(case, scale):
    n = len(case[0])
    states = Signals([f"x{k + 1}" for k in range(n)], scales=scale * np.arange(1.0, n + 1))
    plant = Plant(*case, states=states)
    design = design_schedule(plant, Requirement(window=4.0, samples=3, of="x1"), starts=1, branches=0)
    exact = np.sqrt(1.5) * scale
    assert design.sigma <= exact <= design.upper_bound <= 1.001 * exact
    assert design.bound.value_for(design.problem) == pytest.approx(design.upper_bound)


@pytest.mark.parametrize("method", ["placed", "alone", "gaps", "zones", "local"])
def test_multipliers_of_every_kind_bound_what_counts_alone(method):
    """The bound of all states, larger by what the state seen least holds of others: no multiplier says which counts."""
    samples = 1 if method == "alone" else 3
    requirement = Requirement(window=4.0, period=4.0, spacing=0.4, samples=samples)
    problem = pose(Plant(*CONSTANTS), requirement, samples)
    home = regions(problem, "late")[0]
    found = {
        "placed": lambda: placed_part(problem, relax_placed(problem)),
        "alone": lambda: alone_part(problem),
        "gaps": lambda: gap_bounded(problem, UpperBound(np.inf, ()), np.sqrt(samples)).parts[0],
        "zones": lambda: zone_part(problem, home, "late")[0],
        "local": lambda: local_part(problem, home, "late", np.sqrt(samples))[0],
    }[method]()
    assert found.method == method
    least = np.sqrt((3 - np.sqrt(5)) / 2 * samples)  # of C'C
    assert least * (1 - 1e-9) <= found.value
    counted = pose(Plant(*CONSTANTS), requirement, samples, counted=np.array([[1.0, 0.0]]))
    told = found.value_for(counted)
    assert np.sqrt(samples / 2) * (1 - 1e-9) <= told
    share = np.trace(found.weights[:, :1, :1].sum(axis=0)) / np.trace(found.weights.sum(axis=0))
    assert told == pytest.approx(found.value / np.sqrt(share), rel=1e-6 if method != "gaps" else 1e-2)
    nothing = pose(Plant(*CONSTANTS), requirement, samples, counted=np.array([[0.0, 0.0]]))
    assert found.value_for(nothing) == np.inf
