"""Law: what windows that follow each sample see in the mean, weighed by the gaps, is below the bound by gaps."""

from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.design.bounds.evidence import UpperBound, gap_bounded
from sampling_design.design.bounds.relaxation import sigma_of_moved
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.posing import split_for
from tests.benchmarks.design_bounds import PROBLEMS
from tests.cases import few
from tests.oracles.design import mean_after_samples, random_schedule, window_sigma_scan

ORBIT = (  # of a satellite beside another, seen from there: radial and along the track
    np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [3.0, 0.0, 0.0, 2.0], [0.0, 0.0, -2.0, 0.0]]),
    np.eye(2, 4),
)
TURN = 2 * np.pi
OSCILLATOR = (np.array([[0.0, 1.3], [-1.3, 0.0]]), np.array([[1.0, 0.3]]))
FADING = (np.array([[-0.3, 1.0, 0.0], [0.0, -0.2, 0.5], [0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.2]]))
INTEGRATORS = (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]]))


def posed(case, window, period, samples, spacing, late=0.0):
    A, C = case
    none = (None,) * len(C)
    return DesignProblem(Plant(A, C), window, period, spacing, samples, np.zeros((0, 2)), np.zeros(0), none, late=late)


def bounded(problem, aim):
    """The bound by gaps near an aim, from nothing that is known."""
    return gap_bounded(problem, UpperBound(np.inf, ()), aim)


def even(problem):
    return np.arange(problem.samples) * (problem.period / problem.samples)


def reached(problem, times):
    return sigma_of_moved(problem, times, problem.mask(times))


def every_order(short, long):
    """Words of so many gaps 0 and 1: of those that are turns of each other the first one, and how many they are."""
    words = [word for word in map("".join, product("01", repeat=short + long)) if word.count("1") == long]
    return Counter(min(word[turn:] + word[:turn] for turn in range(short + long)) for word in words)


def least_of_mixture(A, C, window, lengths, orders, known=1, judged=1):
    """Sigma that windows (s, s + T] after each sample s have in the mean of orders of gaps.

    Orders are words of places in `lengths`, and how often each, with all its turns. Samples after which the first
    `known` gaps are the same are taken together: the window after each, and those after the next ones, `judged` in all.
    """
    words = np.array([[int(kind) for kind in word] for word in orders])
    samples = words.shape[1]
    kinds = np.concatenate([np.roll(words, -turn, axis=1) for turn in range(samples)])
    often = np.tile(list(orders.values()), samples)
    r = np.round(np.cumsum(np.array(lengths)[kinds], axis=1), 12)
    assert np.ptp(r[:, -1]) == 0  # of one period
    lags, lag = np.unique(r, return_inverse=True)
    rows = C @ expm(A * lags[:, None, None])
    grams = np.einsum("tpi,tpj->tij", rows, rows) * (lags <= window * (1 + 1e-12))[:, None, None]
    _, begun = np.unique(kinds[:, :known], axis=0, return_inverse=True)
    least = np.inf
    for each, later in product(range(begun.max() + 1), range(judged)):
        mine = begun.ravel() == each
        share = np.repeat(often[mine] / often[mine].sum(), samples)
        seen = np.roll(lag.reshape(r.shape), -later * len(words), axis=0)[mine]
        mean = np.tensordot(np.bincount(seen.ravel(), share, lags.size), grams, 1)
        least = min(least, float(np.linalg.eigvalsh(mean)[0]))
    return np.sqrt(least)


CASES = [
    (ORBIT, TURN, TURN, 7, 0.1, 0.0),
    (OSCILLATOR, 4.0, 4.0, 5, 0.2, 0.05),
    (FADING, 4.5, 3.0, 4, 0.1, 0.0),
    (INTEGRATORS, 2.3, 4.0, 6, 0.3, 0.0),
    (FADING, 6.0, 3.0, 3, 0.4, 0.1),
    (OSCILLATOR, 3.0, 3.0, 2, 0.01, 0.0),
]


