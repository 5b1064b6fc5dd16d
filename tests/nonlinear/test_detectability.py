"""Inequality (16) along pairs: the sums against plain ones, where it is tight, where it fails."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear import thyroid
from sampling_design.nonlinear.detectability import check_detectability, ratios
from sampling_design.nonlinear.experiment import paper_weights
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.weights import NonlinearWeights
from tests.oracles import nonlinear as oracle

BOX = ([-1.0, -1.0], [1.0, 1.0])
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SCHEDULE = PeriodicSchedule([0.7, 1.6, 0.9])


def test_both_sides_are_those_of_plain_sums():
    rng = np.random.default_rng(5)
    times = np.array([0.0, 0.3, 0.5, 1.1, 2.0])
    x, w, v, y = (rng.standard_normal((5, k)) for k in (2, 1, 3, 3))
    sampled = np.array([True, False, True, True, False])
    measured = np.repeat(sampled[:, None], 3, axis=1)
    half = [rng.standard_normal((k, k)) for k in (2, 2, 1, 3, 3)]
    P1, P2, Qw, Qv, R = (a @ a.T + np.eye(len(a)) for a in half)
    found = ratios(times, x, w, v, y, measured, P1, NonlinearWeights(P2, Qw, Qv, R, 0.4))
    sides = oracle.inequality(times, x, w, v, y, sampled, P1, P2, Qw, R, Qv, 0.4)
    assert found == pytest.approx(sides[:, 1] / sides[:, 0], rel=1e-6)


@pytest.mark.long
def test_a_certificate_of_a_linear_plant_is_never_refuted():
    certificate = certify(OSCILLATOR, SCHEDULE)
    weights = {key: getattr(certificate, key) for key in ("P2", "Qw", "R", "Qv", "eta")}
    cost, P1 = CostFunction(**weights), certificate.P1
    found = check_detectability(from_linear(OSCILLATOR), SCHEDULE, BOX, cost=cost, P1=P1, duration=8.0, pairs=12)
    assert found.holds
    assert found.ratio >= 1.0
    assert found.claim.strength == "sampled"
    # of a linear plant the small differences say it all: what they ask for is what the certificate has
    assert found.least_lambda == pytest.approx(certificate.lam, rel=1e-5)
    assert 1.0 <= found.quiet_lambda <= found.least_lambda
    assert "not proof" in found.explain()


def test_what_is_seen_by_nothing_is_refuted_with_a_witness():
    # x' = x is not seen: |dx|^2 grows while the right side decays
    blind = NonlinearPlant(lambda x, u, w: [x[0] + w[0]], lambda x, u, v: [0 * x[0] + v[0]],
                           {"states": 1, "disturbances": 1, "outputs": 1})  # fmt: skip
    found = check_detectability(blind, SCHEDULE, ([-1.0], [1.0]), cost=CostFunction(eta=0.2), duration=3.0, pairs=3)
    assert not found.holds
    assert found.witness.t == pytest.approx(3.0)
    # Y' = (2 + eta) Y + 1 from 1, and without disturbance e^{(eta + 2) t}
    grown = np.exp(2.2 * 3.0)
    assert found.ratio == pytest.approx(1 / (grown + (grown - 1) / 2.2), rel=1e-6)
    assert found.quiet_lambda == pytest.approx(grown, rel=1e-6)
    assert found.least_lambda == pytest.approx(1 / found.ratio)
    assert found.least_lambda_time == pytest.approx(3.0)
    assert found.least_horizon() == pytest.approx(2 * np.log(2 / found.ratio) / 0.2)
    assert "does not hold with these weights" in found.explain()
    assert "evidence, not proof" in str(found)


def test_the_sets_are_taken_in_turn_and_the_worst_is_kept():
    seen = []
    found = check_detectability(
        from_linear(OSCILLATOR), SCHEDULE, BOX, cost=CostFunction(eta=0.1), duration=4.0, pairs=7,
        progress=lambda fraction, note: seen.append(fraction),
    )  # fmt: skip
    assert found.ratio == found.ratios.min()
    assert found.witness.start in (1, 2, 3)
    assert seen[-1] == 1.0


@pytest.mark.long
def test_the_same_generator_gives_the_same_evidence():
    twice = [
        check_detectability(
            from_linear(OSCILLATOR),
            SCHEDULE,
            BOX,
            cost=CostFunction(eta=0.1),
            duration=4.0,
            pairs=3,
            rng=np.random.default_rng(2),
        )
        for _ in range(2)
    ]
    assert np.array_equal(twice[0].ratios, twice[1].ratios)


@pytest.mark.long
def test_pairs_that_leave_the_set_are_left_out_and_counted():
    # from x > 0.5 the plant leaves its box within the time
    walk = NonlinearPlant(lambda x, u, w: [0.5 + 0 * x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1},
                          bounds={"states": (0.0, 1.0)})  # fmt: skip
    found = check_detectability(walk, SCHEDULE, cost=CostFunction(eta=0.1), duration=1.0, pairs=40)
    assert 0 < found.left_out < 40
    assert found.pairs == 40 - found.left_out
    assert "more left out" in str(found)
    with pytest.raises(ArgumentError, match=r"`pairs` must be at most 1000000: each takes milliseconds, got 10{18}"):
        check_detectability(walk, SCHEDULE, cost=CostFunction(eta=0.1), duration=1.0, pairs=1e18)
    with pytest.raises(ArgumentError, match="every pair left it"):
        check_detectability(walk, SCHEDULE, ([0.9], [1.0]), cost=CostFunction(eta=0.1), duration=1.0, pairs=3)
    burst = NonlinearPlant(lambda x, u, w: [x[0] ** 2], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1})
    with pytest.raises(ArgumentError, match="every pair left it"):
        check_detectability(burst, SCHEDULE, ([1.0], [2.0]), cost=CostFunction(eta=0.1), duration=2.0, pairs=1)


def test_bad_arguments_are_refused():
    plant = from_linear(OSCILLATOR)
    with pytest.raises(ArgumentError, match="`cost` must give a rate here"):
        check_detectability(plant, SCHEDULE, BOX, cost=CostFunction(), duration=1.0)
    with pytest.raises(ArgumentError, match=r"`x0` must be a finite box \(lower, upper\)"):
        check_detectability(plant, SCHEDULE, cost=CostFunction(eta=0.1), duration=1.0)
    with pytest.raises(ArgumentError, match="`pairs` must be a whole number of at least 1"):
        check_detectability(plant, SCHEDULE, BOX, cost=CostFunction(eta=0.1), duration=1.0, pairs=0)
    with pytest.raises(ArgumentError, match="`P1` must be positive definite"):
        check_detectability(plant, SCHEDULE, BOX, cost=CostFunction(eta=0.1), duration=1.0, P1=-np.eye(2))


def test_an_output_that_is_not_measured_says_nothing():
    """The inequality counts what the mask lets through: as with the output left out of the plant at those samples."""
    rng = np.random.default_rng(8)
    times = np.array([0.0, 0.4, 1.0, 1.7])
    x, w, v, y = (rng.standard_normal((4, k)) for k in (2, 1, 2, 2))
    half = [rng.standard_normal((k, k)) for k in (2, 2, 1, 2, 2)]
    P1, P2, Qw, Qv, R = (a @ a.T + np.eye(len(a)) for a in half)
    first = np.array([True, False, True, True])
    measured = np.stack([first, 0 * first], axis=1).astype(bool)
    found = ratios(times, x, w, v, y, measured, P1, NonlinearWeights(P2, Qw, Qv, R, 0.4))
    alone = [1 / np.linalg.inv(W)[:1, :1] for W in (Qv, R)]  # the covariance of what is measured, inverted
    sides = oracle.inequality(times, x, w, v[:, :1], y[:, :1], first, P1, P2, Qw, alone[1], alone[0], 0.4)
    assert found == pytest.approx(sides[:, 1] / sides[:, 0], rel=1e-6)


@pytest.mark.long
def test_a_mask_that_hides_an_output_gives_another_verdict():
    # x' = x; only the first output sees it, and it is never measured
    plant = NonlinearPlant(lambda x, u, w: [x[0] + w[0]], lambda x, u, v: [x[0] + v[0], v[1]],
                           {"states": 1, "disturbances": 1, "outputs": 2})  # fmt: skip
    cost = CostFunction(P2=[[1.0]], R=100 * np.eye(2), Qv=100 * np.eye(2), eta=0.2)
    given = {"x0": ([-1.0], [1.0]), "duration": 3.0, "pairs": 6, "cost": cost, "P1": [[0.1]]}
    hidden = check_detectability(plant, PeriodicSchedule([0.5], outputs=[[0, 1]]), **given)
    assert check_detectability(plant, PeriodicSchedule([0.5]), **given).holds
    assert not hidden.holds
    # nothing but the prior is left, and the disturbance
    grown = np.exp(2.2 * 3.0)
    assert hidden.ratio == pytest.approx(10 / (grown + (grown - 1) / 2.2), rel=1e-6)


def test_the_papers_weights_ask_for_a_lambda_that_random_pairs_miss():
    """At 6e-7 d, before any sample, a difference in T3_c has become one in TSH_c: lambda is at least 172.5."""
    plant, weights = thyroid.thyroid(), paper_weights()
    rest = plant.equilibrium(thyroid.TRUE_START, [0.0, 0.0])
    schedule = PeriodicSchedule([1.0], time_unit="d")
    options = {"cost": weights, "duration": 0.01, "dt": 0.001, "pairs": 1}
    found = check_detectability(plant, schedule, (0.999 * rest, 1.001 * rest), **options)
    assert found.quiet_lambda == pytest.approx(172.5, rel=2e-2)
    # one pair of trajectories shows it: the difference that grows most, small, and its weights before and after
    t, scale, P2 = 5.6e-7, thyroid.SCALING, np.diag([1.0, 5.0, 1.0, 1.0, 1.0, 1.0])
    base = simulate(plant, rest, [0.0, t])[-1]
    grown = (
        np.array([simulate(plant, rest + e / scale, [0.0, t])[-1] - base for e in 1e-3 * np.eye(6)]).T * scale[:, None]
    )
    square = float(np.linalg.eigvalsh(grown.T @ P2 @ grown / np.sqrt(np.outer(np.diag(P2), np.diag(P2))))[-1]) / 1e-6
    assert square == pytest.approx(found.quiet_lambda, rel=2e-2)
    assert found.least_lambda > 1e6  # with w read per second: Qw makes disturbances nearly free
    assert found.least_horizon() > 33.4


def test_too_many_pairs_and_pairs_that_leave_are_refused():
    given = {"cost": CostFunction(eta=0.1), "duration": 2.0}
    burst = NonlinearPlant(lambda x, u, w: [x[0] ** 2], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1})
    with pytest.raises(ArgumentError, match="`pairs` must be at most 1000000: each takes milliseconds"):
        check_detectability(burst, SCHEDULE, ([1.0], [2.0]), pairs=1e18, **given)
    with pytest.raises(ArgumentError, match="every pair left it"):
        check_detectability(burst, SCHEDULE, ([1.0], [2.0]), pairs=1, **given)


def test_a_budget_ends_the_study_after_some_of_its_pairs():
    plant, given = from_linear(OSCILLATOR), {"cost": CostFunction(eta=0.1), "duration": 2.0, "rng": 3}
    full = check_detectability(plant, SCHEDULE, BOX, pairs=6, **given)
    one = check_detectability(plant, SCHEDULE, BOX, pairs=10**6, budget=1e-9, **given)
    assert (one.pairs, one.left_out) == (1, 0)
    assert one.ratios == full.ratios[:1]
    with pytest.raises(ArgumentError, match=r"`budget` must be positive, got 0\.0"):
        check_detectability(plant, SCHEDULE, BOX, budget=0.0, **given)
