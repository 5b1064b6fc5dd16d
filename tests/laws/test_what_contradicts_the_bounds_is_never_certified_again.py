"""Both proofs have one verdict: what ellipsoid or interval disproves is certified nowhere until `reset`."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.estimators.online.curve import estimate_curve
from sampling_design.estimators.online.history import DEEPEST, SampleBranch
from sampling_design.estimators.record_intervals import estimates_despite_outliers
from tests.cases import few, scale_weights

WALK = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["gauge"])
SPRING = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["level", "rate"], outputs=["gauge"])
BOUNDS = {"w_bound": 0.1, "v_bound": 0.2, "initial_error": 5.0}
ROWS = [(1.0, [1.0]), (3.0, [0.5]), (4.2, [2.0]), *((4.2 + 0.5 * k, [2.0]) for k in range(1, 41))]
"""The third sample contradicts the bounds, and no ellipsoid sees it."""
FAR = [(1.0, [1.0]), (2.0, [90.0]), *((2.0 + 0.5 * k, [1.0]) for k in range(1, 41))]
"""The second one does for any proof."""

MAKERS = {
    "moving horizon": lambda plant=WALK, bounds=BOUNDS: sd.MovingHorizonEstimator(
        plant, horizon=6.0, cost=sd.CostFunction(eta=0.2), **bounds
    ),
    "filter": lambda plant=WALK, bounds=BOUNDS: sd.KalmanFilter(
        plant, cost=sd.CostFunction(eta=0.2), maximum_delay=3.0, **bounds
    ),
    "set": lambda plant=WALK, bounds=BOUNDS: sd.SetMembershipEstimator(plant, maximum_delay=3.0, **bounds),
}


def stands(estimate):
    """Whether an estimate claims anything, in any of its forms."""
    radii, data = estimate.radii, estimate.to_dict()
    nothing = bool(np.isnan(radii).all())
    assert nothing == bool(np.isnan(radii).any()) == (data["radii"] == [None] * len(radii))
    assert data["certified"] == estimate.certified == (not nothing)
    assert nothing == (estimate.contradiction is not None) == (data["contradiction"] is not None)
    assert nothing == np.isnan(estimate.radius) == ("contradict the bounds" in estimate.note)
    assert nothing == ("contradict the bounds" in estimate.explain())
    assert ("certified yes" in " ".join(str(estimate).split())) == (not nothing)
    moved = estimate.centred()
    assert moved.certified == (not nothing)
    assert bool(np.isnan(moved.radii).all()) == nothing
    return not nothing


@pytest.mark.parametrize(("maker", "rows"), few(product(MAKERS, [ROWS, FAR]), 0))
def test_a_contradiction_stays_until_reset(maker, rows):
    estimator = MAKERS[maker]()
    broken = 2 if rows is ROWS else 1
    for k, row in enumerate(rows):
        estimate = estimator.update(*row)
        assert stands(estimate) == (k < broken)
        assert stands(estimator.predict(row[0] + 0.3)) == (k < broken)
        assert stands(estimator.predict(row[0])) == (k < broken)
    estimator.start([2.0], rows[-1][0])
    assert stands(estimator.update(rows[-1][0] + 1.0, [2.0]))


@pytest.mark.parametrize("maker", few(MAKERS, 0))
def test_the_record_says_one_thing_in_all_its_forms(maker):
    record = MAKERS[maker]().run(ROWS)
    data, frame = record.to_dict(), record.to_frame()
    known = np.isfinite(record.radii).all(axis=1)
    assert known.tolist() == [True, True, *[False] * (len(ROWS) - 2)]
    assert record.certified.tolist() == data["certified"] == frame["certified"].tolist() == known.tolist()
    assert [radii == [None] for radii in data["radii"]] == (~known).tolist()
    assert np.isnan(record.radius[2:]).all()
    assert record.status[2] == data["status"][2] == "bounds disproved"
    assert "2 of them with a proven radius" in record.explain()
    assert "contradict" in record.explain()
    assert len(record.first_contradictions) == len(data["contradictions"]) == 1
    assert record.centred().certified.tolist() == known.tolist()


def test_the_sample_that_is_named_would_do_with_so_much_more_noise():
    """Alone: with its noise times the factor the rest agrees, with a hundredth less it does not."""
    cost = scale_weights(SPRING)
    estimator = sd.KalmanFilter(SPRING, cost=cost, w_bound=0.02, v_bound=0.1, initial_error=2.0)
    truth = [(t, [float(np.cos(t)) + (0.9 if t == 3.0 else 0.0)]) for t in (0.5, 1.2, 2.1, 3.0, 3.6, 4.1)]
    for count, row in enumerate(truth, 1):
        estimate = estimator.update(*row)
        estimate.interval()
        if (found := estimate.contradiction) is not None:
            truth = truth[:count]
            break
    assert (found.t, found.number, found.output, found.alone) == (3.0, 4, "gauge", True)
    told = sd.state_interval(SPRING, truth, w_bound=0.02, v_bound=0.1, initial_error=2.0, prior_time=0.0).readings
    for factor, agrees in ((found.factor, True), (0.99 * found.factor, False)):
        rows = tuple(
            tuple(row._replace(size=0.1 * (factor if t == 3.0 else 1.0)) for row in rows)
            for t, rows in zip(told.times, told.rows, strict=True)
        )
        assert RecordProgram(replace(told, rows=rows)).contradicted == (not agrees)


def test_a_curve_shows_nothing_from_there_on():
    rows = sd.Measurements(WALK, [t for t, _ in ROWS[:8]], [y for _, y in ROWS[:8]])
    curve = estimate_curve(MAKERS["filter"](), rows, 3)
    lost = curve.tube.times > ROWS[2][0]
    assert np.isfinite(curve.tube.upper[~lost]).sum() > 3
    assert np.isnan(curve.tube.upper[lost]).all()


def test_another_future_of_the_same_past_knows_nothing_of_it():
    estimator = MAKERS["filter"]()
    for row in ROWS[:2]:
        state = estimator.update(*row) and estimator.state
    wrong, estimate = estimator.step(state, ROWS[2])
    right, other = estimator.step(state, (4.2, [0.5]))
    assert not stands(estimate)
    assert stands(other)
    assert not stands(estimator.step(wrong, (5.0, [0.5]))[1])
    assert stands(estimator.step(right, (5.0, [0.5]))[1])


@pytest.mark.parametrize("maker", MAKERS)
def test_a_late_sample_does_not_make_it_forgotten(maker):
    estimator = MAKERS[maker]()
    for row in ROWS[:5]:
        estimate = estimator.update(*row)
        estimate.interval()
    assert not stands(estimator.update(4.5, [2.0]))


def test_branches_know_where_they_left():
    whole = SampleBranch()
    first = whole.after(0)
    assert first is whole
    assert first.after(1) is whole
    branch = first.after(1)
    assert branch is not whole
    assert branch.after(2) is branch
    whole.record(2, "late")
    assert [whole.contradiction(k) for k in (1, 2, 9)] == [None, "late", "late"]
    assert branch.contradiction(9) is None
    whole.record(1, "early")
    assert branch.contradiction(2) == "early"
    branch.record(3, "own")
    assert [branch.contradiction(k) for k in (0, 1, 3)] == [None, "early", "own"]
    for _ in range(2 * DEEPEST):
        branch, old = SampleBranch(branch, 3), branch
    assert old._depth <= DEEPEST
    assert branch.contradiction(4) == "own"


@pytest.mark.parametrize("bound", [0.5, [0.5, 0.25]], ids=["norm", "entries"])
@pytest.mark.parametrize("kind", ["moving horizon", "filter"])
def test_the_factor_of_one_output_of_several_is_the_least_that_serves(kind, bound):
    """A bound on the norm is that of the whole sample; it had to be "inf times as large"."""

    def followed(v_bound):
        plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
        cost = scale_weights(plant, eta=0.1)
        given = {"cost": cost, "w_bound": 0.1, "v_bound": v_bound, "initial_error": 1.0}
        if kind == "filter":
            return sd.KalmanFilter(plant, **given).update(1.0, [100.0, 0.0])
        return sd.MovingHorizonEstimator(plant, horizon=5.0, **given).update(1.0, [100.0, 0.0])

    found = followed(bound).contradiction
    assert (found.output, found.number, found.alone) == ("a", 1, True)
    assert np.isfinite(found.factor)
    share = np.array([found.factor, 1.0]) if np.ndim(bound) else found.factor
    assert followed(np.multiply(bound, share * (1 + 1e-6))).contradiction is None
    assert followed(np.multiply(bound, 0.99 * share)).contradiction is not None


@pytest.mark.parametrize("kind", ["moving horizon", "filter"])
def test_an_exact_sensor_that_is_wrong_needs_no_factor_in_words(kind):
    """Nothing times 0 suffices: a note says so, instead of "inf times as large"."""
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
    given = {"cost": scale_weights(plant, eta=0.1), "w_bound": 0.0, "v_bound": [0.0, 0.0], "initial_error": 1.0}
    made = (
        sd.KalmanFilter(plant, **given) if kind == "filter" else sd.MovingHorizonEstimator(plant, horizon=5.0, **given)
    )
    made.update(1.0, [0.1, 0.0])
    found = made.update(2.0, [50.0, 0.0])
    assert found.contradiction.factor == np.inf
    assert "no factor of" in found.note
    assert "inf times" not in found.note


@pytest.mark.parametrize("seed", few(range(14), 0, 4))
@pytest.mark.parametrize("kind", ["moving horizon", "filter"])
def test_no_factor_of_an_exact_sensors_noise_serves_where_disturbances_are_larger(kind, seed):
    """What gains of a row's two ends disprove together, the same readings were said to agree with: a factor of 1."""
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    given = {"cost": scale_weights(plant, eta=0.1), "w_bound": 0.02, "v_bound": 0.0, "initial_error": 3.0}
    made = (
        sd.KalmanFilter(plant, **given) if kind == "filter" else sd.MovingHorizonEstimator(plant, horizon=20.0, **given)
    )
    times, rng = np.array([0.81, 2.41, 3.95, 5.5]), np.random.default_rng(seed)
    for t, y in zip(times, np.cos(times + 0.3) + 0.3 * rng.uniform(-1, 1, 4), strict=True):
        found = made.update(t, [y])
        found.interval()
        if found.contradiction is not None:
            break
    assert found.contradiction is not None
    assert found.contradiction.factor == np.inf or not found.contradiction.alone