@pytest.mark.parametrize("number", few(range(6), 0, 2))
def test_every_schedule_is_below_its_mean_and_that_below_the_bound(number):
    case = (A, C), window, period, samples, spacing, late = CASES[number]
    problem = posed(*case)
    bound = bounded(problem, reached(problem, even(problem)))
    (part,) = bound.parts
    rng = np.random.default_rng(4)
    drawn = [even(problem), *(random_schedule(rng, period, spacing, samples) for _ in range(8))]
    for times in drawn:
        mean = mean_after_samples(A, C, times, period, window, part.starts, part.weights, late)
        assert reached(problem, times) <= np.sqrt(mean) * (1 + 1e-9)
        assert np.sqrt(mean) <= bound.value
    for many in range(1, samples if late == 0 else 0):  # a mixture of schedules is below the bound, too
        short = (spacing + period / samples) / 2
        long = (period - many * short) / (samples - many)
        assert least_of_mixture(A, C, window, (short, long), every_order(many, samples - many)) <= bound.value
    least = window_sigma_scan(A, C, drawn[1], period, window, places=0)
    assert least <= np.sqrt(mean_after_samples(A, C, drawn[1], period, window, part.starts, part.weights))


GROWING = (np.array([[0.4, 1.3], [-1.3, 0.2]]), np.array([[1.0, 0.3]]))


@pytest.mark.parametrize(
    ("window", "period", "late"),
    few([(*each, late) for each in [(3.0, 4.0), (4.0, 4.0), (6.0, 3.0)] for late in [0.0, 0.05]], 1, 2, 4),
)
def test_what_closes_just_after_a_sample_hides_no_window(window, period, late):
    rng = np.random.default_rng(0)
    times = random_schedule(rng, period, 0.4, 4)
    alone = window_sigma_scan(*GROWING, times, period, window, places=0, late=late)
    assert alone > 0.01
    for closes in times + period * np.array([[1e-13], [2.5e-10], [1e-9], [3e-9]]):
        for each in closes:
            hours = np.array([[each, each + 0.3]])
            problem = replace(posed(GROWING, window, period, 4, 0.4, late), forbidden=hours)
            assert reached(problem, times) == pytest.approx(alone, rel=1e-9)


@cache
def four_outputs():
    plant, requirement = PROBLEMS["20 of 40 states, 4 outputs"]
    return split_for(plant, requirement).retained, requirement.window


TWO_GAPS = {
    "0000011111": 1, "0000110111": 3, "0000111011": 3, "0001110011": 3,
    "0010010111": 2, "0010011101": 2, "0010110011": 1, "0101010101": 1,
}  # fmt: skip
"""Orders of five short gaps and five long ones, and how often each: whoever knows three gaps cannot tell them apart."""
THREE_GAPS = {
    "0010121212": 5, "0012101212": 1, "0020021212": 8, "0020121112": 20, "0020212012": 19,
    "0021101212": 31, "0021111112": 5, "0021121012": 23, "0021200212": 20, "0021211111": 16,
    "0021212101": 9, "0101211121": 73, "0102120121": 16, "0110112121": 12, "0110121112": 5,
    "0110121211": 25, "0110211121": 83, "0120120121": 9, "0120121021": 12, "0121012111": 99,
    "0121111021": 72, "1111111111": 15,
}  # fmt: skip
"""Of three gaps: whoever knows two of them cannot, in whatever windows."""


@pytest.mark.parametrize(
    ("known", "judged", "short", "orders", "left", "share"),
    [
        (1, 1, 0.512, every_order(5, 5), 2.568, 0.92),
        (2, 1, 0.54, every_order(5, 5), 2.527, 0.936),
        (3, 1, 0.515, TWO_GAPS, 2.525, 0.936),
        (2, 10, 0.448, THREE_GAPS, 2.489, 0.95),
    ],
)
def test_no_bound_by_gaps_comes_near_four_outputs_of_twenty_states(known, judged, short, orders, left, share):
    """The problem of `docs/design_bounds.md`: what such bounds leave open, whatever their multipliers.

    Of those that weigh the window after a sample by the next gap alone, as here, by the next two and the next three,
    and of those that weigh all ten windows by any two gaps.
    """
    part, T = four_outputs()
    lengths = np.linspace(short, T / 5 - short, 1 + max(int(kind) for word in orders for kind in word))
    mixed = least_of_mixture(part.A, part.C, T, lengths, orders, known, judged)
    assert mixed == pytest.approx(left, abs=5e-4)
    assert share * mixed > 2.3625  # than which no search found more


