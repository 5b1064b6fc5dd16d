"""What samples buy: the accuracies of evenly spaced samples side by side, and that of none by an integral."""

import time

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.accuracy import accuracy_by_count, sample_counts
from sampling_design.errors import ArgumentError
from tests.cases import few

PLANT = sd.Plant(
    [[-0.2, 0.1], [0.0, -0.05]], [[1.0, 0.0], [1.0, 1.0]], time_unit="h", states=["a", "b"], outputs=["y", "both"]
)
BOUNDS = {"w_bound": [0.3, 0.1], "v_bound": [0.5, 0.4]}


@pytest.fixture(scope="module")
def found():
    return accuracy_by_count(PLANT, [4, 0, 1], period=20.0, of=["a", "both"], **BOUNDS)


def without(plant, row, w, norm):
    """int over all times of the size of row e^{As} G in the dual norm, by the trapezoidal rule on fine steps."""
    slowest = -np.linalg.eigvals(plant.A).real.max()
    s = np.linspace(0.0, 30.0 / slowest, 6001)
    step = expm(plant.A * s[1])
    rows = [np.asarray(row, float)]
    for _ in s[1:]:
        rows.append(rows[-1] @ step)
    return np.trapezoid(norm((np.array(rows) @ plant.G) * w), s)


@pytest.mark.parametrize("seconds", few([1.0, 1e9, 1e-9], 2))
def test_without_samples_errors_are_what_disturbances_leave(seconds):
    """Bounds on each entry, and on the norm; in any unit of time."""
    plant = sd.Plant(PLANT.A / seconds, PLANT.C, G=np.diag([1.0, 1e6]) / seconds)
    w = np.array([0.3, 1e-7])
    for bound, norm in ((w, lambda g: np.abs(g).sum(axis=1)), (0.3, lambda g: np.linalg.norm(g, axis=1))):
        none = accuracy_by_count(plant, [0], period=seconds, w_bound=bound)
        for k in range(2):
            exact = without(plant, np.eye(2)[k], bound, norm)
            assert none.lower[0, k] <= exact * 1.001
            assert exact * 0.999 <= none.upper[0, k] <= 1.021 * exact


def test_each_count_is_what_guaranteed_accuracy_says_of_it(found):
    assert found.counts == (0, 1, 4)
    for k, many in ((1, 1), (2, 4)):
        schedule = sd.PeriodicSchedule([20.0 / many] * many)
        one = sd.guaranteed_accuracy(PLANT, schedule, rtol=0.02, of=["a", "both"], **BOUNDS)
        assert found.upper[k] == pytest.approx(one.upper, rel=1e-9)
        assert found.lower[k] == pytest.approx(one.lower, rel=1e-9)
    assert np.all(np.diff(found.upper, axis=0) < 0)
    assert np.all(found.lower <= found.upper)
    assert found.verify()
    assert found.closed
    assert "With 4 samples every 20 h: a " in found.explain()
    assert found.rows.names == ("a", "both")


def test_more_samples_never_say_less_where_the_budget_is_spent():
    """Bounds of a divisor hold for its multiples: 6 samples hold 0, 2 and 3; 4 do not hold 3."""
    found = accuracy_by_count(PLANT, (0, 2, 3, 4, 6), period=400.0, rtol=1e-3, budget=1e-9, **BOUNDS)
    own = [one.upper for one in found.accuracies]
    assert np.all(found.upper[4] == np.min([own[k] for k in (0, 1, 2, 4)], axis=0))
    assert np.all(found.upper[3] == np.min([own[k] for k in (0, 1, 3)], axis=0))
    assert np.all(found.upper[0] == own[0])
    assert not found.closed
    assert "a larger `budget`" in found.explain()


@pytest.mark.parametrize(("used", "shares"), [(1.0, [2, 2, 2, 2]), (0.5, [2, 7 / 3, 35 / 12, 105 / 24])])
def test_counts_share_what_is_left_of_the_budget(used, shares, monkeypatch):
    given, clock = [], [0.0]

    def guaranteed(*_, budget, **__):
        given.append(budget)
        clock[0] += used * budget

    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(sample_counts, "guaranteed_accuracy", guaranteed)
    accuracy_by_count(PLANT, (0, 1, 2, 4), period=20.0, budget=8.0, **BOUNDS)
    assert given == pytest.approx(shares)


def test_what_does_not_decay_has_no_bound_without_samples():
    drifting = sd.Plant(np.diag([0.0, -1.0]), np.eye(2), states=["drift", "fast"])
    found = accuracy_by_count(drifting, (0, 3), period=2.0, w_bound=0.1, v_bound=0.1)
    assert np.isinf(found.upper[0, 0])
    assert np.isfinite(found.upper).tolist() == [[False, True], [True, True]]
    assert "Without samples: drift has no bound, fast 0.1" in found.explain()


def test_a_wrong_count_is_refused():
    with pytest.raises(ArgumentError, match="`counts` must hold a number of samples, got none: give"):
        accuracy_by_count(PLANT, [], period=1.0, **BOUNDS)
    for wrong in ([-1], [1.5]):
        with pytest.raises(ArgumentError, match="`counts` must be a whole number of at least 0"):
            accuracy_by_count(PLANT, wrong, period=1.0, **BOUNDS)
    with pytest.raises(ArgumentError, match="`period` must be positive"):
        accuracy_by_count(PLANT, [1], period=0.0, **BOUNDS)