@pytest.mark.parametrize(("maker", "rows"), few(product(MAKERS, [ROWS, FAR]), 0, 3, 4))
def test_without_the_sample_that_a_contradiction_names_everything_stands_again(maker, rows):
    """As the batch without it, and a correction does the same; a sample more mends nothing."""
    estimator, batch, corrected, other = (MAKERS[maker]() for _ in range(4))
    first = rows[:3]
    for each in (estimator, corrected, other):
        for row in first:
            wrong = each.update(*row)
            assert wrong.radii.shape == (1,)  # asked for, so that intervals have their say
    assert not stands(wrong)
    named = wrong.contradiction
    found = estimator.withdraw(named.t, named.output)
    assert stands(found)
    for row in first:
        if row[0] != named.t:
            wanted = batch.update(*row)
    assert (found.t, found.radii.round(9).tolist()) == (wanted.t, wanted.radii.round(9).tolist())
    assert stands(corrected.correct(named.t, [1.0 if rows is FAR else 0.6]))
    assert not stands(other.update(first[-1][0] + 0.1, [first[-1][1][0]]))
    assert other.state.last.number == len(first) + 1


@pytest.mark.parametrize(("maker", "wild"), few(product(MAKERS, range(3)), 0, 2, 4, 8))
def test_the_sensor_that_is_named_is_the_one_that_contradicts(maker, wild):
    """Of sensors that read the same, one of them in other units, the wild one alone was read, and is named."""
    plant = sd.Plant([[0.0]], [[1.0], [1.0], [10.0]], outputs=["gauge", "lab", "other unit"])
    estimator = MAKERS[maker](plant, {**BOUNDS, "v_bound": [0.2, 0.2, 2.0]})
    for t, level in ((1.0, 1.0), (3.0, 0.5), (4.2, 1.1)):  # no ellipsoid sees what the interval proves
        y = np.full(3, np.nan)
        y[wild] = plant.C[wild, 0] * level
        estimate = estimator.update(t, y)
    assert not stands(estimate)
    assert estimate.contradiction.output == plant.outputs.names[wild]


def test_where_outliers_leave_no_case_the_sensor_is_named_too():
    """One of these samples may be an outlier, and any three of them contradict each other."""
    plant = sd.Plant([[0.0]], [[10.0], [1.0]], outputs=["other unit", "gauge"])
    given = {"w_bound": 0.1, "v_bound": [2.0, 0.2], "initial_error": 50.0}
    estimator = sd.MovingHorizonEstimator(plant, horizon=6.0, cost=sd.CostFunction(eta=0.2), **given)
    record = sd.Measurements(plant, [1.0, 2.0, 3.0, 4.0], [[np.nan, level] for level in (0.0, 4.0, 8.0, 12.0)])
    (*_, last), *_ = estimates_despite_outliers(estimator, record, given, 1)
    assert not stands(last)
    assert last.contradiction.output == "gauge"
