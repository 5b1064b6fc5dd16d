"""The nonlinear estimator against a shooting method, and what it does when things go wrong."""

from types import SimpleNamespace

import numpy as np
import pytest

from sampling_design import Plant, read_measurements
from sampling_design.errors import ArgumentError, MissingExtraError
from sampling_design.estimators.estimate_file import write_estimates
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimator import EstimateRecord, Estimator
from sampling_design.nonlinear import thyroid
from sampling_design.nonlinear.collocation import Collocation, WindowSolver
from sampling_design.nonlinear.experiment import paper_weights
from sampling_design.nonlinear.inclusion_bound import InclusionBound
from sampling_design.nonlinear.jacobians import model_of
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.open_loop import NOTE
from sampling_design.nonlinear.simulation import simulate
from tests.oracles import nonlinear as oracle

SIZES = {"states": 2, "disturbances": 1, "outputs": 1}
WEIGHTS = {"P2": np.diag([2.0, 0.5]), "Qw": [[3.0]], "R": [[40.0]], "Qv": [[15.0]]}
TIMES = [0.0, 0.75, 1.0, 2.25, 3.0, 3.75]  # the last window of length 3 starts at a sample
ETA, HORIZON, STEP = 0.3, 3.0, 0.6
PRIOR = [0.5, 0.4]


def swing(x, u, w):
    return [x[1], -(x[0] - x[0] ** 3 / 6) - 0.1 * x[1] + w[0]]


def position(x, u, v):
    return [x[0] + v[0]]


PENDULUM = NonlinearPlant(swing, position, SIZES)


def record(times=TIMES, noise=0.1, seed=3):
    rng = np.random.default_rng(seed)
    truth = simulate(PENDULUM, [1.2, 0.0], times, w=0.2 * rng.uniform(-1, 1, (len(times), 1)))
    return [(t, [x[0] + noise * rng.uniform(-1, 1)]) for t, x in zip(times, truth, strict=True)]


def estimator(plant=PENDULUM, weights=None, pieces=None, **changes):
    options = {"horizon": HORIZON, "prior": PRIOR, "solver": WindowSolver(1e-10)}
    groups = {"cost": CostFunction(**{"eta": ETA, **WEIGHTS, **(weights or {})})}
    options["collocation"] = Collocation(**{"w_step": STEP, "degree": 4, **(pieces or {})})
    return NonlinearMovingHorizonEstimator(plant, **{**options, **groups, **changes})


def check_against_shooting(plant, boxes=None):
    data = record(noise=0.3)
    slow = oracle.scheme(
        lambda x, u, w: np.array(swing(x, u, w)), position, WEIGHTS, ETA, HORIZON, PRIOR, data, STEP, 1, boxes
    )
    scheme = estimator(plant)
    found = scheme.run(data)
    assert set(found.status) == {"ok"}
    assert found.x == pytest.approx(np.array([x for x, _ in slow]), abs=2e-5)
    assert found.cost == pytest.approx([cost for _, cost in slow], rel=1e-5)
    return scheme


def test_the_scheme_equals_shooting():
    scheme = check_against_shooting(PENDULUM)
    assert not scheme.program.keeps_v
    assert scheme.window.edges[0] == pytest.approx(0.75)


@pytest.mark.long
def test_with_boxes_that_bind_it_equals_shooting():
    plant = PENDULUM.with_bounds(disturbances=(-0.05, 0.05), noises=(-0.04, 0.04))
    scheme = check_against_shooting(plant, (-0.05, 0.05, -0.04, 0.04))
    v, w = scheme.window.point.v, scheme.window.point.w
    assert np.abs(v).max() == pytest.approx(0.04, abs=1e-6)
    assert np.abs(w).max() == pytest.approx(0.05, abs=1e-6)


def test_v_that_is_kept_without_binding_changes_nothing():
    wide = estimator(PENDULUM.with_bounds(noises=(-100.0, 100.0)))
    assert wide.program.keeps_v
    assert wide.run(record()).x == pytest.approx(estimator().run(record()).x, abs=1e-6)