@pytest.mark.parametrize("number", few(range(6), 3))
def test_any_function_of_distances_and_any_psd_weights_prove_a_bound(number):
    case = (A, C), window, period, samples, spacing, late = CASES[number]
    problem, rng = posed(*case), np.random.default_rng(5)
    (part,) = bounded(problem, reached(problem, even(problem))).parts
    roots = rng.normal(size=(*part.weights.shape[:2], 2))
    others = [
        replace(part, tilt=part.tilt + rng.normal(scale=0.1 * np.abs(part.tilt).max(), size=part.tilt.size)),
        replace(part, weights=roots @ np.swapaxes(roots, 1, 2)),
    ]
    for other in others:
        value = other.value_for(problem)
        assert part.value <= value < np.inf
        for _ in range(4):
            times = random_schedule(rng, period, spacing, samples)
            assert mean_after_samples(A, C, times, period, window, part.starts, other.weights, late) <= value**2


@pytest.mark.parametrize("late", [0.0, 0.006])
def test_equal_gaps_are_proven_best_for_a_satellite_beside_another(late):
    problem = posed(ORBIT, TURN, TURN, 12, 0.07, late)
    known = reached(problem, even(problem))
    assert known <= bounded(problem, known).value <= 1.005 * known


def test_the_bound_is_the_same_in_any_unit_of_time():
    (A, C), *lengths, samples, spacing, late = CASES[2]
    one = posed((A, C), *lengths, samples, spacing, late)
    aim = reached(one, even(one))
    other = posed((10 * A, C), *(length / 10 for length in lengths), samples, spacing / 10, late / 10)
    assert reached(other, even(other)) == pytest.approx(aim, rel=1e-9)
    assert bounded(other, aim).value == pytest.approx(bounded(one, aim).value, rel=1e-3)


def test_multipliers_that_leave_a_gap_out_prove_nothing():
    problem = posed(*CASES[1])
    bound = bounded(problem, reached(problem, even(problem)))
    (part,) = bound.parts
    assert bound.value_for(problem) == part.value
    finer = problem.period / (problem.samples * (part.tilt.size // problem.samples)) * np.arange(40_000)
    wrong = [
        replace(part, starts=part.starts[1:], weights=part.weights[1:]),
        replace(part, starts=part.starts[:-1], weights=part.weights[:-1]),
        replace(part, starts=part.starts[::-1]),
        replace(part, starts=part.starts * 1.01),
        replace(part, starts=finer, weights=np.ones((finer.size, 1, 1)) * part.weights[0]),
        replace(part, tilt=part.tilt[:-1]),
        replace(part, tilt=np.zeros(part.tilt.size * 10**5)),
        replace(part, weights=part.weights - 0.01 * np.eye(2)),
        replace(part, weights=part.weights * (np.arange(len(part.weights)) != 3)[:, None, None]),
    ]
    assert [each.value_for(problem) for each in wrong] == [np.inf] * len(wrong)
    fixed = replace(problem, fixed=np.array([0.0]))
    assert part.value_for(fixed) == np.inf  # gaps do not say all of a schedule there
    assert bounded(fixed, 1.0).value == np.inf
    assert bounded(problem, 0.0).value == np.inf


def test_where_there_is_one_gap_alone_the_bound_stands():
    problem = posed(OSCILLATOR, 2.4, 3.0, 3, 1.0 - 1e-12)
    alone, sigma = replace(problem, spacing=1.0), reached(problem, even(problem))
    found = bounded(problem, sigma)
    assert sigma <= found.value_for(alone) <= found.value * (1 + 1e-9) < 2 * sigma
