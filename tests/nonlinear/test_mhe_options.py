"""What the nonlinear estimator does beyond the paper's scheme: grids, weights, limits, inputs, outliers."""

import pickle
import re
import warnings

import casadi
import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear.collocation import Collocation, OutlierRejection, WindowSolver
from sampling_design.nonlinear.examples import stirred_reactor
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.weights import ScaleWarning
from tests.cases import few
from tests.nonlinear.likely import likely_cost

SIZES = {"states": 2, "disturbances": 1, "outputs": 1}


def swinging(stiffness):
    return NonlinearPlant(
        lambda x, u, w: [x[1], -stiffness * casadi.sin(x[0]) + w[0]], lambda x, u, v: [x[0] + v[0]], SIZES
    )


FAST = swinging(24.5)
SURE = CostFunction(Qw=[[1e6]], R=[[1e4]], Qv=[[1e4]], eta=0.05)


def last_error(times, **options):
    truth = simulate(FAST, [1.0, 0.0], times)
    scheme = NonlinearMovingHorizonEstimator(FAST, horizon=40.0, cost=SURE, prior=[0.9, 0.1], **options)
    found = scheme.run((t, x[:1]) for t, x in zip(times, truth, strict=True))
    return scheme, found, np.abs(found.x - truth).max(axis=1)


@pytest.mark.long
def test_a_grid_that_is_too_coarse_is_refined():
    # horizon 40 s, so pieces of 2/3 s: three radians of the swing each
    times = np.arange(0.0, 6.0)
    _, _, coarse = last_error(times, collocation=Collocation(accuracy=None))
    scheme, found, fine = last_error(times)
    assert coarse.max() > 3.0
    assert fine[1:].max() < 2e-3
    assert set(found.status) == {"ok"}
    assert "discretisation" not in "".join(found.notes)
    assert scheme.search.degree > 2
    assert all(solve.error <= 0.01 for solve in scheme.solves)
    assert scheme.solves[-1].degree == scheme.search.degree


@pytest.mark.long
def test_a_grid_that_stays_too_coarse_is_named():
    scheme, found, _ = last_error([0.0, 16.0], collocation=Collocation(w_step=16.0))
    assert scheme.search.halvings == 3
    assert found.status[-1] == "ok"
    assert "The discretisation costs" in found.notes[-1]
    assert "choose a shorter horizon or w_step" in found.notes[-1]


@pytest.mark.parametrize("scale", few([1.0, 0.1, 1e-6, 1e6], 1, 2))
@pytest.mark.parametrize("boxed", [False, True])
def test_weights_of_outputs_and_noises_meet_in_the_same_coordinates(scale, boxed):
    # x stands still: (300^-1 + 600^-1)^-1 = 200 = 2 P2, so that a measurement of 1 meets the prior 0 half way
    signals = {"noises": sd.plants.Signals(("v",), (), [scale])}
    plant = NonlinearPlant(
        lambda x, u, w: [0.0 * x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1}, signals=signals
    )
    if boxed:
        plant = plant.with_bounds(noises=(-9.0, 9.0))
    cost = CostFunction(R=[[300.0]], Qv=[[300.0]], P2=[[100.0]])
    assert NonlinearMovingHorizonEstimator(plant, horizon=1.0, cost=cost).update(0.0, [1.0]).x == pytest.approx(
        [0.5], abs=1e-6
    )


OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]])
MOMENTS = np.array([0.4, 1.0, 1.9, 2.6, 3.1, 4.0])


def weighed(form, arrival="fixed", begins="horizon"):
    return CostFunction([[2.0, 0.3], [0.3, 1.0]], [[3.0]], [[40.0]], [[30.0]], 0.2, form, arrival, begins)


def paired(form, arrival, horizon=2.5, begins="horizon"):
    linear = sd.MovingHorizonEstimator(OSCILLATOR, horizon=horizon, cost=weighed(form, arrival, begins))
    bent = NonlinearMovingHorizonEstimator(
        from_linear(OSCILLATOR), horizon=horizon, cost=weighed(form, arrival, begins), collocation=Collocation(0.1, 3),
        solver=WindowSolver(1e-11),
    )  # fmt: skip
    data = [(t, [np.cos(t) + 0.1 * np.sin(9 * t)]) for t in MOMENTS.tolist()]
    return [(scheme.run(data), scheme.predict(4.7)) for scheme in (linear, bent)], bent