def test_the_optimal_cost_is_at_most_that_of_the_truth():
    # the truth is feasible: its w is constant on the pieces, since the samples lie on them
    times = np.arange(0.0, 3.01, 0.6)
    rng = np.random.default_rng(0)
    w, v = rng.uniform(-1, 1, (6, 1)), 0.2 * rng.uniform(-1, 1, 6)
    truth = simulate(PENDULUM, [1.2, 0.0], times, w=w)
    found = estimator().run((t, [x[0] + e]) for t, x, e in zip(times, truth, v, strict=True))
    for k, t in enumerate(times):
        age = np.exp(-ETA * (t - times[: k + 1]))
        area = (age[1:] - age[:-1]) / ETA
        start = np.array([1.2, 0.0]) - PRIOR
        worth = 2 * age[0] * start @ WEIGHTS["P2"] @ start
        # v = the noise itself: nothing is left over for R
        worth += 2 * 3.0 * np.sum(area * w[:k, 0] ** 2) + 2 * 15.0 * np.sum(age * v[: k + 1] ** 2)
        assert found.cost[k] <= worth


def test_one_program_serves_while_the_window_fills_and_after():
    scheme = estimator(pieces={"capacity": 8})
    found = scheme.run(record())
    assert scheme.builds == 1
    assert [s.intervals for s in scheme.solves] == [0, 2, 3, 6, 8, 8]
    small = estimator(pieces={"capacity": 3})
    assert small.run(record()).x == pytest.approx(found.x, abs=1e-8)
    assert small.builds > 1


def test_estimates_are_like_those_of_the_linear_estimators():
    scheme = estimator()
    assert isinstance(scheme, Estimator)
    assert scheme.predict(0.0).status == "prior"
    found = scheme.run(record(), progress=(seen := []).append and (lambda fraction, note: seen.append(fraction)))
    assert isinstance(found, EstimateRecord)
    assert seen[-1] == 1.0
    latest = scheme.predict(scheme.state.last.t)
    assert not latest.certified
    assert latest.note == NOTE
    assert np.all(np.isinf(latest.radii))
    assert latest.window_start == pytest.approx(0.75)
    assert "6" in str(found)
    assert latest.to_dict()["radius"] is None


def test_between_samples_it_runs_open_loop():
    scheme = estimator()
    scheme.run(record()[:3])
    early = oracle.flow(lambda x, u, w: np.array(swing(x, u, w)), scheme.predict(1.0).x, None, [0.0], 0.9)
    assert scheme.predict(1.9).x == pytest.approx(early, abs=1e-8)
    assert scheme.predict(1.9).status == "predicted"


def test_outputs_that_are_not_measured_do_not_count():
    both = NonlinearPlant(swing, lambda x, u, v: [x[0] + v[0], x[1] + v[1]], {**SIZES, "outputs": 2})
    weights = {"R": np.diag([40.0, 7.0]), "Qv": np.diag([15.0, 2.0])}
    found = estimator(both, weights).run((t, [y[0], np.nan]) for t, y in record())
    assert found.x == pytest.approx(estimator().run(record()).x, abs=1e-7)


def test_inputs_hold_until_the_next_and_may_change_between_samples():
    pushed = NonlinearPlant(
        lambda x, u, w: [x[1], -x[0] + x[0] ** 3 / 6 + u[0] + w[0]], position, {**SIZES, "inputs": 1}
    )
    times = [0.0, 0.5, 1.3, 2.0]
    u = np.array([0.3, -0.2, 0.4, 0.4])
    truth = simulate(pushed, [0.6, 0.1], times, u=u[:, None])
    scheme = estimator(pushed, prior=[0.6, 0.1])
    scheme.update(0.0, truth[0, :1], [0.3])
    scheme.update(0.5, None, [-0.2])
    scheme.update(1.3, None, [0.4])
    found = scheme.update(2.0, truth[3, :1])
    assert found.x == pytest.approx(truth[3], abs=1e-6)
    assert scheme.solves[-1].intervals == 1 + 2 + 2  # the changes of the input are edges


