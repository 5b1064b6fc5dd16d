"""The tube between samples holds every adversarial truth at all times, and is hardly wider than the intervals."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.online.tube import joined

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
GIVEN = {"w_bound": 0.05, "v_bound": 0.2, "initial_error": 0.7}


@pytest.mark.parametrize("points", [4, 13])
def test_the_tube_holds_the_truth_between_its_points(points):
    for seed in range(3):
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
