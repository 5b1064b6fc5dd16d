"""Intervals of estimates: bounds and constraints enter, nothing is wider than it was, and the proof can be checked."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.interval import prove, state_interval
from sampling_design.accuracy.readings import Readings, RowReading
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.evidence import EstimateEvidence
from sampling_design.records.declarations import above
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]], states=["position", "velocity"])
WALK = sd.Plant([[0.0]], [[1.0]])
TIMES = [0.7, 2.3, 3.2, 5.2, 5.9]
RECORD = [(t, [np.sin(t)], None) for t in TIMES]
GIVEN = {"w_bound": 0.02, "v_bound": 0.2}
MAKERS = {
    "moving horizon": lambda **o: sd.MovingHorizonEstimator(PLANT, horizon=20.0, **(GIVEN | o)),
    "short horizon": lambda **o: sd.MovingHorizonEstimator(PLANT, horizon=1.5, **(GIVEN | o)),
    "filter": lambda **o: sd.KalmanFilter(PLANT, **(GIVEN | o)),
}


def followed(estimator, record=RECORD):
    return [estimator.update(*row) for row in record][-1]


@pytest.mark.parametrize("maker", MAKERS)
def test_every_estimator_says_what_the_record_says(maker):
    estimator = MAKERS[maker](initial_error=[2.0, 2.0])
    estimate = followed(estimator)
    alone = state_interval(PLANT, RECORD, initial_error=[2.0, 2.0], prior_time=0.0, **GIVEN)
    found = estimate.interval()
    assert found.lower == pytest.approx(alone.lower, rel=1e-4)
    assert found.verify()
    assert estimate.radii == pytest.approx(np.maximum(alone.upper - estimate.x, estimate.x - alone.lower), rel=1e-4)
    assert np.all(estimate.radii < estimate.ellipsoid_radii)
    later = estimator.predict(8.0)
    beyond = state_interval(PLANT, RECORD, 8.0, initial_error=[2.0, 2.0], prior_time=0.0, **GIVEN)
    assert later.interval().upper == pytest.approx(beyond.upper, rel=1e-4)
    (row,) = estimate.interval([[1.0, -1.0]]).radii
    assert row < np.sum(found.radii)
    assert estimate.interval("velocity").upper[0] == found.upper[1]


@pytest.mark.parametrize("growth", few([36.0, 60.0, 100.0], 0))
def test_whatever_grows_between_samples_it_is_never_wider_than_the_ellipsoid(growth):
    """Up to e^100 a gap: covariance times radius is no number, their roots are."""
    for A, C in (([[growth]], [[1.0]]), ([[growth, 1.0], [-1.0, growth]], [[1.0, 0.0]])):
        estimator = sd.MovingHorizonEstimator(sd.Plant(A, C), horizon=3.0, initial_error=1.0, **GIVEN)
        estimate = followed(estimator, [(t, [0.01], None) for t in np.arange(1.0, 6.0)])
        found, half = estimate.interval(), estimate.ellipsoid_radii
        assert estimate.certified
        assert np.all(found.upper <= estimate.x + half * (1 + 1e-12))
        assert np.all(found.lower >= estimate.x - half * (1 + 1e-12))
        assert found.upper[0] <= 0.01 + 0.2 * (1 + 1e-6)  # that of the reading alone
        assert found.verify()


def test_without_a_first_error_there_is_an_interval_but_no_ellipsoid():
    estimate = followed(MAKERS["filter"]())
    assert not estimate.certified
    assert np.isinf(estimate.ellipsoid_radii).all()
    assert np.isfinite(estimate.radii).all()
    assert "state by state" in estimate.explain()


def test_without_a_bound_there_is_none():
    estimate = followed(sd.KalmanFilter(PLANT, v_bound=0.2, initial_error=1.0))
    assert np.isinf(estimate.radii).all()
    with pytest.raises(ArgumentError, match="`w_bound` and `v_bound` must be given to the estimator"):
        estimate.interval()


def test_a_long_record_keeps_its_past_in_its_first_ellipsoid():
    times = np.cumsum(np.random.default_rng(0).uniform(0.3, 1.2, 60))
    record = [(float(t), [np.sin(t)], None) for t in times]
    estimate = followed(MAKERS["filter"](initial_error=2.0), record)
    found = estimate.interval()
    assert len(found.readings.times) == 25
    assert found.readings.start.ball
    whole = state_interval(PLANT, record, **GIVEN)
    assert found.radii == pytest.approx(whole.radii, rel=0.01)
    assert found.holds([np.sin(times[-1]), np.cos(times[-1])])


def test_constraints_narrow_it_and_are_in_the_proof():
    free = followed(MAKERS["moving horizon"](initial_error=2.0))
    for sets in (
        {"x": ([-0.9, -2.0], [2.0, 0.95])},
        {"x": sd.estimators.ConvexSet.halfspaces([[-1.0, 1.0]], [1.36])},
        {"v": (-0.05, 0.05)},
        {"v": (0.0, 0.2)},
        {"w": (-0.01, 0.0)},
        {"w": sd.estimators.ConvexSet.ball(0.004, centre=[0.001, 0.0])},
    ):
        estimate = followed(MAKERS["moving horizon"](initial_error=2.0, constraints=sd.Constraints(**sets)))
        found = estimate.interval()
        assert found.verify(), sets
        assert np.all(found.radii <= free.interval().radii * (1 + 1e-6)), sets
        assert np.any(found.radii < 0.98 * free.interval().radii), sets
        if "x" in sets:
            assert not replace(found, gains=-found.gains).verify()


def test_a_constraint_counts_ahead_of_the_samples_too():
    box = MAKERS["moving horizon"](initial_error=2.0, constraints=sd.Constraints(x=([-9.0, -9.0], [0.8, 9.0])))
    followed(box)
    assert box.predict(7.9).interval().upper[0] <= 0.8 + 1e-6


def test_bounds_and_sets_must_meet():
    with pytest.raises(ArgumentError, match=r"`w_bound` and `constraints\.w` must have something in common"):
        MAKERS["moving horizon"](constraints=sd.Constraints(w=(1.0, 2.0)))


def test_a_contradiction_is_told_by_the_interval_first():
    wrong = [(t, [y[0] + (0.7 if k == 3 else 0.0)], u) for k, (t, y, u) in enumerate(RECORD)]
    estimate = followed(MAKERS["moving horizon"](initial_error=2.0), wrong)
    assert estimate.certified  # the ellipsoid does not see it
    found = estimate.interval().disproof
    assert found.factors["all"] > 1
    assert found.factors["v"] > found.factors["all"]
    assert found.verify()
    assert 5.2 in found.times
    assert np.isnan(estimate.radii).all()
    assert "contradict the bounds" in estimate.explain()
    assert not replace(found, factors={"v": 1.01 * found.factors["v"]}).verify()


def test_a_mean_over_a_day_is_a_row_of_its_own():
    """A constant level, read as a mean: the same as reading it; a ramp: its middle."""
    tank = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    still = BoundedSet.box(np.zeros(2), np.zeros(2))
    rows = [(2.0, (RowReading(tank.C[0], 1.0, 0.1, since=0.0),)), (6.0, (RowReading(tank.C[0], 5.0, 0.1, since=4.0),))]
    readings = Readings.unread(tank, still, BoundedSet.of("initial_error", None, tank.states.names), 0.0).reading(rows)
    assert readings.times.tolist() == [0.0, 2.0, 4.0, 6.0]
    found = prove(RecordProgram(readings), 6.0, sd.plants.functional.requested_rows(tank))
    # x(1) = 1 +- .1 and x(5) = 5 +- .1: slope 1 +- .05, x(6) = 6 +- .15
    assert found.centre == pytest.approx([6.0, 1.0], abs=1e-6)
    assert found.radii == pytest.approx([0.15, 0.05], abs=1e-6)
    assert found.verify()


@pytest.mark.parametrize("since", [-1.0, 1.0])
def test_a_mean_lies_after_the_start_and_after_the_mean_before(since):
    rows = [
        (2.0, (RowReading(PLANT.C[0], 1.0, 0.1, since=0.0),)),
        (3.0, (RowReading(PLANT.C[0], 1.0, 0.1, since=since),)),
    ]
    push = BoundedSet.box(np.zeros(2), np.ones(2))
    with pytest.raises(ArgumentError, match=r"of the mean read at 3\.0 lies before the start or in the mean before it"):
        Readings.unread(PLANT, push, BoundedSet.of("initial_error", None, PLANT.states.names), 0.0).reading(rows)


def test_the_set_membership_estimator_returns_the_centre():
    estimator = sd.SetMembershipEstimator(PLANT, **GIVEN)
    first = estimator.update(*RECORD[0])
    assert np.isfinite(first.radii[0])
    assert np.isinf(first.radii[1])
    assert not first.certified
    for row in RECORD[1:]:
        estimate = estimator.update(*row)
        truth = np.array([np.sin(row[0]), np.cos(row[0])])
        assert estimate.certified
        assert estimate.holds(truth)
        assert np.all(np.abs(truth - estimate.x) <= estimate.radii)
    alone = state_interval(PLANT, RECORD, **GIVEN)
    assert estimate.x == pytest.approx(alone.centre, abs=1e-4)
    assert estimate.radii == pytest.approx(alone.radii, rel=1e-4)
    other = followed(MAKERS["filter"]())
    assert np.all(estimate.radii <= other.radii * (1 + 1e-6))
    known = followed(sd.SetMembershipEstimator(PLANT, constraints=sd.Constraints(x=([-9, -9], [9, 0.95])), **GIVEN))
    assert known.radii[1] < 0.98 * estimate.radii[1]
    later = estimator.predict(7.0)
    assert later.holds([np.sin(7.0), np.cos(7.0)])
    wrong = estimator.update(6.4, [5.0])
    assert (wrong.status, wrong.certified) == ("bounds disproved", False)
    assert np.isnan(wrong.radii).all()
    assert "contradict the bounds" in wrong.note
    refusal = r"`v_bound` is missing: without it no set is bounded\. Give 0 where there is none\."
    with pytest.raises(ArgumentError, match=refusal):
        sd.SetMembershipEstimator(PLANT, w_bound=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_an_estimate_moves_into_the_middle_of_its_interval(seed):
    """Its radii are the half-widths, never more than before; its ellipsoid holds the box."""
    rng = np.random.default_rng(seed)
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    kalman = sd.KalmanFilter(plant, w_bound=0.05, v_bound=0.3, initial_error=2.0)
    x, now, found = rng.uniform(-1, 1, 2), 0.0, []
    for t in np.cumsum(rng.uniform(0.4, 1.2, 8)):
        x, now = plant.transition(t - now) @ x, t
        found.append(kalman.update(float(t), plant.C @ x + rng.uniform(-0.3, 0.3, 1)))
        moved = found[-1].centred()
        assert np.allclose(moved.x, found[-1].interval().centre, atol=1e-6)
        assert np.all(moved.radii <= found[-1].radii + 1e-9)
        assert np.all(np.abs(moved.x - x) <= moved.radii)
        assert np.allclose(moved.interval().radii_from(moved.x), moved.radii, rtol=1e-4)
        assert moved.holds(x)
        assert moved.certified
        assert not moved.on_schedule
        assert moved.note == "Moved into the middle of what the data prove."
    record = sd.estimators.EstimateRecord.collect(plant, found)
    assert np.array_equal(record.centred().x, [estimate.centred().x for estimate in found])


def test_programs_are_solved_once_for_radii_interval_and_middle(monkeypatch):
    asked, own = [], EstimateEvidence.interval

    def counted(evidence, *given):
        asked.append(given)
        return own(evidence, *given)

    monkeypatch.setattr(EstimateEvidence, "interval", counted)
    bounds = {"w_bound": 0.1, "v_bound": 0.3, "initial_error": 2.0}
    kalman = sd.KalmanFilter(sd.Plant([[0.0]], [[1.0]]), **bounds)
    first, later = kalman.update(0.0, [1.0]), kalman.update(1.0, [1.5])
    for found in (later, later.centred(), later.centred().centred()):
        assert np.array_equal(found.radii, later.interval().radii_from(found.x))
    assert len(asked) == 1
    assert not np.array_equal(first.radii, later.radii)
    assert len(asked) == 2
    later.interval([[2.0]])
    assert len(asked) == 3
    walk = sd.SetMembershipEstimator(sd.Plant([[0.0]], [[1.0]]), **bounds)
    assert np.all(walk.update(0.0, [1.0]).radii > 0)
    assert len(asked) == 4


def test_estimates_of_a_record_keep_one_program_between_them(monkeypatch):
    """Each takes megabytes where gaps are long: of a record of hundreds of rows, gigabytes."""
    made, initial = [], RecordProgram.__init__

    def counted(self, *given):
        made.append(weakref.ref(self))
        initial(self, *given)

    monkeypatch.setattr(RecordProgram, "__init__", counted)
    mhe = MAKERS["moving horizon"](initial_error=[2.0, 2.0])
    estimates = [mhe.update(*row) for row in RECORD]
    radii = [estimate.radii for estimate in estimates]
    gc.collect()
    assert len(made) >= len(estimates)
    assert sum(program() is not None for program in made) == 1
    one = estimates[1].interval([[1.0, 0.0]])  # posed anew
    assert one.radii_from(estimates[1].x[:1]) == pytest.approx(radii[1][:1], rel=1e-9)


def test_what_cannot_be_moved_says_why():
    walk = sd.Plant([[0.0]], [[1.0]])
    with pytest.raises(ArgumentError, match="`w_bound` and `v_bound` must be given to the estimator"):
        sd.KalmanFilter(walk).update(1.0, [0.0]).centred()
    wide = sd.KalmanFilter(sd.Plant(np.diag([0.0, 0.1]), [[1.0, 0.0]]), w_bound=0.1, v_bound=0.1)
    half = wide.update(1.0, [0.3]).centred()
    assert np.isinf(half.radii[1])
    assert not half.certified
    torn = sd.KalmanFilter(walk, w_bound=0.1, v_bound=0.1, initial_error=1.0)
    torn.update(1.0, [0.0])
    assert torn.update(2.0, [3.0]).centred().status == "bounds disproved"


def test_an_estimate_says_what_its_radii_would_be_in_the_middle_of_its_interval():
    """And says so of none that lies there, or of which nothing is proven."""
    kalman = sd.KalmanFilter(WALK, w_bound=0.1, v_bound=0.3, initial_error=2.0)
    kalman.update(0.0, [1.0])
    found = kalman.update(1.0, [1.5])
    moved = found.centred()
    assert moved.radii[0] < found.radii[0]
    least = above(moved.radii)
    assert f"would be within {least}: `centred()`." in found.explain()
    assert dict(found._rows())["if centred"] == least
    assert f"({least} if `centred()`)" in str(sd.estimators.EstimateRecord.collect(WALK, [found]))
    assert "centred()" not in moved.explain()
    assert "if centred" not in dict(moved._rows())
    assert "centred()" not in sd.KalmanFilter(WALK).update(1.0, [0.0]).explain()


def walked(centred=None, **options):
    """One reading of 1.2 of a state that stays where it is: with noise of .3 it lies in [.9, 1.5]."""
    given = {"w_bound": 0.0, "v_bound": 0.3, "initial_error": 3.0, **options}
    estimator = sd.MovingHorizonEstimator(sd.Plant([[0.0]], [[1.0]]), horizon=3.0, **given)
    return estimator.run([(1.0, [1.2])], centred=centred)


def test_an_estimate_of_a_record_lies_in_the_middle_unless_asked_otherwise(monkeypatch):
    found, own = walked(), walked(centred=False)
    assert (found.x[0, 0], found.radii[0, 0]) == pytest.approx((1.2, 0.3), abs=1e-6)
    assert found.explain() == (
        "1 estimate, each in the middle of what data and bounds allow, 1 of them with a proven radius."
    )
    assert own.x[0, 0] < 1.19
    assert own.x[0, 0] + own.radii[0, 0] == pytest.approx(1.5, abs=1e-6)
    assert walked(cost=sd.CostFunction()).x[0, 0] == own.x[0, 0]
    assert walked(cost=sd.CostFunction(), centred=True).x[0, 0] == found.x[0, 0]
    assert "middle" not in walked(w_bound=None).explain()
    with pytest.raises(ArgumentError, match="`w_bound` and `v_bound` must be given to the estimator"):
        walked(w_bound=None, centred=True)
    monkeypatch.setattr("sampling_design.estimators.online.in_order.MOST_INTERVALS", 0)
    assert walked().x[0, 0] == own.x[0, 0]