def test_files_of_measurements_and_estimates_serve_it_too(tmp_path):
    path = tmp_path / "blood.csv"
    path.write_text(
        "date,T4,T3_p,TSH,u_T4,u_T3\n2026-01-05T08:00,2.1e-8,9.6e-10,4.7,0,0\n2026-01-06T09:30,2.1e-8,,4.8,,\n"
    )
    patient = thyroid.thyroid()
    scheme = NonlinearMovingHorizonEstimator(
        patient, horizon=5.0, collocation=Collocation(w_step=0.25), prior=thyroid.TRUE_START, cost=paper_weights()
    )
    found = scheme.run(read_measurements(path, patient))
    assert found.status == ("ok", "ok")
    assert found.times[1] - found.times[0] == pytest.approx(25.5 / 24)
    lines = write_estimates(found, tmp_path / "estimates.csv").read_text().splitlines()
    assert lines[0].startswith("time,status,certified,cost,T4_th,T4_th_radius")
    assert lines[1].split(",")[5] == ""  # no radius is known


def test_a_late_sample_gives_the_result_of_samples_in_order():
    data = record()
    late = estimator()
    for item in [*data[:2], *data[3:], data[2]]:
        late.update(*item)
    in_order = estimator().run(data)
    assert late.state.last.x == pytest.approx(in_order.x[-1], abs=1e-7)


def test_reset_forgets_everything():
    scheme = estimator()
    first = scheme.run(record())
    scheme.start(PRIOR)
    assert scheme.solves == []
    assert scheme.run(record()).x == pytest.approx(first.x, abs=1e-11)


def test_states_and_outputs_keep_their_boxes():
    plant = PENDULUM.with_bounds(states=([-0.7, -9.0], [0.7, 9.0]), outputs=(-0.72, 0.72))
    scheme = estimator(plant)
    found = scheme.run(record())
    assert set(found.status) == {"ok"}
    assert np.abs(scheme.window.point.z[..., 0]).max() <= 0.7
    shown = scheme.window.nodes[:, 0] + scheme.window.point.v[:, 0]
    sampled = np.isin(np.round(scheme.window.edges, 9), TIMES)
    assert np.abs(shown[sampled]).max() <= 0.72 + 1e-8
    assert np.abs(estimator().run(record()).x[:, 0]).max() > 0.75  # without the box it would leave it


def test_noise_may_enter_in_any_way():
    # v scales the output: nothing can be eliminated
    plant = NonlinearPlant(swing, lambda x, u, v: [x[0] * (1 + v[0])], SIZES)
    scheme = estimator(plant)
    assert scheme.program.keeps_v
    data = [(t, [y[0] * 1.02]) for t, y in record(noise=0.0)]
    slow = oracle.scheme(
        lambda x, u, w: np.array(swing(x, u, w)),
        lambda x, u, v: np.array([x[0] * (1 + v[0])]),
        WEIGHTS, ETA, HORIZON, PRIOR, data[:3], STEP, 1,
    )  # fmt: skip
    assert scheme.run(data[:3]).x == pytest.approx(np.array([x for x, _ in slow]), abs=2e-5)


def test_a_plant_without_noise_or_disturbance_can_be_estimated():
    still = NonlinearPlant(
        lambda x, u, w: [x[1], -x[0]], lambda x, u, v: [x[0]], {"states": 2, "outputs": 1, "noises": 0}
    )
    scheme = NonlinearMovingHorizonEstimator(still, horizon=6.0, cost=CostFunction(R=[[1e4]]))
    record = [(t, [np.cos(t)]) for t in (0.0, 1.0, 2.0, 3.5, 5.0)]
    assert scheme.run(record).x[-1] == pytest.approx([np.cos(5.0), -np.sin(5.0)], abs=1e-3)


def test_a_failed_solve_is_recorded_and_the_run_goes_on():
    scheme = estimator(solver=WindowSolver(1e-10, 4, starts=0))
    data = record([*TIMES, 4.5, 5.5, 6.25], noise=0.0)
    # an outlier needs more steps than allowed, as long as it is in the window
    found = scheme.run([*data[:3], (2.25, [6.0]), *data[4:]])
    assert found.status[3] == "solver failed"
    assert found.status[0] == found.status[1] == found.status[2] == "ok"
    assert found.status[-1] == "ok"
    assert "maximum iterations exceeded; open-loop prediction instead." in found.notes[3]
    assert scheme.solves[3].attempts == 2
    before = oracle.flow(lambda x, u, w: np.array(swing(x, u, w)), found.x[2], None, [0.0], 1.25)
    assert found.x[3] == pytest.approx(before, abs=1e-8)
    failed = sum(status == "solver failed" for status in found.status)
    assert f"{failed} failed" in found.explain()
    assert sum(solve.status != "ok" for solve in scheme.solves) == failed


