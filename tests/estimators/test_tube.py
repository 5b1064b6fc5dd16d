"""The tube between samples holds every adversarial truth at all times, and is hardly wider than the intervals."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.online.curve import CurveCollector
from sampling_design.estimators.online.estimate import joined
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
GIVEN = {"w_bound": 0.05, "v_bound": 0.2, "initial_error": 0.7}


@pytest.mark.parametrize("points", few([4, 13], 0))
def test_the_tube_holds_the_truth_between_its_points(points):
    for seed in range(1):
        rng = np.random.default_rng(seed)
        estimator = sd.KalmanFilter(PLANT, prior=[0.5, 0.5], **GIVEN)
        x, last = np.array([0.5, 0.5]) + rng.uniform(-0.4, 0.4, 2), 0.0
        for gap in rng.uniform(0.4, 2.5, 6):
            times = np.linspace(last, last + gap, points)
            ahead = [estimator.predict(t) for t in times]
            tube = ahead[0].proof.tube(times, np.array([each.x for each in ahead]))
            w = rng.normal(size=2)
            w *= 0.05 / np.linalg.norm(w)
            pushed = sd.Plant(np.block([[PLANT.A, w[:, None]], [np.zeros((1, 3))]]), [[1.0, 0.0, 0.0]])
            for d in np.linspace(0.0, gap, 50):
                truth = (pushed.transition(d) @ [*x, 1.0])[:2]
                low = [np.interp(last + d, times, tube.lower[:, i]) for i in range(2)]
                high = [np.interp(last + d, times, tube.upper[:, i]) for i in range(2)]
                assert np.all((low <= truth) & (truth <= high))
            exact = ahead[-1].interval()
            slack = 0.6 if points == 4 else 0.12
            assert np.all(tube.upper[-1] - tube.lower[-1] <= 2 * (1 + slack) * exact.radii)
            x, last = truth, last + gap
            estimator.update(last, [x[0] + rng.uniform(-0.2, 0.2)])


def test_contradicting_data_have_no_tube():
    estimator = sd.KalmanFilter(PLANT, **GIVEN)
    wrong = estimator.update(1.0, [9.0])
    tube = wrong.proof.tube(np.array([1.0, 2.0]), np.zeros((2, 2)))
    assert np.isnan(tube.upper).all()
    assert joined([]) is None
    assert joined([tube, tube]).times.tolist() == [1.0, 2.0, 1.0, 2.0]


def test_a_centred_curve_is_the_middle_of_its_tube():
    """From the middle of the interval at a sample on; where nothing is bounded it is the estimator's."""

    def followed(estimator):
        following = CurveCollector(estimator, points=3, centred=True)
        for t, y in ((0.8, [0.6]), (2.1, [0.7])):
            following.before(t)
            following.after(t, estimator.update(t, y).centred())
        return following.curve(sd.Measurements(PLANT, [0.8, 2.1], [[0.6], [0.7]]))

    curve = followed(sd.KalmanFilter(PLANT, **GIVEN))
    middle, x = curve.tube.middle, curve.estimates.x
    assert np.array_equal(x[5:8], middle[5:])
    assert np.allclose(x[4], middle[4], atol=0.05 * curve.estimates.radii[4])
    assert not np.allclose(x[5:8], [sd.KalmanFilter(PLANT, **GIVEN).predict(t).x for t in curve.tube.times[5:]])
    free = followed(sd.KalmanFilter(PLANT, w_bound=0.05, v_bound=0.2))
    assert np.isinf(free.tube.upper[:4]).all()
    assert np.array_equal(free.estimates.x[:4], np.zeros((4, 2)))
