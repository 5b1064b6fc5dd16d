"""Whatever the bounds are, zero or apart by twenty-four decades, `validate` calls no promise broken that was kept.

`python -m tests.laws.test_no_size_of_a_bound_makes_validation_untrue 200` draws 200 plants.
"""

import sys
import warnings
from contextlib import suppress
from itertools import product

import mpmath
import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.monte_carlo import ratio
from sampling_design.validation.report import ROUNDING, ClaimCheck
from sampling_design.validation.scenario import ErrorSources, EstimatedRun, ScenarioBounds, draw_inputs, true_run
from sampling_design.validation.timeline import build_timeline
from tests.cases import few
from tests.rescale import Units

SIZES = [0.0, 0.0, 1e-12, 1e-6, 1.0, 1.0, 1e6, 1e12]
SCENARIOS = ("random", "worst", "initial", "constraints")


def drawn(seed):
    """A plant that does not grow, a schedule, bounds of any size and weights that know nothing of them."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    A = rng.normal(size=(n, n))
    A = A - A.T if rng.random() < 0.5 else A - 3 * np.eye(n)
    plant = sd.Plant(A, rng.normal(size=(p, n)), G=rng.normal(size=(n, 1)))
    times = np.cumsum(rng.uniform(0.1, 1.0, 6))
    bounds = {}
    for name, size in (("w_bound", 1), ("v_bound", p), ("initial_error", n)):
        most = float(rng.choice(SIZES))
        bounds[name] = most if rng.random() < 0.5 else most * rng.random(size)
    cost = CostFunction(P2=np.eye(n), eta=float(rng.choice([0.0, 0.2])), arrival=str(rng.choice(["fixed", "filtered"])))
    return plant, sd.Schedule(times), {**bounds, "cost": cost, "horizon": float(rng.choice([0.4, 2.0, 50.0]))}


def report_of(seed):
    """The report, any warning an error."""
    plant, schedule, given = drawn(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        return sd.validate(plant, schedule, runs=2, rng=seed, scenarios=SCENARIOS, **given)


@pytest.mark.parametrize("seed", few(range(24), 3))
def test_every_promise_is_kept_whatever_the_bounds(seed):
    report = report_of(seed)
    assert report.passed, [(check.claim, check.scenario, check.observed, check.note) for check in report.broken]
    given = drawn(seed)[2]
    most = max(float(np.max(given[name])) for name in ("w_bound", "v_bound", "initial_error"))
    widened = any("rounding hides the weights' units" in each for each in report.skipped)
    assert not widened or most > 1e6  # times what the weights take errors for


@pytest.mark.parametrize("seed", few(range(12), 9))
def test_units_change_nothing_that_is_observed(seed):
    plant, schedule, given = drawn(seed)
    rng = np.random.default_rng(seed)
    units = Units.drawn(rng, plant)
    sizes = {"w_bound": units.disturbances, "v_bound": units.outputs, "initial_error": units.states}
    bounds = {name: rng.uniform(0.1, 1.0, factor.size) for name, factor in sizes.items()}
    there = {name: bound * sizes[name] for name, bound in bounds.items()}
    options = {"runs": 2, "rng": seed, "scenarios": ("random", "resonant", "worst", "initial")}
    one, other = (
        sd.validate(
            each,
            times,
            horizon=2.0 * unit,
            cost=CostFunction(eta=0.2 / unit, arrival=given["cost"].arrival),
            **at,
            **options,
        )
        for each, times, unit, at in (
            (plant, schedule, 1.0, bounds),
            (units.plant(plant), units.schedule(schedule), units.time, there),
        )
    )
    assert len(one.checks) >= 4
    for here, far in zip(one.checks, other.checks, strict=True):
        assert far.observed == pytest.approx(here.observed, rel=1e-5, abs=1e-9), (here.claim, here.scenario)


SLOW = sd.Plant([[-0.3]], [[1.0]])
READ = sd.Measurements(SLOW, [0.5, 1.2, 1.7], np.zeros((3, 1)))
EVERY_HOUR = sd.PeriodicSchedule([0.7, 0.5])
VERBS = {
    "accuracy": lambda **bounds: sd.guaranteed_accuracy(SLOW, EVERY_HOUR.between(0.0, 3.0), **bounds).upper,
    "certify": lambda **bounds: sd.certify(SLOW, EVERY_HOUR, **bounds).P2,
    "filter": lambda **bounds: sd.KalmanFilter(SLOW, **bounds).run(READ).x,
    "set": lambda **bounds: sd.SetMembershipEstimator(SLOW, **bounds).run(READ).radii,
    "smoother": lambda **bounds: sd.KalmanFilter(SLOW, **bounds).smooth(READ).x,
    "interval": lambda **bounds: sd.state_interval(SLOW, READ, **bounds).upper,
}


@pytest.mark.parametrize(("verb", "name"), few(product(VERBS, ("w_bound", "v_bound", "initial_error")), 7, 10, 15))
def test_a_bound_of_any_size_gets_an_answer_or_one_sentence(verb, name):
    bounds = {"w_bound": 0.1, "v_bound": 0.2, "initial_error": 1.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for size in (1e-300, 1e300):
            with pytest.raises(ArgumentError, match=f"`{name}` must be 0 or lie between 1e-150 and 1e.150, or its sq"):
                VERBS[verb](**{**bounds, name: size})
        for size in (1e-150, 1e150):
            with suppress(sd.SamplingDesignError):
                assert np.isfinite(VERBS[verb](**{**bounds, name: size})).all()


def test_growth_beyond_all_numbers_is_neither_kept_nor_broken():
    plant, schedule = sd.Plant([[9.0]], [[1.0]]), sd.PeriodicSchedule([1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        unseen = sd.Plant([[9.0, 0.0], [0.0, -1.0]], [[0.0, 1.0]])
        report = sd.validate(unseen, schedule, horizon=2.0, runs=2, duration=90.0, scenarios=["random"])
        assert [check.verdict for check in report.checks] == ["NOT CHECKED"]
        assert "beyond all numbers" in report.checks[0].note
        with pytest.raises(ArgumentError, match="before the state grows beyond all numbers"):
            sd.validate(plant, schedule, estimator=sd.KalmanFilter(plant), runs=1, duration=90.0)
        fast = sd.Plant([[400.0]], [[1.0]])
        with pytest.raises(ArgumentError, match="must not leave the plant alone until it has grown beyond double"):
            sd.validate(fast, schedule, horizon=2.0, runs=1, duration=3.0, scenarios=["random"])


def test_what_a_simulated_truth_rounds_by_is_known_and_held_against_no_estimator():
    """It grows by e^90 before the first sample, in 47 cells; beside it, in fifty digits."""
    A = [[0.7104786023574754, 0.014372033553237074], [1.3216025941958287, 0.8070353380832443]]
    plant = sd.Plant(A, [[0.04, 0.32]])
    line = build_timeline(plant, sd.Schedule([100.3, 103.5]), 103.5)
    quiet = ErrorSources(np.array([[-1.0, 2.0]]), np.zeros((1, line.cells, 2)), np.zeros((1, 2, 1)))
    truth, at = true_run(line, quiet, steered=False), int(line.samples[0])
    with mpmath.workdps(50):
        exact = mpmath.expm(mpmath.matrix(A) * mpmath.mpf(float(line.times[at]))) * mpmath.matrix([1, -2])
        off = np.array([abs(float(mpmath.mpf(x) - y)) for x, y in zip(truth.states[at].tolist(), exact, strict=True)])
    assert (off <= truth.rounding[at]).all()
    assert (off > 1e-3 * truth.rounding[at]).all()
    near = Estimate(float(line.times[at]), truth.states[at] + off, np.diag((off / 4) ** 2), 1.0, certified=True)
    found = EstimatedRun((near,), truth.states[at : at + 1], truth.rounding[at : at + 1])
    assert near.ratio(truth.states[at]) > 1
    assert found.ratios[0] <= 1


def test_what_is_no_number_is_not_what_was_promised():
    found = ratio(np.array([0.0, 2.0, np.nan, np.inf, 0.0]), np.array([0.0, 4.0, 1.0, np.inf, np.nan]))
    assert np.array_equal(found, [0.0, 0.5, np.nan, np.nan, np.nan], equal_nan=True)
    check = ClaimCheck("a", "b", 1.0, np.nan, note="Why.")
    assert (check.verdict, check.note) == ("NOT CHECKED", "What was observed is beyond all numbers. Why.")


@pytest.mark.parametrize("decades", [0, 150])
def test_an_ellipsoid_that_is_flat_holds_what_lies_in_it(decades):
    unit = 10.0**decades
    flat = Estimate(0.0, np.zeros(3), np.diag([1.0, 0.0, 4.0]) + np.outer([0, 0, 1.0], [0, 0, 0.0]), 4.0)
    skew = Estimate(0.0, np.zeros(2), np.array([[1.0, 1.0], [1.0, 1.0]]) * unit**2, 4.0)
    assert flat.ratio([1.0, 0.0, 2.0]) == pytest.approx(0.5)
    assert flat.ratio([0.0, 1e-100, 0.0]) > 1e100
    assert skew.holds([unit, unit])
    assert skew.ratio([unit, unit]) == pytest.approx(0.25, rel=1e-6)
    assert not skew.holds([unit, -unit])
    assert np.isfinite(skew.Pi).all()
    assert Estimate(0.0, np.zeros(1), np.eye(1), 0.0).ratio([0.0]) == 0.0
    assert Estimate(0.0, np.zeros(1), np.eye(1), 0.0).ratio([1.0]) == np.inf


def test_a_schedule_that_ends_where_it_begins_names_itself():
    plant = sd.Plant([[-1.0]], [[1.0]])
    with pytest.raises(ArgumentError, match="`schedule` must have a sample after time 0"):
        sd.validate(plant, sd.Schedule([0.0]), horizon=1.0)


def test_growth_is_judged_only_where_it_can_have_settled():
    plant, bounds = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), {"w_bound": 0.1, "v_bound": 0.1}
    report = sd.validate(plant, sd.Schedule([0.3, 0.9]), estimator=sd.KalmanFilter(plant), runs=1, **bounds)
    assert not [check for check in report.checks if check.claim == "error does not grow"]
    assert "growth of the error (resonant): 2 samples, it settles in 40." in report.skipped
    own = sd.validate(plant, sd.Schedule([0.3, 0.9]), horizon=0.2, runs=1, scenarios=["resonant"], **bounds)
    assert "2 samples, without a certificate it settles in 40." in own.skipped[-1]


def test_growth_along_a_finite_schedule_is_judged_only_over_many_samples():
    """Its gaps may be longer in its second half: a certificate promises no more than its bound."""
    plant = sd.Plant([[0.1]], [[1.0]])
    for gaps in (np.full(12, 0.5), np.append(np.full(6, 0.2), np.full(6, 1.5))):
        schedule = sd.Schedule(np.cumsum(gaps))
        made = sd.certify(plant, schedule, eta=2.0, P2=[[1.0]])
        report = sd.validate(plant, schedule, made, runs=1, scenarios=["resonant"])
        assert report.passed
        assert report.skipped[-1].endswith("12 samples, on a finite schedule it settles in 40.")


@pytest.mark.parametrize(("slow", "by"), few(product([1e-9, 1e-3, 0.02], ["its own", "another"]), 1, 2, 5))
def test_growth_of_a_disturbance_that_is_slower_than_the_run_is_none_of_the_estimate(slow, by):
    """An eigenvalue turns as slowly as rounding has it: its sine is a ramp, and the error follows it."""
    plant = sd.Plant([[-0.3, slow], [-slow, -0.3]], [[1.0, 0.4]], G=[[1.0], [0.0]])
    schedule = sd.PeriodicSchedule([1.25])
    bounds = {"w_bound": 0.1, "v_bound": 0.2, "initial_error": 1.0, "runs": 1, "scenarios": ["resonant"]}
    made = sd.certify(plant, schedule, eta=0.24)
    report = sd.validate(plant, schedule, made, duration=60.0, **bounds)
    if by == "another":
        report = sd.validate(plant, schedule, estimator=sd.KalmanFilter(plant, made), duration=60.0, **bounds)
    assert report.passed
    assert "error does not grow" in [check.claim for check in report.checks]


@pytest.mark.parametrize("by", few(["its own", "another"], 0))
def test_growth_is_judged_only_where_samples_get_no_rarer(by):
    """Where gaps get ever longer the error of every estimator grows; in another order of the same gaps none does."""
    plant, gaps = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]), np.linspace(0.2, 2.5, 42)
    bounds = {"w_bound": 0.1, "v_bound": 0.05, "initial_error": 1.0, "runs": 1, "scenarios": ["resonant"]}
    way = {"horizon": 5.0} if by == "its own" else {"estimator": sd.KalmanFilter(plant)}
    longer = sd.validate(plant, sd.Schedule(np.cumsum(gaps)), **bounds, **way)
    assert "samples get rarer" in longer.skipped[-1]
    assert "error does not grow" not in [check.claim for check in longer.checks]
    for order in (np.append(np.arange(0, 42, 2), np.arange(1, 42, 2)), np.arange(42)[::-1]):
        report = sd.validate(plant, sd.Schedule(np.cumsum(gaps[order])), **bounds, **way)
        assert report.passed
        assert "error does not grow" in [check.claim for check in report.checks]


@pytest.mark.parametrize("place", few(range(12), 1, 4))
def test_rounding_that_adds_up_along_a_run_breaks_no_ellipsoid(place):
    """What nothing drives and decays is known ever better, and the flow's rounding has one sign at every step."""
    modes = np.array([[0.994637, -0.960112], [0.10343, 0.279616]])
    decay = 0.0757951 + 0.002 * place
    A = modes @ np.diag([0.0, -decay]) @ np.linalg.inv(modes)
    plant = sd.Plant(A, [[0.0391, -0.3308]], G=np.zeros((2, 0)))
    root = np.array([[1.4e4, 0.0], [-1.35e5, 13.6]])
    weights = {"P2": root @ root.T, "Qw": np.zeros((0, 0)), "R": [[1e4]], "Qv": [[1e4]], "eta": 0.0077}
    bounds = {"w_bound": 0.0, "v_bound": 0.0171, "initial_error": [0.2, 0.067]}
    cost = CostFunction(form="paper", **weights)
    estimator = sd.MovingHorizonEstimator(plant, horizon=190.0, cost=cost, **bounds)
    line = build_timeline(plant, sd.PeriodicSchedule([5.25874, 7.77063]), 400.0, 190.0)
    known = ScenarioBounds.of(plant, *bounds.values())
    errors = ErrorMap(line, estimator, known)
    runs = errors.apply(draw_inputs(line, known, np.random.SeedSequence(place).spawn(4)))
    assert np.nanmax(errors.ellipsoid_ratio(runs)) <= 1 + ROUNDING


def test_a_prior_holds_every_start_within_its_bound():
    """Its covariance is the inverse of a weight, which is known as well as that has digits."""
    for angle in np.linspace(0.05, 1.5, 30):
        turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        P2 = turned.T @ np.diag([1.0, 1e9]) @ turned
        cost = CostFunction(P2=P2, Qw=[[1.0]], R=[[1.0]], Qv=[[1.0]], eta=0.1)
        plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]], G=[[1.0], [1.0]])
        bounds = {"w_bound": 1.0, "v_bound": 1.0, "initial_error": [0.1, 0.2]}
        estimator = sd.MovingHorizonEstimator(plant, horizon=1.0, cost=cost, **bounds)
        for corner in ([0.1, 0.2], [0.1, -0.2]):
            assert estimator.predict(0.0).ratio(corner) <= 1.0


if __name__ == "__main__":
    broken = [seed for seed in range(int(sys.argv[1])) if not report_of(seed).passed]
    print(f"{sys.argv[1]} plants, not kept in {broken}")
