"""The moving horizon estimator: defaults, flags, statuses, refusals; after each refusal nothing has changed."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sampling_design import Constraints, Plant, certify
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.families.family_certificate import FamilyCertificate
from sampling_design.certificates.form.claims import RESOLUTION
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.gap_flows import flows
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.kalman import KalmanFilter
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.online.estimator import GuaranteeWarning
from sampling_design.estimators.records.measurements import Measurements
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from tests.cases import few
from tests.oracles.windows import by_the_reference

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DRIVEN = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], B=[[0.0], [1.0]], D=[[0.5], [0.0]])
EVERY = PeriodicSchedule([1.0])
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}


def stand_in(plant=PLANT, times=EVERY, **changes):
    """A certificate made by hand, lambda proven at most 5 (4 from samples); nothing here asks whether it is true."""
    fields = {
        "P1": 0.2 * np.eye(2),
        "P2": np.eye(2),
        "Qw": np.eye(plant.n_disturbances),
        "R": [[2.0]],
        "Qv": [[2.0]],
        "eta": 0.4,
        "lam": 5.0 * (1 - RESOLUTION),
        "lam_samples": 4.0 * (1 - RESOLUTION),
        **changes,
    }
    if isinstance(times, GapRange):
        return FamilyCertificate(plant, times, **fields, P=fields["P2"][None])
    return Certificate(plant, times, **fields)


def test_a_certificate_brings_weights_horizon_and_claim():
    certificate = certify(PLANT, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
    mhe = MovingHorizonEstimator(PLANT, certificate, **BOUNDS)
    expected = max(1.0, math.log(4 * certificate.lam_proven) / certificate.eta)
    assert mhe.horizon == pytest.approx(expected, rel=1e-12)
    assert np.array_equal(mhe.weights.prior, certificate.P2)
    x = np.array([0.5, -0.5])
    for t in range(1, 20):
        estimate = mhe.update(float(t), PLANT.C @ PLANT.transition(float(t)) @ x)
        assert estimate.certified
        assert estimate.on_schedule
        assert estimate.note == ""
        assert estimate.holds(PLANT.transition(float(t)) @ x)


def test_online_radius_contracts_to_its_limit_and_obeys_the_window_recursion():
    certificate = certify(PLANT, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
    mhe = MovingHorizonEstimator(PLANT, certificate, **BOUNDS)
    for t in range(1, 80):
        estimate = mhe.update(float(t), [0.0])
    eta, M = certificate.eta, mhe.horizon
    w = np.linalg.eigvalsh(certificate.Qw)[-1] * 0.1**2 / eta
    R = certificate.R @ certificate.Qv / (certificate.R + certificate.Qv)
    v = float(R[0, 0]) * 0.1**2 / (1 - math.exp(-eta))
    assert 0 < estimate.radius <= (w + v) / (1 - certificate.lam * math.exp(-eta * M)) * (1 + 1e-6)


@pytest.mark.parametrize(
    ("cost", "expected"), [("certificate", math.log(20.0) / 0.4), ("paper", 2 * math.log(16.0) / 0.4)]
)
def test_default_horizon(cost, expected):
    assert MovingHorizonEstimator(PLANT, stand_in(), cost=CostFunction(form=cost)).horizon == pytest.approx(expected)
    far = stand_in(times=PeriodicSchedule([50.0]))
    assert MovingHorizonEstimator(PLANT, far, cost=CostFunction(form=cost)).horizon == 50.0
    late = stand_in(times=Schedule([40.0, 41.0]))
    assert MovingHorizonEstimator(PLANT, late, cost=CostFunction(form=cost)).horizon == 40.0


def test_a_horizon_that_is_too_short_warns_and_marks():
    with pytest.warns(GuaranteeWarning, match="must exceed 4.02359"):
        mhe = MovingHorizonEstimator(PLANT, stand_in(), horizon=3.0, **BOUNDS)
    estimate = mhe.update(1.0, [0.1])
    assert not estimate.on_schedule
    assert "horizon 3" in estimate.note
    assert estimate.certified
    with pytest.warns(GuaranteeWarning, match="must exceed 5.75646"):
        MovingHorizonEstimator(PLANT, stand_in(), horizon=5.7, cost=CostFunction(form="paper"))
    carried = MovingHorizonEstimator(PLANT, stand_in(), horizon=3.0, cost=CostFunction(arrival="filtered"))
    assert carried.update(1.0, [0.1]).on_schedule


def test_overridden_weights_and_weights_by_hand_say_that_there_is_no_claim():
    mhe = MovingHorizonEstimator(PLANT, stand_in(), cost=CostFunction(P2=3 * np.eye(2)), **BOUNDS)
    assert "P2 differ" in mhe.update(1.0, [0.1]).note
    byhand = MovingHorizonEstimator(PLANT, horizon=4.0, **BOUNDS).update(1.0, [0.1])
    assert "no certificate was given" in byhand.note
    assert (byhand.on_schedule, byhand.certified) == (False, True)


def test_default_weights_are_built_from_the_scales():
    plant = Plant(PLANT.A, PLANT.C, states=PLANT.scaled().states, time_unit="h")
    scaled = Plant(
        plant.A,
        plant.C,
        states=type(plant.states)(("a", "b"), scales=[2.0, 4.0]),
        outputs=type(plant.states)(("y",), scales=[5.0]),
    )
    weights = MovingHorizonEstimator(scaled, horizon=1.0).weights
    assert np.allclose(np.diag(weights.prior), [1 / 4, 1 / 16])
    assert weights.y[0, 0] == pytest.approx(1 / 25)


def test_samples_off_the_schedule_drop_the_claim_and_keep_the_ellipsoid():
    mhe = MovingHorizonEstimator(PLANT, stand_in(), **BOUNDS)
    assert mhe.update(1.0, [0.0]).on_schedule
    assert mhe.predict(1.9).on_schedule
    assert not mhe.predict(2.1).on_schedule
    late = mhe.update(2.2, [0.0])
    assert (late.on_schedule, late.certified) == (False, True)
    assert "off the certificate's schedule" in late.note
    assert not mhe.update(3.0, [0.0]).on_schedule
    missed = MovingHorizonEstimator(PLANT, stand_in())
    missed.update(1.0, [0.0])
    assert not missed.update(3.0, [0.0]).on_schedule
    missed.update(2.0, [0.0])
    assert missed.predict(3.0).on_schedule


def test_partial_outputs_must_cover_what_was_planned():
    planned = PeriodicSchedule([1.0, 1.0], outputs=[[1, 0], [1, 1]])
    certificate = stand_in(plant=DRIVEN, times=planned, R=2 * np.eye(2), Qv=2 * np.eye(2))
    mhe = MovingHorizonEstimator(DRIVEN, certificate)
    assert mhe.update(1.0, [0.1, np.nan]).on_schedule
    assert mhe.update(2.0, [0.1, 0.2]).on_schedule
    assert mhe.update(3.0, [0.1, 0.2]).on_schedule
    assert not mhe.update(4.0, [0.1, np.nan]).on_schedule


def test_a_family_and_a_finite_schedule_are_watched_too():
    family = MovingHorizonEstimator(PLANT, stand_in(times=GapRange(0.8, 1.5)))
    assert [family.update(t, [0.0]).on_schedule for t in (1.0, 2.4, 3.2, 4.8, 5.8)] == [True, True, True, False, False]
    close = MovingHorizonEstimator(PLANT, stand_in(times=GapRange(0.8, 1.5)))
    assert [close.update(t, [0.0]).on_schedule for t in (0.1, 0.9, 1.5)] == [True, True, False]
    finite = MovingHorizonEstimator(PLANT, stand_in(times=Schedule([1.0, 2.0])))
    assert [finite.update(t, [0.0]).on_schedule for t in (1.0, 2.0, 3.0)] == [True, True, False]
    assert not finite.predict(2.5).on_schedule


def test_bounds_that_are_missing_mean_no_radius():
    estimate = MovingHorizonEstimator(PLANT, horizon=4.0, w_bound=0.1).update(1.0, [0.1])
    assert not estimate.certified
    assert np.all(np.isinf(estimate.radii))
    assert "v_bound, initial_error not given" in estimate.note


def test_data_that_contradict_the_bounds_are_called_so():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, w_bound=1e-3, v_bound=1e-3, initial_error=1e-3)
    estimate = mhe.update(1.0, [5.0])
    assert estimate.status == "bounds disproved"
    assert estimate.failed
    assert not estimate.certified
    after = mhe.update(2.0, [0.0])
    assert not after.certified
    assert "contradict" in after.note


def test_a_contradiction_of_a_dated_record_is_told_by_its_date():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, w_bound=1e-3, v_bound=1e-3, initial_error=1e-3)
    plain = Measurements(PLANT, [60.0], [[5.0]])
    dated = replace(plain, origin="2026-03-02T08:00:00+01:00")
    for record, when in ((plain, "t = 60"), (dated, "2026-03-02 08:01+01:00")):
        found = mhe.run(record)
        assert f"The data contradict the bounds: sample 1 at {when}, output" in found.explain()
        assert f"sample 1 at {when}, output" in str(found)


def test_exact_data_without_noise_do_not_disprove_zero_bounds():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, prior=[1.0, 0.0], w_bound=0.0, v_bound=0.0, initial_error=0.0)
    for t in np.arange(0.7, 20.0, 0.7):
        estimate = mhe.update(t, [math.cos(t)])
        assert estimate.status == "ok"
        assert estimate.certified
        assert np.max(np.abs(estimate.x - [math.cos(t), -math.sin(t)])) < 1e-12


def test_an_infeasible_window_predicts_names_the_obstacle_and_goes_on():
    wide = {"v_bound": 100.0, "initial_error": 100.0}
    mhe = MovingHorizonEstimator(DRIVEN, horizon=2.0, constraints=Constraints(x=(-1.0, 1.0), w=(-0.1, 0.1)), **wide)
    fine = mhe.update(1.0, [0.0, 0.0], [20.0])
    estimate = mhe.update(1.5, [0.0, 0.0], [0.0])
    assert estimate.status == "infeasible"
    assert "No trajectory meets" in estimate.note
    assert "constraints.x" in estimate.note or "constraints.w" in estimate.note
    assert "more)" in estimate.note
    assert not estimate.certified
    kick = mhe.state.drift(mhe.table, 1.0, 1.5)
    assert np.allclose(estimate.x, DRIVEN.transition(0.5) @ fine.x + kick)
    assert mhe.update(2.5, [0.0, 0.0]).status == "infeasible"
    after = mhe.update(4.5, [0.1, 0.1])
    assert after.status == "ok"
    assert "contradict" in after.note
    assert not after.certified


def solved_by(engine, plant, sets):
    """An estimator whose active windows an engine solves, or the reference."""
    if engine == "reference":
        return by_the_reference(MovingHorizonEstimator(plant, horizon=4.0, constraints=sets))
    return MovingHorizonEstimator(plant, horizon=4.0, constraints=replace(sets, engine=engine))


@pytest.mark.parametrize("engine", ["auto", "conic", "reference"])
@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (Constraints(x=(-1.0, 1.0)), r"(x|omega)[12] [<>]= \S+ at t = \S+ \(constraints.[xw]\)"),
        (
            Constraints(x=(-1.0, 1.0), check_spacing=0.3),
            r"(x|omega)[12] [<>]= \S+ at t = \S+ \(constraints.[xw]\)",
        ),
        (
            Constraints(x=ConvexSet.halfspaces(np.vstack([np.eye(2), -np.eye(2)]), np.ones(4))),
            r"half-space \d of constraints.x at t",
        ),
        (Constraints(x=ConvexSet.ball(1.0, dimension=2)), r"a ball of constraints.x at t = "),
        (Constraints(x=ConvexSet.ball(0.0, dimension=2)), r"a ball of constraints.x at t = "),
        (Constraints(y=ConvexSet.ball(1.0, dimension=2), v=(-0.1, 0.1)), r"a ball of constraints.y at t = "),
    ],
)
def test_whatever_set_cannot_be_met_is_named(sets, words, engine):
    """A kick by a known input that no small disturbance undoes: every engine says so and predicts instead."""
    mhe = solved_by(engine, DRIVEN, replace(sets, w=(-0.01, 0.01)))
    assert mhe.update(0.5, [0.0, 0.0], [0.0]).status == "ok"
    mhe.update(0.6, None, [20.0])
    before = mhe.predict(1.5)
    estimate = mhe.update(1.5, [0.0, 0.0], [0.0])
    assert estimate.status == "infeasible"
    assert np.array_equal(estimate.x, before.x)
    assert not estimate.certified
    assert "No trajectory meets" in estimate.note
    if engine != "reference":
        assert re.search(words + r".*needs \S+ more", estimate.note), estimate.note


@pytest.mark.parametrize("engine", few(["auto", "conic", "reference"], 0, 1))
def test_a_ball_of_radius_zero_is_a_point(engine):
    for name, k in (("v", 1), ("w", 2)):
        found = []
        for chosen in (ConvexSet.ball(0.0, dimension=k), (0.0, 0.0)):
            mhe = solved_by(engine, PLANT, Constraints(**{name: chosen}))
            found.append([mhe.update(t, [0.3 * t]) for t in (1.0, 1.7, 2.9)][-1])
        assert found[0].status == "ok"
        assert np.max(np.abs(found[0].x - found[1].x)) < 1e-9
        assert found[0].cost == pytest.approx(found[1].cost, rel=1e-9)


def test_a_sample_at_the_priors_time_is_used_once():
    mhe = MovingHorizonEstimator(
        PLANT, horizon=4.0, cost=CostFunction(P2=np.eye(2), R=[[2.0]], Qv=[[2.0]]), prior=[1.0, 0.0], **BOUNDS
    )
    first = mhe.update(0.0, [2.0])
    assert first.x[0] == pytest.approx(1.5)
    assert first.covariance[0, 0] == pytest.approx(0.5)
    again = mhe.update(0.0, [2.0])
    assert again.x[0] == pytest.approx(1.5)
    assert mhe.update(1.0, [0.0]).window_start == 0.0
    assert mhe.state.nodes[0].x[0] == 1.0


def test_inputs_hold_and_the_input_side_is_stated():
    right = MovingHorizonEstimator(DRIVEN, horizon=4.0)
    left = MovingHorizonEstimator(DRIVEN, horizon=4.0, input_side="left")
    for mhe in (right, left):
        mhe.update(0.0, None, [1.0])
        mhe.update(1.0, [0.3, 0.1], [-1.0])
    assert right.state.last.feedthrough.tolist() == [-0.5, 0.0]
    assert left.state.last.feedthrough.tolist() == [0.5, 0.0]
    steady = right.predict(1.0 + 2 * math.pi)
    drift = right.state.drift(right.table, 1.0, 1.0 + 2 * math.pi)
    assert np.max(np.abs(drift)) < 1e-12
    assert steady.status == "predicted"


def test_streaming_keeps_no_more_than_two_windows(monkeypatch):
    monkeypatch.setattr(flows, "CACHE_SIZE", 64)
    mhe = MovingHorizonEstimator(PLANT, horizon=3.0)
    rng = np.random.default_rng(0)
    sizes, tables, t = set(), [], 0.0

    def samples():
        nonlocal t
        for _ in range(200):
            t += rng.uniform(0.5, 1.0)
            yield t, [0.0]

    for _ in mhe.stream(samples()):
        sizes.add(len(mhe.state.nodes))
        tables.append(len(mhe.table))
    assert len(tables) == 200
    assert max(sizes) <= 2 * 3.0 / 0.5 + 3
    assert max(tables) == 64
    assert len(mhe.state.inputs) == 0


def test_inputs_that_are_older_than_the_snapshots_are_dropped():
    mhe = MovingHorizonEstimator(DRIVEN, horizon=2.0)
    for k in range(60):
        mhe.update(0.5 * (k + 1), [0.0, 0.0], [float(k)])
    assert len(mhe.state.inputs) <= 12


def test_run_reports_progress_and_collects():
    seen = []
    record = MovingHorizonEstimator(PLANT, horizon=4.0, **BOUNDS).run(
        [(float(t), [0.1]) for t in range(1, 6)], progress=lambda f, m: seen.append((f, m))
    )
    assert len(record) == 5
    assert seen[-1] == (1.0, "5 of 5 samples")
    assert record.radii.shape == (5, 2)
    assert record.status == ("ok",) * 5
    assert "5 estimates" in record.explain()
    assert record.to_dict()["radii"][4][0] == record.radii[4, 0]
    assert "proven: the radii of" in str(record)
    assert "ok: 5" in repr(record)


def test_an_estimate_says_what_it_promises():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, **BOUNDS)
    estimate = mhe.update(1.0, [0.1])
    assert "within" in estimate.explain()
    assert estimate.to_dict()["certified"] is True
    assert MovingHorizonEstimator(PLANT, horizon=4.0).update(1.0, [0.1]).to_dict()["radius"] is None
    assert "No radius" in MovingHorizonEstimator(PLANT, horizon=4.0).predict(1.0).explain()
    exact = MovingHorizonEstimator(PLANT, horizon=4.0, w_bound=0.0, v_bound=0.0, initial_error=0.0).predict(0.0)
    assert exact.ratio([0.0, 0.0]) == 0.0
    assert not exact.holds([1.0, 0.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "`horizon` must be given where there is no certificate"),
        ({"horizon": 0.0}, "`horizon` must be positive"),
        ({"horizon": 1.0, "cost": CostFunction(P2=np.zeros((2, 2)))}, "`P2` must be positive definite"),
        ({"horizon": 1.0, "cost": CostFunction(R=np.eye(2))}, r"`R` must have shape \(1, 1\)"),
        ({"horizon": 1.0, "cost": "paper"}, "`cost` must be a CostFunction, got str 'paper'. Use CostFunction"),
        ({"horizon": 1.0, "input_side": "both"}, '`input_side` must be "right" or "left"'),
        ({"horizon": 1.0, "w_bound": -1.0}, "`w_bound` must not be negative"),
        ({"horizon": 1.0, "initial_error": [1.0, -1.0]}, "`initial_error` must not be negative"),
        ({"horizon": 1.0, "v_bound": [1.0, 1.0]}, "`v_bound` must have 1 entry"),
        ({"horizon": 1.0, "prior": [1.0]}, "`prior` must have 2 entries"),
        (
            {"horizon": 1.0, "prior": [3.0, 0.0], "constraints": Constraints(x=(-1.0, 1.0))},
            "`prior` must lie in `constraints.x`, got one outside by 2",
        ),
        (
            {"horizon": 1.0, "prior": [1.0, 1.0], "constraints": Constraints(x=ConvexSet.ball(1.0, dimension=2))},
            "`prior` must lie in `constraints.x`, got one outside by 0.414",
        ),
        ({"horizon": 1.0, "constraints": Constraints(x=(1.0, -1.0))}, "the set is empty"),
        (
            {"horizon": 1.0, "constraints": Constraints(x=ConvexSet.ball(1.0, dimension=3))},
            "`constraints.x` must have dimension 2, got 3",
        ),
        ({"horizon": 1.0, "constraints": Constraints(w=([0.0, -np.inf], [1.0, 1.0]))}, "`constraints.w` is unbounded"),
        (
            {"horizon": 1.0, "constraints": Constraints(w=ConvexSet.ball(1.0, dimension=2), engine="active set")},
            "knows no norm balls",
        ),
        ({"certificate": PeriodicSchedule([1.0])}, "`certificate` must be a Certificate or FamilyCertificate, got Per"),
        ({"certificate": stand_in(plant=DRIVEN, R=np.eye(2), Qv=np.eye(2))}, "`certificate` belongs to another plant"),
    ],
)
def test_refusals_at_the_door(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        MovingHorizonEstimator(PLANT, **arguments)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CostFunction(eta=-1.0), "`eta` must not be negative"),
        (lambda: CostFunction(P2=[[1.0, 0.0]]), r"`P2` must have shape \(1, 1\), got \(1, 2\)"),
        (lambda: CostFunction(form="mine"), '`form` must be "certificate" or "paper", got'),
        (lambda: CostFunction(arrival="free"), "`arrival` must be "),
        (lambda: CostFunction(arrival=np.eye(2)), '`arrival` must be "fixed" or "filtered", got ndarray'),
        (lambda: CostFunction(begins="now"), '`begins` must be "horizon" or "sample", got'),
        (lambda: Constraints(engine="fast"), "`engine` must be "),
        (lambda: Constraints(x="positive"), "`x` must be a ConvexSet or a pair .*, got str 'positive'"),
        (lambda: KalmanFilter(PLANT, cost=CostFunction(form="paper")), '`cost` must have the form "certificate" here'),
    ],
)
def test_refusals_of_what_is_grouped(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_more_refusals_at_the_door():
    with pytest.raises(ArgumentError, match="at least one state"):
        MovingHorizonEstimator(Plant(np.zeros((0, 0)), np.zeros((1, 0))), horizon=1.0)
    wide = Plant([[0.0]], [[1.0]], G=[[1.0, 1.0]])
    with pytest.raises(ArgumentError, match="full column rank"):
        MovingHorizonEstimator(wide, horizon=1.0, constraints=Constraints(w=(-1.0, 1.0), w_model="constant"))


@pytest.mark.parametrize(
    ("sample", "message"),
    [
        ((10.0, [0.1], None), "`y` must have 2 entries, got shape"),
        ((10.0, [[0.1, 0.2]], None), "`y` must have 2 entries"),
        ((10.0, [np.nan, np.nan], None), "`y` must measure at least one output"),
        ((10.0, [np.inf, 0.0], None), "`y` must be finite or NaN"),
        ((10.0, "low", None), "`y` must hold numbers"),
        ((10.0, ["<0.5"], None), r"`y` must hold numbers, .* A limit of detection is BelowDetection\(0\.5\) or Above"),
        ((10.0, None, None), "`y` and `u` are both missing"),
        ((10.0, [0.1, 0.1], [np.nan]), "`u` must not hold NaN"),
        ((10.0, [0.1, 0.1], [1.0, 2.0]), "`u` must have 1 entry"),
        ((10.0, [0.1, 0.1], np.array(["high"])), "`u` must hold real numbers"),
        ((10.0, [0.1, 0.1], np.array([1j])), "`u` must be real"),
        ((np.nan, [0.1, 0.1], None), "`t` must be finite"),
        ((3.0, [0.1, 0.1], None), "goes back beyond the window"),
        ((9.0, [0.1, 0.7], None), "was already given as .* duplicates must agree"),
        ((9.0, None, [7.0]), "`u` at t = 9.0 was already given"),
    ],
)
def test_refused_samples_change_nothing(sample, message):
    mhe = MovingHorizonEstimator(DRIVEN, horizon=4.0)
    for t in range(1, 10):
        mhe.update(float(t), [0.1, 0.2], [1.0])
    before = mhe.state
    with pytest.raises(ArgumentError, match=message):
        mhe.update(*sample)
    assert mhe.state is before


def test_repeated_samples_that_agree_are_taken_once():
    mhe = MovingHorizonEstimator(DRIVEN, horizon=4.0)
    first, state = mhe.update(1.0, [0.1, 0.2]), mhe.state
    for again in ([0.1, 0.2], [0.1, np.nan]):
        assert vars(mhe.update(1.0, again)) == vars(first)  # arrays are the same ones
        assert mhe.state is state


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 1), (4, 2)])
def test_an_estimate_is_the_same_whatever_is_remembered_of_its_window(rows, columns):
    """Another estimator that goes on from the same state begins its window anew, from other references."""
    rng = np.random.default_rng(rows)
    A = np.kron(np.eye(max(rows // 2, 1)), [[0.0, 1.0], [-1.0, -0.05]])[:rows, :rows] - 0.1 * np.eye(rows)
    plant = Plant(A, np.eye(rows)[:columns] + np.ones((columns, rows)))
    options = {"horizon": 8.0, "cost": CostFunction(eta=0.2), **BOUNDS, "initial_error": 3.0}
    mhe, t, x = MovingHorizonEstimator(plant, **options), 0.0, np.ones(rows)
    for _ in range(40):
        gap = rng.choice([1.0, rng.uniform(0.5, 1.5)])
        t, x = t + gap, plant.transition(gap) @ x + rng.uniform(-0.01, 0.01, rows)
        sample = (t, plant.C @ x + rng.uniform(-0.05, 0.05, columns), None)
        other = MovingHorizonEstimator(plant, **options).step(mhe.state, sample)[1]
        found = mhe.update(*sample)
        assert found.certified
        np.testing.assert_allclose(other.x, found.x, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(other.radius, found.radius, rtol=1e-13)
        np.testing.assert_allclose(other.cost, found.cost, rtol=1e-12)


def test_nothing_is_kept_from_before_the_oldest_snapshot():
    mhe = MovingHorizonEstimator(PLANT, horizon=2.0)
    for t in range(1, 12):
        mhe.update(float(t), [0.0])
    with pytest.raises(ArgumentError, match=r"`t` must be at least 7\.0, the oldest time kept"):
        mhe.predict(3.0)
    with pytest.raises(ArgumentError, match=r"`t` must be at least 0.0"):
        MovingHorizonEstimator(PLANT, horizon=2.0).update(-1.0, [0.0])


def test_a_solver_that_fails_leaves_the_prediction_and_its_ellipsoid(monkeypatch):
    from sampling_design.estimators.constraints import qp

    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, constraints=Constraints(x=(-0.2, 0.2)), **BOUNDS)
    first = mhe.update(1.0, [0.1])
    monkeypatch.setattr(qp, "active_set", lambda problem: None)
    monkeypatch.setattr(qp, "conic", lambda problem: None)
    estimate = mhe.update(1.5, [3.0])
    assert estimate.status == "solver failed"
    assert estimate.certified
    assert np.allclose(estimate.x, PLANT.transition(0.5) @ first.x)
    assert estimate.radius > first.radius


def test_the_least_horizon_is_that_of_the_proven_lambda_and_own_weights_keep_the_claim():
    certificate = certify(PLANT, PeriodicSchedule([1.0]), eta=0.4)
    paper = min(certificate.horizon("paper").minimum, np.log(2 * certificate.lam_proven) / certificate.eta)
    for form, least in (("certificate", certificate.horizon().minimum), ("paper", paper)):
        same = CostFunction(P2=certificate.P2, eta=certificate.eta, form=form)
        longer = MovingHorizonEstimator(PLANT, certificate, horizon=least * (1 + 1e-9), cost=same)
        assert longer.claim.note == ""
        with pytest.warns(GuaranteeWarning, match="the horizon .* must exceed"):
            MovingHorizonEstimator(PLANT, certificate, horizon=least * (1 - 1e-9), cost=same)
    other = MovingHorizonEstimator(PLANT, certificate, cost=CostFunction(P2=2 * certificate.P2, eta=certificate.eta))
    assert other.claim.note == "No a-priori claim: P2 differ from the certificate's."


def test_constraints_say_what_they_hold_and_refuse_what_they_cannot():
    held = Constraints(x=(-1.0, 1.0), w=ConvexSet.ball(0.1, dimension=2), check_spacing=0.3)
    assert "-1 to 1" in str(held)
    assert "outer" in str(held)
    assert held.explain() == "Constraints on x, w."
    assert Constraints().explain() == "No constraints."
    with pytest.raises(ArgumentError, match='`w_model` must be "outer" or "constant", got \'zoh\''):
        Constraints(w_model="zoh")
    with pytest.raises(ArgumentError, match=r"`engine` must be one of .* got ndarray"):
        Constraints(engine=np.eye(2))
    with pytest.raises(ArgumentError, match="`check_spacing` must be positive"):
        Constraints(check_spacing=0.0)


def test_constraints_bind_past_a_gap_over_which_states_decay_beyond_numbers_in_any_coordinates():
    """The bound is on the slow mode: its estimates are those of that mode alone."""
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    A, G = np.diag([-1000.0, -1.0, -300.0]), np.array([[0.0], [1.0], [0.0]])
    record = [(0.0, [0.5, 0.2, 0.1]), (0.001, [0.2, 0.2, 0.1]), (1.0, [0.0, 0.4, 0.0]), (2.0, [0.0, 0.35, 0.0])]

    def followed(plant, rows, row):
        n = plant.n_states
        cost = CostFunction(P2=np.eye(n), Qw=[[1.0]], R=9 * np.eye(n), Qv=9 * np.eye(n), eta=0.1)
        bounds = {"w_bound": 0.3, "v_bound": np.full(n, 0.3), "initial_error": np.ones(n)}
        below = Constraints(x=ConvexSet.halfspaces(row[None], [0.15]))
        mhe = MovingHorizonEstimator(plant, horizon=10.0, cost=cost, constraints=below, **bounds)
        found = [mhe.update(*sample) for sample in rows]
        assert all(each.certified and each.engine == "active set" for each in found)
        return np.array([row @ each.x for each in found])

    slow = followed(Plant([[-1.0]], [[1.0]]), [(t, y[1:2]) for t, y in record], np.ones(1))
    for R in (np.eye(3), Q):
        found = followed(Plant(R @ A @ R.T, R.T, G=R @ G), record, R[:, 1])
        assert found == pytest.approx(slow, rel=1e-9)
