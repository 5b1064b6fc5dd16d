"""The limit that no schedule beats: close to dense schedules, below every other, verified at all real times."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, UndecidedError
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
BOUNDS = {"w_bound": 0.02, "v_bound": 0.4}


@pytest.fixture(scope="module")
def always():
    return sd.accuracy.accuracy_limit(PLANT, **BOUNDS)


@pytest.mark.long
def test_a_dense_schedule_comes_close(always):
    dense = sd.guaranteed_accuracy(PLANT, sd.PeriodicSchedule([0.05]), rtol=0.02, **BOUNDS)
    assert np.all(always.lower <= dense.upper)
    assert np.all(always.lower >= dense.upper * 0.96)
    assert always.verify()
    assert "no schedule and no estimator knows more" in always.explain()
    assert "all times" in str(always)


@pytest.mark.long
def test_no_schedule_of_the_zones_beats_the_limit(always):
    zones, rng = [(0.2, 0.5), (1.0, 1.0), (1.4, 1.9)], np.random.default_rng(4)
    found = sd.accuracy.accuracy_limit(PLANT, zones=zones, period=2.5, **BOUNDS)
    assert found.verify()
    assert np.all(found.lower >= always.lower * 0.98)
    dense = np.concatenate([np.linspace(0.2, 0.5, 6), [1.0], np.linspace(1.4, 1.9, 9)])
    best = sd.guaranteed_accuracy(PLANT, sd.PeriodicSchedule.from_times(dense, 2.5), rtol=0.05, of="velocity", **BOUNDS)
    assert best.upper[0] * 0.9 <= found.lower[1] <= best.upper[0]
    for _ in range(3):
        times = np.sort([rng.uniform(0.2, 0.5), 1.0, rng.uniform(1.4, 1.9)])
        other = sd.guaranteed_accuracy(PLANT, sd.PeriodicSchedule.from_times(times, 2.5), rtol=0.1, **BOUNDS)
        assert np.all(other.upper >= found.lower)


@pytest.fixture(scope="module")
def zoned():
    return sd.accuracy.accuracy_limit(PLANT, zones=[(0.0, 0.3), (0.9, 1.0)], period=2.0, of="velocity", **BOUNDS)


@pytest.mark.parametrize("name", few(["always", "zoned"], 1))
def test_the_trajectory_hides_between_the_nodes_too(name, request):
    """Flown on a fine grid by another integrator, |C x| keeps its bound at all allowed times, and only there."""
    from scipy.linalg import expm

    found = request.getfixturevalue(name)
    attack, t = found.witnesses[-1], found.witnesses[-1].edges[0]
    joint = np.zeros((4, 4))
    joint[:2, :2], joint[:2, 2:] = PLANT.A, PLANT.G
    x, seen, times = np.zeros(2), [], []
    for h, w in zip(np.diff(attack.edges), attack.w, strict=True):
        step = expm(joint * h / 7)
        for _ in range(7):
            x, t = step[:2] @ np.concatenate([x, w]), t + h / 7
            seen.append(abs(PLANT.C[0] @ x))
            times.append(t - attack.samples[-1] + found.phases[-1])
    seen, allowed = np.array(seen), np.ones(len(seen), dtype=bool)
    if found.zones is not None:
        place = np.mod(times, found.period)
        allowed = np.any([(place >= a - 1e-9) & (place <= b + 1e-9) for a, b in found.zones], axis=0)
        assert seen.max() > 0.41
    assert 0.39 <= seen[allowed].max() <= 0.4 * (1 + 1e-9)
    assert x[1] == pytest.approx(found.lower[-1], rel=1e-6)


def test_a_forged_limit_does_not_verify(always, zoned):
    assert not replace(always, lower=1.01 * always.lower).verify()
    attack = always.witnesses[0]
    louder = replace(attack, w=1.02 * attack.w, states=1.02 * attack.states, value=1.02 * attack.value)
    forged = (louder, always.witnesses[1])
    assert not replace(always, witnesses=forged, lower=1.02 * always.lower).verify()
    assert not replace(always, witnesses=(None, always.witnesses[1])).verify()
    assert zoned.verify()
    assert not replace(zoned, zones=np.array([[0.0, 1.0]])).verify()
    assert not replace(zoned, phases=zoned.phases + 0.5).verify()


@pytest.mark.long
def test_more_allowed_times_never_raise_it():
    wide, narrow = (
        sd.accuracy.accuracy_limit(PLANT, zones=[(0.0, end)], period=2.0, of="velocity", **BOUNDS).lower[0]
        for end in (1.0, 0.3)
    )
    assert wide <= narrow * 1.02


def test_unseen_modes_and_exact_sensors():
    plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]], states=["seen", "unseen"])
    found = sd.accuracy.accuracy_limit(plant, w_bound=0.1, v_bound=0.3)
    assert found.lower[0] == pytest.approx(0.3, rel=0.02)
    assert np.isinf(found.lower[1])
    assert found.unknown == ("0",)
    assert found.verify()
    assert found.to_dict()["lower"][1] is None
    assert sd.accuracy.accuracy_limit(PLANT, w_bound=0.1, v_bound=0.0).lower.tolist() == [0.0, 0.0]


@pytest.mark.long
def test_units_change_nothing(always):
    x, y, t = np.array([1e6, 1e-3]), 1e-4, 1e3
    plant = sd.Plant(PLANT.A * x[:, None] / x / t, PLANT.C * y / x, G=PLANT.G * x[:, None] / t)
    found = sd.accuracy.accuracy_limit(plant, w_bound=0.02, v_bound=0.4 * y, of=[[0.0, 1.0]])
    assert found.lower == pytest.approx(always.lower[1:] * x[1:], rel=0.02)  # its rtol


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"period": 1.0}, "`period` is that of `zones`, which are missing"),
        ({"zones": [(0.0, 1.0)]}, "`zones` need their `period`"),
        ({"zones": [(0.0, 1.0), (0.5, 2.0)], "period": 3.0}, "`zones` must be in order, apart and within"),
        ({"zones": [], "period": 3.0}, "`zones` must hold at least one"),
    ],
)
def test_bad_input_is_refused(change, match):
    with pytest.raises(ArgumentError, match=match):
        sd.accuracy.accuracy_limit(PLANT, **BOUNDS, **change)


def test_what_nothing_drives_stays_at_rest():
    assert sd.accuracy.accuracy_limit(PLANT, w_bound=0.0, v_bound=0.1).lower.tolist() == [0.0, 0.0]


def test_an_undecided_limit_speaks_of_no_schedule():
    """A mode that grows by e^500 until the next allowed time."""
    plant = sd.Plant([[1.0]], [[1.0]])
    with pytest.raises(UndecidedError, match="undecided: the disturbances are so weak beside the noise"):
        sd.accuracy.accuracy_limit(plant, w_bound=0.1, v_bound=0.1, zones=[(0.0, 0.0)], period=500.0)


def test_a_spent_budget_leaves_what_was_attained_and_says_so():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    whole, spent = (sd.accuracy.accuracy_limit(plant, w_bound=0.02, v_bound=0.1, budget=b) for b in (None, 1e-9))
    assert (whole.closed, spent.closed) == (True, False)
    assert np.all(spent.lower <= whole.lower)
    assert spent.verify()
    assert "budget" in spent.explain()
    assert "budget" not in whole.explain()
    assert "ended by its budget" in str(spent)


MODES = sd.Plant([[0.0, 1.0, 0.0], [-1.0, -0.1, 0.0], [0.0, 0.0, 0.05]], [[1.0, 0.0, 1.0]])


def nearly_dependent(condition):
    """T of that condition number."""
    rng = np.random.default_rng(5)
    first, second = (np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(2))
    return first * np.geomspace(1.0, condition, 3) @ second


@pytest.mark.parametrize(
    ("condition", "why"),
    [
        (1e6, "that the adversary cannot be followed in doubles"),
        (3e7, "rounding in the coordinates of this plant hides that its outputs show the modes? with"),
    ],
)
def test_states_that_nearly_depend_on_each_other_have_no_wrong_limit(condition, why):
    """Of x = T z, where outputs show every mode up to rounding: it is not infinite."""
    T = nearly_dependent(condition)
    same = sd.Plant(T @ MODES.A @ np.linalg.inv(T), MODES.C @ np.linalg.inv(T), G=T)
    assert not sd.observability.unobservable_modes(same)
    with pytest.raises(UndecidedError, match=rf"{why}.*give the plant in other states z, x = T z, and ask for x by"):
        sd.accuracy.accuracy_limit(same, w_bound=0.1, v_bound=0.1)


@pytest.mark.long
def test_rows_of_other_states_have_the_limit_that_nearly_dependent_ones_have_not():
    found = sd.accuracy.accuracy_limit(MODES, w_bound=0.1, v_bound=0.1, of=nearly_dependent(3e7))
    assert found.verify()
    assert np.all((found.lower > 0) & np.isfinite(found.lower))