@pytest.mark.parametrize(
    ("form", "arrival", "begins"),
    few(
        [
            ("paper", "fixed", "horizon"),
            ("certificate", "fixed", "horizon"),
            ("certificate", "filtered", "horizon"),
            ("paper", "fixed", "sample"),
            ("certificate", "fixed", "sample"),
        ],
        0,
        2,
        4,
    ),
)
def test_covariance_and_arrival_are_those_of_the_linear_estimator(form, arrival, begins):
    ((one, ahead), (other, beyond)), _ = paired(form, arrival, begins=begins)
    np.testing.assert_allclose(other.x, one.x, atol=1e-3)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-2, atol=1e-5)
    assert beyond.x == pytest.approx(ahead.x, abs=1e-3)
    # no radius bounds the linear prediction, so its covariance is the one that flows with the discount
    np.testing.assert_allclose(beyond.covariance, ahead.covariance, rtol=1e-2, atol=1e-5)


@pytest.mark.long
def test_the_smoothed_window_is_in_units_and_knows_the_samples_after():
    _, scheme = paired("certificate", "fixed")
    window = scheme.smoothed()
    assert window.times[0] == pytest.approx(1.5)
    assert window.x[-1] == pytest.approx(scheme.state.last.x)
    np.testing.assert_allclose(window.covariance[-1], scheme.predict(scheme.state.last.t).covariance, rtol=1e-9)
    assert np.isfinite(window.residuals[:, 0]).sum() == 4
    assert window.outputs[:, 0] == pytest.approx(window.x[:, 0])
    # a Gaussian posterior by brute force: all states at the edges, w with its intensity on each piece
    edges, n = window.times, 2
    size = n * edges.size
    information = np.zeros((size, size))
    weights, eta, end = weighed("certificate"), 0.2, edges[-1]
    information[:n, :n] += np.exp(-eta * (end - edges[0])) * np.asarray(weights.P2)
    fit = 1 / (1 / 40.0 + 1 / 30.0)
    for k, t in enumerate(edges):
        if np.isfinite(window.residuals[k, 0]):
            information[n * k, n * k] += fit * np.exp(-eta * (end - t))
        if k:
            h = t - edges[k - 1]
            F, B = OSCILLATOR.transition(h), np.array([1 - np.cos(h), np.sin(h)])
            area = (1 - np.exp(-eta * h)) / eta * np.exp(-eta * (end - t))
            Q = np.outer(B, B) / (3.0 * area) + 1e-9 * np.eye(n)
            J = np.hstack([-F, np.eye(n)])
            at = slice(n * (k - 1), n * (k + 1))
            information[at, at] += J.T @ np.linalg.solve(Q, J)
    posterior = np.linalg.inv(information)
    for k in (0, 5, edges.size - 1):
        own = posterior[n * k : n * k + n, n * k : n * k + n]
        np.testing.assert_allclose(window.covariance[k], own, rtol=2e-3, atol=1e-5)
    assert "at its end" in window.explain()
    assert window.to_frame().shape == (edges.size, 5)
    assert "x1 deviation" in window.to_frame()
    assert window.to_xarray()["covariance"].shape == (edges.size, n, n)
    assert "pieces" in str(window)
    with pytest.raises(ArgumentError, match="`smoothed` needs a solved window"):
        NonlinearMovingHorizonEstimator(FAST, horizon=1.0).smoothed()