def test_constraints_that_nothing_meets_are_called_infeasible():
    # x' = 1 cannot stay below 1 for longer than a unit of time
    clock = NonlinearPlant(lambda x, u, w: [1.0 + 0 * x[0]], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1},
                           bounds={"states": (0.0, 1.0)})  # fmt: skip
    found = NonlinearMovingHorizonEstimator(clock, horizon=5.0, collocation=Collocation(w_step=0.5)).run(
        [(0.0, [0.0]), (0.5, [0.5]), (2.0, [1.0])]
    )
    assert found.status == ("ok", "ok", "infeasible")
    assert found.x[-1] == pytest.approx([1.0])  # the open loop ends at 2: it does not leave X in silence
    assert "The open loop leaves X (x1 = " in found.notes[-1]
    assert "brought back to its edge" in found.notes[-1]


def test_where_even_the_open_loop_fails_the_last_estimate_is_held():
    # x' = x^2 escapes to infinity at t = 1 from x = 1
    burst = NonlinearPlant(
        lambda x, u, w: [x[0] ** 2], lambda x, u, v: [x[0] + v[0]], {"states": 1, "outputs": 1},
        bounds={"states": (1.0, np.inf)},
    )  # fmt: skip
    scheme = NonlinearMovingHorizonEstimator(
        burst, horizon=5.0, collocation=Collocation(w_step=0.5), prior=[1.0], solver=WindowSolver(max_iterations=30)
    )
    found = scheme.run([(0.0, [1.0]), (3.0, [1.0])])
    assert found.status[1] in ("infeasible", "solver failed")
    assert "the last estimate is held" in found.notes[1]
    assert found.x[1] == pytest.approx(found.x[0])
    lost = scheme.predict(9.0)
    assert lost.failed
    assert "the last estimate is held" in lost.note
    assert lost.x == pytest.approx(found.x[0])


def test_a_model_that_turns_nan_under_way_stops_nothing(capfd):
    # the root is not finite below 0, and a sample of -8 pulls the window there
    root = NonlinearPlant(
        lambda x, u, w: [w[0] - x[0] ** 0.5], position, {"states": 1, "disturbances": 1, "outputs": 1}
    )
    scheme = NonlinearMovingHorizonEstimator(root, horizon=3.0, prior=[0.5], collocation=Collocation(w_step=0.5))
    found = scheme.run([(0.0, [0.5]), (0.5, [0.2]), (1.0, [-8.0]), (1.5, [0.1]), (5.0, [0.1])])
    assert "ok" in found.status
    assert "solver failed" in found.status or "infeasible" in found.status
    assert np.all(np.isfinite(found.x))
    assert capfd.readouterr() == ("", "")


def test_growth_beyond_all_numbers_is_a_failed_status_and_nothing_is_printed(capfd):
    """e^400 between two samples: the prediction is 1e172, and its square overflows in the cost."""
    scheme = NonlinearMovingHorizonEstimator(from_linear(Plant([[1.0]], [[1.0]])), horizon=5.0)
    found = scheme.run([(1.0, [0.1]), (401.0, [0.1])])
    assert found.status == ("ok", "solver failed")
    assert np.isfinite(found.x).all()
    assert scheme.predict(801.0).status == "solver failed"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"prior": [9.0, 0.0]}, "`prior` must lie in the plant's box of states, got x1 = 9 outside"),
        ({"prior": [0.5]}, "`prior` must have 2 entries, got 1"),
        ({"horizon": 0.0}, "`horizon` must be positive"),
        ({"pieces": {"w_step": -1.0}}, "`w_step` must be positive"),
        ({"pieces": {"degree": 0}}, "`degree` must be a whole number of at least 1"),
        ({"weights": {"R": np.eye(2)}}, r"`R` must have shape \(1, 1\)"),
        ({"weights": {"P2": -np.eye(2)}}, "`P2` must be positive definite"),
        ({"weights": {"eta": -0.1}}, "`eta` must not be negative"),
        ({"pieces": {"accuracy": 0.0}}, "`accuracy` must be positive"),
        ({"pieces": {"inputs": "bent"}}, '`inputs` must be "held" or "linear", got \'bent\''),
        ({"horizon": None}, "`horizon` must be given where there is no certificate"),
        ({"pieces": {"capacity": 0}}, "`capacity` must be a whole number"),
    ],
)
def test_bad_arguments_are_refused_at_the_door(changes, words):
    with pytest.raises(ArgumentError, match=words):
        estimator(PENDULUM.with_bounds(states=(-2.0, 2.0)), **changes)


