"""Units change nothing: each state, output, input and disturbance by its own power of ten, time by one, and its zero.

No decision changes (certified, on_schedule, status, checks that passed), and numbers only as their unit says. What is
a Euclidean norm over several units (a bound given as one number, the Euclidean error bound) is no question of units.
"""

import warnings
from functools import partial
from itertools import combinations, product

import numpy as np
import pytest

from sampling_design import (
    Constraints,
    KalmanFilter,
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    Schedule,
    certify,
    compare_schedule,
    simulate_record,
    state_interval,
    validate,
)
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.convex_set import ConvexSet, NormBall
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, build_weights
from sampling_design.estimators.online.estimator import GuaranteeWarning
from tests.benchmarks.baselines import standard_mhe
from tests.cases import few
from tests.rescale import Units

GAPS, SEEDS = np.array([0.5, 1.25, 0.75, 1.0, 0.25, 1.5]), range(3)
RELATIVE = 1e-6


def setting(seed, decades=12, time_decades=9):
    """A plant of three states with inputs, data and weights; and the same in other units."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) * 0.6 - 0.4 * np.eye(3)
    plant = Plant(
        A, rng.normal(size=(2, 3)), B=rng.normal(size=(3, 1)), D=rng.normal(size=(2, 1)), G=rng.normal(size=(3, 2))
    )
    units = Units.drawn(rng, plant, decades, time_decades)
    root = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    weights = {"P2": root @ root.T, "Qw": 4 * np.eye(2), "R": np.array([[8.0, 2.0], [2.0, 6.0]]), "Qv": 6 * np.eye(2)}
    other = {
        "P2": units.state_weight(weights["P2"]),
        "Qw": units.disturbance_weight(weights["Qw"]),
        "R": units.output_weight(weights["R"]),
        "Qv": units.output_weight(weights["Qv"]),
    }
    return plant, units, weights, other, rng


def box(units, low, high):
    return np.full(units.size, low) * units, np.full(units.size, high) * units


def ball(units, radius):
    """|z| <= radius in the old units."""
    whole, k = np.full(units.size, np.inf), units.size
    return ConvexSet(-whole, whole, None, None, (NormBall(radius, np.zeros(k), np.diag(1 / units)),))


KINDS = {
    "free": lambda u: {},
    "boxes": lambda u: {"constraints": Constraints(x=box(u.states, -0.3, 0.3), v=box(u.outputs, -0.2, 0.2))},
    "ball": lambda u: {"constraints": Constraints(x=ball(u.states, 0.4))},
    "half-space": lambda u: {"constraints": Constraints(x=ConvexSet.halfspaces([[1.0, -1.0, 0.5] / u.states], [0.1]))},
    "output box": lambda u: {"constraints": Constraints(y=box(u.outputs, -0.4, 0.4))},
    "disturbance box": lambda u: {"constraints": Constraints(w=box(u.disturbances, -0.1, 0.1))},
    "disturbance ball": lambda u: {"constraints": Constraints(w=ball(u.disturbances, 0.1))},
    "constant w": lambda u: {"constraints": Constraints(w=box(u.disturbances, -0.1, 0.1), w_model="constant")},
    "carried": lambda u: {"arrival": "filtered"},
    "from samples": lambda u: {"begins": "sample"},
    "paper": lambda u: {"form": "paper"},
    "between": lambda u: {"constraints": Constraints(x=box(u.states, -0.3, 0.3), check_spacing=0.3 * u.time)},
}


def same_estimate(a, b, units):
    assert (a.status, a.certified, a.on_schedule) == (b.status, b.certified, b.on_schedule), (a.note, b.note)
    spread = np.sqrt(np.diag(a.covariance))
    assert np.max(np.abs(b.x / units.states - a.x) / spread) < RELATIVE
    correlated = np.outer(spread, spread)
    assert np.max(np.abs(b.covariance / np.outer(units.states, units.states) - a.covariance) / correlated) < RELATIVE
    assert np.allclose(b.radius, a.radius, rtol=RELATIVE, atol=0, equal_nan=True)
    assert np.allclose(b.ellipsoid_radii / units.states, a.ellipsoid_radii, rtol=RELATIVE, atol=0, equal_nan=True)
    assert np.allclose(b.cost, a.cost, rtol=RELATIVE, atol=1e-9, equal_nan=True)
    if a.contradiction:
        assert b.contradiction._replace(t=0.0, factor=0.0) == a.contradiction._replace(t=0.0, factor=0.0)
        assert b.contradiction.factor == pytest.approx(a.contradiction.factor, rel=RELATIVE)
    return True


def followed(make, plant, units, weights, rng, eta):
    """Estimates at samples and ahead of them, for data in old units; one output is missing, one input changes."""
    c, found = units.time, []
    bounds = {
        "w_bound": np.full(2, 0.2) * units.disturbances,
        "v_bound": np.full(2, 0.4) * units.outputs,
        "initial_error": np.full(3, 0.8) * units.states,
    }
    estimator = make(units.plant(plant), units, weights | {"eta": eta / c}, prior_time=units.offset, **bounds)
    ys = 0.3 * rng.normal(size=(GAPS.size, 2))
    ys[2, 0], ys[4] = np.nan, ys[4] + 3.0
    for t, y in zip(np.cumsum(GAPS), ys, strict=True):
        u = [0.1 * t] * units.inputs if t > 2 else None
        found.append(estimator.update(units.offset + c * t, y * units.outputs, u))
        found.append(estimator.predict(units.offset + c * (t + 0.25)))
    return found


def moving_horizon(kind):
    """How an estimator of this kind is made in given units; what it chooses is a constraint or of the cost."""

    def make(plant, units, weights, **given):
        chosen = KINDS[kind](units)
        held = {key: chosen.pop(key) for key in ("constraints",) if key in chosen}
        cost = CostFunction(**weights, **chosen)
        return MovingHorizonEstimator(plant, horizon=3.0 * units.time, cost=cost, **held, **given)

    return make


def one(plant):
    return Units(np.ones(3), np.ones(2), np.ones(1), np.ones(2))


@pytest.mark.parametrize("kind", few(KINDS, 0, 1, 2))
def test_moving_horizon_estimates(kind):
    make = moving_horizon(kind)
    for seed in SEEDS:
        plant, units, weights, other, _ = setting(seed)
        plain = followed(make, plant, one(plant), weights, np.random.default_rng(seed), 0.3)
        moved = followed(make, plant, units, other, np.random.default_rng(seed), 0.3)
        for a, b in zip(plain, moved, strict=True):
            assert same_estimate(a, b, units)


@pytest.mark.parametrize("eta", [0.0, 0.4])
def test_filter_smoother_and_standard_estimator(eta):
    def standard(plant, units, weights, **given):
        return standard_mhe(plant, 0.5 * units.time, horizon=2.0 * units.time, cost=CostFunction(**weights), **given)[0]

    def kalman(plant, units, weights, **given):
        return KalmanFilter(plant, cost=CostFunction(**weights), **given)

    for seed in SEEDS:
        plant, units, weights, other, rng = setting(seed)
        for make in (kalman, standard):
            plain = followed(make, plant, one(plant), weights, np.random.default_rng(seed), eta)
            moved = followed(make, plant, units, other, np.random.default_rng(seed), eta)
            for a, b in zip(plain, moved, strict=True):
                assert same_estimate(a, b, units)
        ys, times = rng.normal(size=(GAPS.size, 2)), np.cumsum(GAPS)
        a = KalmanFilter(plant, cost=CostFunction(eta=eta, **weights)).smooth(
            [(t, y, None) for t, y in zip(times, ys, strict=True)]
        )
        there = KalmanFilter(units.plant(plant), cost=CostFunction(eta=eta / units.time, **other))
        b = there.smooth([(units.time * t, y * units.outputs, None) for t, y in zip(times, ys, strict=True)])
        spread = np.sqrt(np.einsum("kii->ki", a.covariance))
        assert np.max(np.abs(b.x / units.states - a.x) / spread) < RELATIVE


@pytest.mark.parametrize(("kind", "offset"), few(product(KINDS, [1.7e9, 1.7e9 + 86400.0]), 0, 2, 6, 12, 16, 18))
def test_the_clocks_zero(kind, offset):
    make = moving_horizon(kind)
    plant, _, weights, _, _ = setting(1)
    shifted = Units(np.ones(3), np.ones(2), np.ones(1), np.ones(2), offset=offset)
    plain = followed(make, plant, one(plant), weights, np.random.default_rng(1), 0.3)
    moved = followed(make, plant, shifted, weights, np.random.default_rng(1), 0.3)
    for a, b in zip(plain, moved, strict=True):
        assert same_estimate(a, b, shifted)


@pytest.mark.long
def test_certificates_schedules_validation_and_records():
    for seed in range(3):
        plant, units, weights, other, _ = setting(seed)
        schedule, c = PeriodicSchedule(GAPS), units.time
        there, moved = units.plant(plant), units.schedule(schedule)
        certificate = certify(plant, schedule, eta=0.2, **weights)
        same = certify(there, moved, eta=0.2 / c, **other)
        times = schedule.between(0.0, 20.0).times.copy()
        times[5:] += 0.01
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GuaranteeWarning)
            flags = [
                [each.update(f * t, [0.0, 0.0]).on_schedule for t in times]
                for each, f in (
                    (MovingHorizonEstimator(plant, certificate), 1.0),
                    (MovingHorizonEstimator(there, same), c),
                )
            ]
        assert flags[0] == flags[1]
        assert flags[0][:6] == [True] * 5 + [False]
        bounds = {"w_bound": np.full(2, 0.2), "v_bound": np.full(2, 0.4), "initial_error": np.full(3, 0.8)}
        scaled = {
            "w_bound": bounds["w_bound"] * units.disturbances,
            "v_bound": bounds["v_bound"] * units.outputs,
            "initial_error": bounds["initial_error"] * units.states,
        }
        options = {"runs": 6, "scenarios": ["pairs", "random", "worst", "resonant", "initial", "estimator"]}
        a = validate(plant, schedule, certificate, duration=12.0, **bounds, **options)
        b = validate(there, moved, same, duration=12.0 * c, **scaled, **options)
        assert [(f.claim, f.scenario, f.passed) for f in a.checks] == [
            (f.claim, f.scenario, f.passed) for f in b.checks
        ]
        for one_finding, other_finding in zip(a.checks, b.checks, strict=True):
            if one_finding.claim not in ("Euclidean error bound", "difference to the linear error map"):
                assert other_finding.observed == pytest.approx(one_finding.observed, rel=1e-5), one_finding.claim
        record = {"w_bound": bounds["w_bound"], "v_bound": bounds["v_bound"]}
        x = simulate_record(plant, schedule, 12.0, x0=np.ones(3), **record).states
        y = simulate_record(there, moved, 12.0 * c, x0=units.states, **{k: scaled[k] for k in record}).states
        assert np.max(np.abs(y / units.states - x)) < RELATIVE * np.abs(x).max()


@pytest.mark.parametrize(("c", "offset"), [(1e-9, 0.0), (1e9, 0.0), (1.0, 1.7e9)])
def test_planned_against_actual_times(c, offset):
    plant, plan = setting(2)[0], np.cumsum(GAPS)
    taken = np.delete(plan, 3) + np.array([0.01, -0.02, 0.0, 0.03, 0.0])
    units = Units(np.ones(3), np.ones(2), np.ones(1), np.ones(2), time=c, offset=offset)
    a = compare_schedule(plant, Schedule(plan), taken, 2.0, budget=2.0)
    b = compare_schedule(units.plant(plant), units.schedule(Schedule(plan)), offset + c * taken, 2.0 * c, budget=2.0)
    assert a.match.tolist() == b.match.tolist()
    assert np.allclose(b.deviations, c * a.deviations, rtol=RELATIVE, atol=1e-6 * c, equal_nan=True)
    assert (a.kept is None) == (b.kept is None)


@pytest.mark.parametrize("kind", few(["free", "boxes", "disturbance ball"], 0))
def test_intervals(kind):
    make = moving_horizon(kind)
    for seed in SEEDS:
        plant, units, weights, other, _ = setting(seed)
        plain = followed(make, plant, one(plant), weights, np.random.default_rng(seed), 0.3)[6:8]
        moved = followed(make, plant, units, other, np.random.default_rng(seed), 0.3)[6:8]
        for a, b in zip(plain, moved, strict=True):
            mine, theirs = a.interval(), b.interval()
            assert theirs.contradiction == pytest.approx(mine.contradiction, rel=RELATIVE)
            for end in ("lower", "upper"):
                off = getattr(theirs, end) / units.states - getattr(mine, end)
                assert mine.contradiction or np.max(np.abs(off) / mine.radii) < RELATIVE, (seed, end)
            assert theirs.verify()


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("time", [1e-6, 60.0, 1e8])
def test_the_unit_of_time_changes_no_estimate_of_integrators(order, time):
    """An integrator has no rate of its own: bounds weigh over the time in which w moves an output by its noise."""
    rng, chain = np.random.default_rng(order), np.diag(np.ones(order - 1), 1)
    plant = Plant(chain, np.eye(1, order), G=np.eye(order)[:, -1:])
    ys = rng.normal(size=(GAPS.size, 1))

    def followed_in(units):
        bounds = {"w_bound": [0.3] * units.disturbances, "v_bound": [0.4] * units.outputs}
        filtered = KalmanFilter(units.plant(plant), initial_error=np.full(order, 2.0) * units.states, **bounds)
        return [
            filtered.update(units.time * t, y * units.outputs) for t, y in zip(np.cumsum(GAPS), ys, strict=True)
        ]  # fmt: skip

    here = Units(np.ones(order), np.ones(1), np.ones(0), np.ones(1))
    there = Units(np.ones(order), np.ones(1), np.ones(0), np.ones(1), time)
    for a, b in zip(followed_in(here), followed_in(there), strict=True):
        assert same_estimate(a, b, there)


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("time", [1e-8, 1.0, 1e8])
def test_integrators_in_mixed_states_are_integrators(order, time):
    """Rounding leaves them eigenvalues of a thousandth, which say nothing of how fast they are."""
    rng, chain = np.random.default_rng(order), np.diag(np.ones(order - 1), 1)
    T = np.linalg.qr(rng.normal(size=(order, order)))[0]
    ys = rng.normal(size=(GAPS.size, 1))

    def followed_in(turn, unit):
        plant = Plant(turn @ chain @ turn.T / unit, turn.T[:1], G=turn[:, -1:] / unit)
        found = KalmanFilter(plant, w_bound=0.3, v_bound=0.4, initial_error=2.0)
        return [found.update(unit * t, y) for t, y in zip(np.cumsum(GAPS), ys, strict=True)]

    for here, there in zip(followed_in(np.eye(order), 1.0), followed_in(T, time), strict=True):
        assert T.T @ there.x == pytest.approx(here.x, rel=RELATIVE, abs=RELATIVE)
        assert T.T @ there.covariance @ T == pytest.approx(here.covariance, rel=RELATIVE, abs=RELATIVE)


@pytest.mark.parametrize(("order", "coupling", "size"), [(3, 1e200, 1.0), (3, 1e-200, 1.0), (1, 1.0, 1e140)])
def test_integrators_of_any_size_have_weights(order, coupling, size):
    """Powers of A and quotients of bounds leave the doubles, the weights that rest on them do not."""
    plant = Plant(np.diag(np.full(order - 1, coupling), 1), np.eye(1, order), G=np.eye(order)[:, -1:])
    bounds = {"w_bound": [size], "v_bound": [1 / size], "initial_error": np.ones(order)}
    weights = build_weights(plant, None, CostFunction(), bounds)
    assert 0 < float(weights.w[0, 0]) < np.inf


def refusal(ask):
    """What an ArgumentError says; "" where there is an answer."""
    try:
        ask()
    except ArgumentError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("one", "other"), few(product((0, 60, 140), (-140, -60, 0, 60)), 1, 8))
def test_sizes_far_apart_are_computed_with_or_refused_in_a_sentence(one, other):
    """Two sizes that each have a square may have none together, in whatever matrix or bound they stand."""
    for pair in combinations(("C", "G", "w_bound", "v_bound", "initial_error"), 2):
        size = dict.fromkeys(("C", "G", "w_bound", "v_bound", "initial_error"), 1.0)
        size |= {pair[0]: 10.0**one, pair[1]: 10.0**other}
        plant = Plant([[0.1, 1.0], [-1.0, -0.2]], size.pop("C") * np.array([[1.0, 0.3]]), G=size.pop("G") * np.eye(2))
        rows = [(t, [size["v_bound"]], None) for t in (0.0, 1.0, 1.5)]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            said = refusal(partial(state_interval, plant, rows, **size))
            said += refusal(partial(lambda plant, size, rows: KalmanFilter(plant, **size).run(rows), plant, size, rows))
        assert not said or ("must be nearer to each other" in said and max(abs(one + other), abs(one - other)) > 150)