def test_limits_hold_at_the_points_of_the_program():
    # a point on a circle: without the limit the noise pulls it outside
    ring = NonlinearPlant(
        lambda x, u, w: [-x[1], x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 2, "outputs": 1},
        limits=lambda x, u: [x[0] ** 2 + x[1] ** 2 - 1.0],
    )  # fmt: skip
    data = [(t, [1.3 * np.cos(t)]) for t in (0.0, 0.5, 1.2, 2.0)]
    options = {"horizon": 3.0, "prior": [0.6, 0.0], "cost": CostFunction(R=[[400.0]], Qv=[[400.0]])}
    free = NonlinearMovingHorizonEstimator(ring.with_bounds(states=None), **options)
    assert np.linalg.norm(free.run(data).x[-1]) <= 1 + 1e-6
    x = free.search.window.point.z.reshape(-1, 2)
    assert (x**2).sum(axis=1).max() == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(ArgumentError, match="`prior` must keep the plant's limits, got limit 1 = 3"):
        NonlinearMovingHorizonEstimator(ring, horizon=3.0, prior=[2.0, 0.0])
    with pytest.raises(ArgumentError, match="`limits` fails for symbols"):
        NonlinearPlant(lambda x, u, w: [x[0]], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1}, limits=lambda x: x)


def test_a_plant_that_varies_in_time_is_estimated_as_one_with_a_clock():
    # Mathieu's equation, and the same with time as a third state
    times, shift = np.array([0.0, 0.7, 1.5, 2.6, 3.1]), 100.0
    timed = NonlinearPlant(
        lambda x, u, w, t: [x[1], -(1 + 0.6 * casadi.cos(t)) * x[0] + w[0]],
        lambda x, u, v, t: [x[0] + v[0] + 0 * t], SIZES,
    )  # fmt: skip
    clock = NonlinearPlant(
        lambda x, u, w: [x[1], -(1 + 0.6 * casadi.cos(x[2])) * x[0] + w[0], 1.0], lambda x, u, v: [x[0] + v[0]],
        {**SIZES, "states": 3},
    )  # fmt: skip
    assert timed.varies
    assert not clock.varies
    one, other = simulate(timed, [1.0, 0.0], shift + times), simulate(clock, [1.0, 0.0, shift], shift + times)
    np.testing.assert_allclose(one, other[:, :2], atol=1e-8)
    data = [(shift + t, x[:1] + 0.1) for t, x in zip(times, one, strict=True)]
    cost = CostFunction(P2=np.eye(2), R=[[40.0]])
    known = CostFunction(P2=np.diag([1.0, 1.0, 1e6]), R=[[40.0]])
    options = {"horizon": 9.0, "prior_time": shift, "collocation": Collocation(0.3, 4)}
    found = NonlinearMovingHorizonEstimator(timed, cost=cost, **options).run(data)
    same = NonlinearMovingHorizonEstimator(clock, cost=known, prior=[0, 0, shift], **options).run(data)
    np.testing.assert_allclose(found.x, same.x[:, :2], atol=1e-6)
    assert timed.linearise([0.0, 0.0], t=0.0).A.tolist() == [[0.0, 1.0], [-1.6, 0.0]]
    with pytest.raises(ArgumentError, match="`plant` must not vary in time here: `dynamics` depends on t"):
        timed.f_casadi  # noqa: B018
    again = pickle.loads(pickle.dumps(timed))
    assert again.varies
    assert again.f([1.0, 0.0], t=1.0).tolist() == timed.f([1.0, 0.0], t=1.0).tolist()


def test_inputs_may_run_straight_between_the_times_they_are_given():
    pushed = NonlinearPlant(lambda x, u, w: [x[1], u[0]], lambda x, u, v: [x[0] + v[0]], {**SIZES, "inputs": 1})
    times, u = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [2.0], [0.0]])
    truth = simulate(pushed, [0.0, 0.0], times, u=u, input_between="linear")
    assert truth[-1] == pytest.approx([2.0, 2.0])  # t^3/3 to 1/3 and 1, then a triangle down
    scheme = NonlinearMovingHorizonEstimator(pushed, horizon=5.0, collocation=Collocation(0.5, 3, inputs="linear"))
    found = scheme.run((t, x[:1], row) for t, x, row in zip(times, truth, u, strict=True))
    assert found.x == pytest.approx(truth, abs=1e-6)
    assert found.cost[-1] == pytest.approx(0.0, abs=1e-12)
    assert not any("Assumes" in each.note for each in found)
    assumed = r"Assumes that the input has kept its value since t = 2, when it was last given\."
    late = scheme.predict(3.0)  # the input may have gone anywhere by then: it is said what the state is of
    assert re.search(assumed, late.note)
    assert late.x == pytest.approx([4.0, 2.0], abs=1e-6)
    assert re.search(assumed, scheme.update(3.0, [4.0]).note)
    assert "Assumes" not in scheme.update(4.0, [6.0], [0.0]).note
    assert "Assumes" not in scheme.predict(3.5).note
    held = NonlinearMovingHorizonEstimator(pushed, horizon=5.0, collocation=Collocation(0.5, 3))
    assert held.run((t, x[:1], row) for t, x, row in zip(times, truth, u, strict=True)).cost[-1] > 1e-3
    with pytest.raises(ArgumentError, match='`input_between` must be "held" or "linear"'):
        simulate(pushed, [0.0, 0.0], times, u=u, input_between="bent")