def test_a_model_that_returns_nan_is_refused_at_the_door():
    root = NonlinearPlant(lambda x, u, w: [x[0] ** 0.5], position, {"states": 1, "outputs": 1})
    with pytest.raises(ArgumentError, match="the model is not finite there"):
        NonlinearMovingHorizonEstimator(root, horizon=1.0, prior=[-1.0])


def test_a_linear_plant_is_taken_as_the_nonlinear_one_it_is():
    linear = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    found = [
        NonlinearMovingHorizonEstimator(plant, horizon=3.0, prior=[1.0, 0.0]).run([(0.0, [0.9]), (1.0, [0.4])]).x
        for plant in (linear, from_linear(linear))
    ]
    np.testing.assert_array_equal(*found)
    with pytest.raises(ArgumentError, match="`plant` must be a NonlinearPlant, got str"):
        NonlinearMovingHorizonEstimator("pendulum", horizon=1.0)


def test_wrong_samples_change_nothing():
    scheme = estimator()
    scheme.update(0.0, [0.4])
    for item, words in [((1.0, [1.0, 2.0]), "`y` must have 1 entry"), ((1.0, None, [1.0]), "`u` must have 0 entries")]:
        with pytest.raises(ArgumentError, match=words):
            scheme.update(*item)
    assert scheme.state.last.t == 0.0
    assert len(scheme.solves) == 1


def test_without_casadi_one_sentence_names_the_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError, match="nonlinear") as caught:
        NonlinearPlant(swing, position, SIZES)
    assert caught.value.extra == "nonlinear"
    assert str(caught.value) == (
        "This needs casadi, which is not installed. Install the extra: pip install 'sampling-design[nonlinear]'."
    )


@pytest.mark.parametrize("bounded", [False, True])
def test_an_output_that_is_not_measured_is_free_also_where_noises_are_correlated(bounded):
    # prior I, V = [[1, .9], [.9, 1]], y = [1, nan]: the second noise is unknown, so x1 = 1/2 and x2 = 0
    plant = from_linear(Plant(np.zeros((2, 2)), np.eye(2)))
    if bounded:  # then v is a variable
        plant = plant.with_bounds(noises=(-50.0 * np.ones(2), 50.0 * np.ones(2)))
    V = np.array([[1.0, 0.9], [0.9, 1.0]])
    weight = 2 * np.linalg.inv(V)  # (R^-1 + (2 Qv)^-1)^-1 = V^-1, and 2 P2 = I
    scheme = NonlinearMovingHorizonEstimator(
        plant, horizon=1.0, cost=CostFunction(P2=np.eye(2) / 2, R=weight, Qv=weight / 2)
    )
    assert scheme.update(0.0, [1.0, np.nan]).x == pytest.approx([0.5, 0.0], abs=1e-7)
    scheme.start()
    both = np.linalg.solve(np.eye(2) + V, [1.0, -0.5])
    assert scheme.update(0.0, [1.0, -0.5]).x == pytest.approx(both, abs=1e-7)


def test_what_has_no_window_yet_smooths_nothing():
    with pytest.raises(ArgumentError, match="`smoothed` needs a solved window"):
        estimator().smoothed()


def test_a_certificate_of_another_plant_or_of_many_words_promises_nothing():
    alien = SimpleNamespace(kind="nonlinear", model_data={})
    with pytest.raises(ArgumentError, match="`certificate` belongs to another plant: its dynamics differs"):
        InclusionBound(alien, PENDULUM, None)
    wordy = SimpleNamespace(kind="nonlinear", model_data=model_of(PENDULUM), words=2)
    with pytest.raises(ArgumentError, match=r"must have one P\(tau\) for all gaps"):
        InclusionBound(wordy, PENDULUM, None)