SLOW = swinging(1.0)
SPREAD = {"prior": [0.3, 0.3], "v": [0.02], "w": [0.05]}


def spoiled(**options):
    times = np.arange(0.0, 6.1, 0.6)
    truth = simulate(SLOW, [0.8, 0.0], times)
    noise = 0.02 * np.random.default_rng(4).standard_normal(times.size)
    y = truth[:, 0] + noise
    y[6] += 1.5
    scheme = NonlinearMovingHorizonEstimator(
        SLOW, horizon=3.0, prior=[0.8, 0.0], cost=likely_cost(**SPREAD),
        collocation=Collocation(0.6, 3), **options,
    )  # fmt: skip
    found = scheme.run(zip(times, y[:, None], strict=True))
    return found, np.abs(found.x - truth).max(axis=1)


@pytest.mark.long
def test_an_outlier_spoils_only_the_plain_estimate():
    _, plain = spoiled()
    _, robust = spoiled(outliers=OutlierRejection(huber=1.5))
    gated, left_out = spoiled(outliers=OutlierRejection(gate=5.0))
    assert plain[6:].max() > 0.4
    assert robust[6:].max() < 0.15
    assert left_out[6:].max() < 0.06
    assert gated.notes[6].startswith("Left out as an outlier: y1 (beyond 5 standard deviations")
    assert all("outlier" not in note for k, note in enumerate(gated.notes) if k != 6)


def test_a_gate_gives_in_where_the_estimate_is_what_is_off():
    scheme = NonlinearMovingHorizonEstimator(
        SLOW, horizon=3.0, prior=[2.5, 0.0], cost=likely_cost(**{**SPREAD, "prior": [0.05, 0.05]}),
        outliers=OutlierRejection(gate=4.0, patience=2), collocation=Collocation(0.5, 3),
    )  # fmt: skip
    times = np.arange(0.0, 2.1, 0.5)
    truth = simulate(SLOW, [0.8, 0.0], times)
    found = scheme.run(zip(times[1:], truth[1:, :1], strict=True))
    assert ["outlier" in note for note in found.notes[:3]] == [True, True, False]
    assert OutlierRejection().explain() == "Every residual counts by its square."
    assert "gate" in str(OutlierRejection(gate=4.0))
    with pytest.raises(ArgumentError, match="`huber` must be positive"):
        OutlierRejection(huber=0.0)


def test_other_starts_find_what_the_first_one_misses():
    # h = x^3 - 3x = 10 at 2.61; from the left it ends at -1, where h is flat
    well = NonlinearPlant(
        lambda x, u, w: [0.0 * x[0]], lambda x, u, v: [x[0] ** 3 - 3 * x[0] + v[0]], {"states": 1, "outputs": 1}
    )
    found = {}
    for starts in (0, 2):
        scheme = NonlinearMovingHorizonEstimator(
            well, horizon=1.0, prior=[-2.0], collocation=Collocation(0.5), solver=WindowSolver(starts=starts),
            cost=likely_cost(prior=[2.0], v=[0.1]),
        )  # fmt: skip
        found[starts] = scheme.update(0.0, [10.0]).x[0], scheme.solves[-1].attempts
    assert found[0] == (pytest.approx(-1.0, abs=0.1), 1)
    assert found[2] == (pytest.approx(2.613, abs=1e-2), 2)
    # what fits nowhere is not looked for again at once: windows between the searches, more and more
    boxed = well.with_bounds(states=(-1.5, 1.5))
    scheme = NonlinearMovingHorizonEstimator(
        boxed, horizon=0.1, collocation=Collocation(0.5), solver=WindowSolver(starts=2),
        cost=likely_cost(prior=[1.0], v=[0.1]),
    )  # fmt: skip
    scheme.run((float(t), [10.0]) for t in range(8))
    assert [solve.attempts > 1 for solve in scheme.solves] == [True, False, True, False, False, True, False, False]


def test_scales_that_were_forgotten_are_named():
    tiny = NonlinearPlant(lambda x, u, w: [-x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1})
    with pytest.warns(ScaleWarning, match="The states have no scales though x1 is about 2.0e-08"):
        scheme = NonlinearMovingHorizonEstimator(tiny, horizon=1.0, prior=[2e-8])
    with pytest.warns(ScaleWarning, match="The outputs have no scales though y1 is about 3.0e-08"):
        scheme.update(0.0, [3e-8])
    scheme.update(0.5, [2e-8])  # said once
    signals = {"states": sd.plants.Signals(("x",), (), [1e-8]), "outputs": sd.plants.Signals(("y",), (), [1e-8])}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scaled = NonlinearPlant(tiny.dynamics, tiny.measurement, {"states": 1, "outputs": 1}, signals=signals)
        NonlinearMovingHorizonEstimator(scaled, horizon=1.0, prior=[2e-8]).update(0.0, [3e-8])


def test_a_pickled_estimator_goes_on_as_if_nothing_had_happened():
    data = [(t, [0.8 * np.cos(t)]) for t in (0.0, 0.6, 1.3, 2.0, 2.9)]
    scheme = NonlinearMovingHorizonEstimator(SLOW, horizon=2.0, collocation=Collocation(0.3, 3))
    scheme.run(data[:3])
    other = pickle.loads(pickle.dumps(scheme))
    for item in data[3:]:
        one, two = scheme.update(*item), other.update(*item)
        assert two.x == pytest.approx(one.x, abs=1e-12)
    assert other.builds == scheme.builds
    assert other.predict(3.5).x == pytest.approx(scheme.predict(3.5).x, abs=1e-12)


def test_weights_that_are_inverse_covariances_give_the_most_likely_trajectory():
    still = NonlinearPlant(lambda x, u, w: [0.0 * x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1})
    for form in ("paper", "certificate"):
        cost = likely_cost(prior=[2.0], v=[0.5], form=form)
        scheme = NonlinearMovingHorizonEstimator(still, horizon=9.0, cost=cost)
        found = [scheme.update(t, [y]) for t, y in ((1.0, 1.0), (2.0, 3.0))][-1]
        assert found.covariance[0, 0] == pytest.approx(1 / (1 / 4 + 2 / 0.25), rel=1e-6)
        assert found.x[0] == pytest.approx(found.covariance[0, 0] * (1.0 + 3.0) / 0.25, rel=1e-6)


def test_a_filtered_arrival_weight_makes_up_for_a_short_horizon():
    # two samples in a window: P2 forgets what was learned, the filtered weight does not
    plant, times = stirred_reactor(), np.arange(0.0, 2.6, 0.25)
    rng = np.random.default_rng(1)
    truth = simulate(plant, [0.55, 351.0], times, w=rng.standard_normal((times.size, 2)) * [0.02, 0.5])
    y = truth[:, 1:] + 0.5 * rng.standard_normal((times.size, 1))
    errors = []
    for arrival in ("fixed", "filtered"):
        cost = likely_cost(prior=[0.1, 3.0], v=[0.5], w=[0.02, 0.5], w_time=0.25, form="certificate", arrival=arrival)
        scheme = NonlinearMovingHorizonEstimator(
            plant, horizon=0.5, cost=cost, prior=[0.5, 350.0], collocation=Collocation(0.25, 3, accuracy=None)
        )
        found = scheme.run(zip(times, y, strict=True))
        errors.append(np.sqrt(np.mean((found.x - truth)[4:, 0] ** 2)))
    assert errors[1] < 0.5 * errors[0]
