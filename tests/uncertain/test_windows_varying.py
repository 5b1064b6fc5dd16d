"""Windows along plants that vary in time: transitions with proven errors, sigma against scans and closed forms."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.uncertain.plants import time_varying
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant
from tests.cases import few

J, C = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]])
SAMPLES = sd.Schedule([0.0, 1.0, 2.2, 4.0, 5.801, 7.0, 8.2, 10.0])
KNOTS = np.array([0.0, 1.3, 4.0, 7.7, 10.0])
RATES = np.array([0.3, -0.4, 0.1, -0.2, 0.5])
SWING = TimeVaryingPlant.from_table(KNOTS, [r * np.eye(2) + (1 + r) * J for r in RATES], [C] * 5)


def integral(values, a, b):
    """Of the table from a to b: trapezoids are exact."""
    cut = np.unique(np.concatenate([KNOTS[(a < KNOTS) & (b > KNOTS)], [a, b]]))
    heights = np.interp(cut, KNOTS, values)
    return float(np.sum(np.diff(cut) * (heights[1:] + heights[:-1]) / 2))


def flow(a, b):
    """Phi(b, a): growth and rotation commute."""
    sign, (low, high) = (1, (a, b)) if b >= a else (-1, (b, a))
    angle, grown = sign * integral(1 + RATES, low, high), np.exp(sign * integral(RATES, low, high))
    return grown * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("terms", [22, 6, 4])
def test_the_error_of_a_table_is_proven_however_few_its_terms(monkeypatch, terms):
    monkeypatch.setattr(time_varying, "TERMS", terms)
    motion = SWING.transitions([0.0, 0.7, 3.0, 9.9])
    off = [np.linalg.norm(F - flow(a, b), 2) for F, a, b in zip(motion.F, [0, 0.7, 3.0], [0.7, 3.0, 9.9], strict=True)]
    assert motion.proven
    assert np.all(off <= motion.errors)
    if terms == 22:
        assert motion.error < 1e-11
    else:
        assert np.max(off) > 1e-10, "few terms must show"


def test_a_plant_that_stands_still_has_the_sigma_of_the_plant():
    plain = sd.window_sigma(sd.Plant(J, C), SAMPLES, 4.0)
    found = sd.window_sigma(TimeVaryingPlant.from_table([0.0, 5.0, 10.0], [J] * 3, [C] * 3), SAMPLES, 4.0)
    assert found.closed
    assert found.upper == pytest.approx(plain.upper, rel=1e-9)
    assert 0.99 * plain.upper <= found.lower <= plain.upper


def test_sigma_of_a_table_is_below_every_window_of_a_scan_and_near_the_least():
    found = sd.window_sigma(SWING, SAMPLES, 4.0)
    scan = []
    for s in np.linspace(0.0, 6.0, 300).tolist():
        held = SAMPLES.times[(SAMPLES.times >= s) & (SAMPLES.times <= s + 4.0)]
        rows = np.vstack([C @ flow(s, t) for t in held])
        scan.append(np.linalg.svd(rows)[1][-1] if len(rows) > 1 else 0.0)
    assert found.closed
    assert found.lower <= min(scan)
    assert found.upper <= min(scan) * (1 + 1e-2)
    assert found.lower >= 0.99 * found.upper
    witness = np.vstack([C @ flow(found.witness.t - 4.0, t) for t in found.witness.samples])
    assert np.linalg.norm(witness @ found.witness.direction) == pytest.approx(found.upper, rel=1e-9)


def least_found(window, late=0.0, lost=False):
    """The least sigma that real times or a loss were found to leave: times and state in turn, from many starts."""
    best, times = np.inf, SAMPLES.times
    events = np.concatenate([times - late + 1e-9, times + late - window - 1e-9, np.linspace(0, 10 - window, 12)])
    for s in np.unique(events[(events >= -late) & (events <= 10 - window + late)]).tolist():
        sure = times[(times - late >= s) & (times + late <= s + window)]
        offsets = np.clip(sure[:, None] + np.array([-1, 0, 1]) * late, 0, 10) - sure[:, None]
        table = np.array([[C @ flow(max(s, 0.0), t + e) for e in own] for t, own in zip(sure, offsets, strict=True)])
        for k in range(len(sure)) if lost else [len(sure)]:
            part = np.delete(table, k, axis=0) if lost else table
            if len(part) < 2:
                return 0.0
            for v in np.linalg.svd(part[:, 1, 0])[2]:
                for _ in range(5):
                    places = np.argmin(np.abs(part[:, :, 0] @ v), axis=1)
                    _, values, right = np.linalg.svd(part[np.arange(len(part)), places, 0])
                    best, v = min(best, values[-1]), right[-1]
    return best


@pytest.mark.parametrize("window", few([5.0, 4.0], 1))
def test_late_and_lost_samples_leave_what_is_said_along_a_plant_that_varies(window):
    left = sd.window_sigma(SWING, SAMPLES, window).deviations
    late = left.tolerance.radius
    assert late == pytest.approx(0.01)
    found = [least_found(window, late), least_found(window + 2 * late, late), least_found(window, lost=True)]
    said = [left.late, left.late_wider, left.lost]
    assert np.all(np.array(said) <= np.array(found) * (1 + 1e-9))
    assert np.all(np.array(said) >= 0.95 * np.array(found))
    assert left.late_wider < sd.window_sigma(SWING, SAMPLES, window).lower


@pytest.mark.parametrize("window", few([5.0, 4.0], 0))
def test_of_functions_late_and_lost_samples_are_looked_at_and_it_is_said(window):
    found = sd.window_sigma(TimeVaryingPlant(lambda t: SWING.A(t), SWING.C, horizon=10.0), SAMPLES, window)
    left, late = found.deviations, found.deviations.tolerance.radius
    least = [least_found(window, late), least_found(window + 2 * late, late), least_found(window, lost=True)]
    said = np.array([left.late, left.late_wider, left.lost])
    assert np.all(said == pytest.approx(least, rel=0.03))
    assert left.to_dict()["strength"] == "sampled"
    assert "None of this is proven." in found.explain()
    assert "sampled" in str(found).split("if one sample is lost")[1]


def test_of_outputs_that_functions_say_late_samples_are_only_looked_at():
    still = TimeVaryingPlant.from_table([0.0, 10.0], [J] * 2, [C] * 2)
    seen = sd.window_sigma(TimeVaryingPlant(still.A, lambda t: C, horizon=10.0), SAMPLES, 5.0)
    assert seen.lower > 0
    plain = sd.window_sigma(sd.Plant(J, C), SAMPLES, 5.0).deviations
    mine = sd.window_sigma(still, SAMPLES, 5.0).deviations
    assert (seen.deviations.sampled, mine.sampled) == (True, False)
    assert mine.late <= seen.deviations.late <= mine.late * 1.05
    assert 0.95 * plain.late <= mine.late <= plain.late * 1.01
    assert mine.lost == pytest.approx(plain.lost, rel=1e-2)
    masked = sd.window_sigma(still, sd.Schedule(SAMPLES.times, [[True]] * 8), 5.0).deviations
    assert masked.late == pytest.approx(mine.late)


def test_of_functions_nothing_is_proven_and_it_is_said():
    found = sd.window_sigma(TimeVaryingPlant(SWING.A, SWING.C, horizon=10.0), SAMPLES, 4.0)
    assert found.status == "closed", "a table stays one wherever it is handed on"
    found = sd.window_sigma(TimeVaryingPlant(lambda t: SWING.A(t), SWING.C, horizon=10.0), SAMPLES, 4.0)
    assert (found.status, found.closed, found.lower) == ("sampled", False, 0.0)
    assert found.upper == pytest.approx(sd.window_sigma(SWING, SAMPLES, 4.0).upper, rel=1e-2)
    assert "nothing is proven" in found.explain()
    assert "nothing is proven" in str(found)


@pytest.mark.parametrize("unit", [300.0, 1.2e3])
def test_units_far_apart_without_scales_leave_no_proof_and_no_false_zero(unit):
    """The bound of the error is far above sigma, and at last its square is none in doubles: that hides no direction."""
    still = sd.Plant([[0.0, unit], [-1 / unit, 0.0]], [[1.0, 0.0]])
    plant, samples = TimeVaryingPlant.from_table([0.0, 0.6], [still.A] * 2, [still.C] * 2), sd.Schedule([0.0, 0.3, 0.6])
    found, known = sd.window_sigma(plant, samples, 0.6), sd.window_sigma(still, samples, 0.6)
    assert found.status == "rounding"
    assert found.lower <= known.upper
    assert found.upper >= known.lower > 0.0


def test_what_no_window_shows_counts_as_zero():
    still = TimeVaryingPlant.from_table([0.0, 20.0], [J] * 2, [C] * 2)
    few = sd.window_sigma(still, SAMPLES, 1.0)
    assert (few.status, few.lower, few.upper) == ("too few samples", 0.0, 0.0)
    assert few.profile.t.size == few.profile.sigma.size == few.profile.piece.size
    blind = sd.window_sigma(still, sd.Schedule(np.pi * np.arange(5)), 7.0)
    assert (blind.status, blind.upper) == ("below rounding", 0.0)
    stiffer = TimeVaryingPlant.from_table([0.0, 20.0], [3 * J + np.diag([0.5, -2.0])] * 2, [C] * 2)
    ended = sd.window_sigma(stiffer, SAMPLES, 4.0, rtol=1e-6, budget=0.0)
    assert (ended.status, ended.closed) == ("budget", False)
    assert ended.lower <= ended.upper


def test_sigma_is_counted_in_scales_and_outputs_may_be_left_out():
    unit = np.array([1e-9, 1e6])
    signals = {
        "states": sd.plants.Signals(("a", "b"), (), unit),
        "outputs": sd.plants.Signals(("y", "z"), (), [1e-9, 1e6]),
    }
    both = [np.eye(2) * unit[:, None] / unit] * 5
    table = [(r * np.eye(2) + (1 + r) * J) * unit[:, None] / unit for r in RATES]
    plant = TimeVaryingPlant.from_table(KNOTS, table, both, **signals)
    first = sd.Schedule(SAMPLES.times, [[True, False]] * 8)
    found = sd.window_sigma(plant, first, 4.0)
    assert found.coordinates == "scaled"
    assert found.upper == pytest.approx(sd.window_sigma(SWING, SAMPLES, 4.0).upper, rel=1e-9)
    assert sd.window_sigma(plant, sd.Schedule(SAMPLES.times), 4.0).upper > found.upper


def test_bad_arguments_are_refused():
    with pytest.raises(ArgumentError, match="`rigorous` is for plants that do not vary"):
        sd.window_sigma(SWING, SAMPLES, 4.0, rigorous=True)
    with pytest.raises(ArgumentError, match="`schedule` must be a Schedule within the plant's horizon, got"):
        sd.window_sigma(SWING, sd.PeriodicSchedule([1.0]), 4.0)
    with pytest.raises(ArgumentError, match=r"plant's horizon \[0, 10\], got a sample at 11.0"):
        sd.window_sigma(SWING, sd.Schedule([0.0, 11.0]), 4.0)
    with pytest.raises(ArgumentError, match="`rtol` must be less than 1, got 2"):
        sd.window_sigma(SWING, SAMPLES, 4.0, rtol=2.0)
    apart = TimeVaryingPlant.from_table([0.0, 1.0], [[[0.0, 1.2e3], [0.0, 0.0]]] * 2, [[[1.0, 0.0]]] * 2)
    with pytest.raises(SolverError, match=r"its error is bounded by .*e\+1.. only. Are states in units far"):
        apart.transitions([0.0, 0.5])
    huge = TimeVaryingPlant.from_table([0.0, 1.0], [[[1e9]]] * 2, [[[1.0]]] * 2)
    with pytest.raises(SolverError, match=r"comes to a stop at t = 0: \|A\| reaches 1e\+09 there"):
        sd.window_sigma(huge, sd.Schedule([0.0, 1.0]), 1.0)


def test_matrices_that_are_no_functions_of_time_are_refused():
    with pytest.raises(ArgumentError, match="`A` must be a function of time that returns a matrix, got list"):
        TimeVaryingPlant([[0.0]], lambda t: [[1.0]], horizon=1.0)


@pytest.mark.parametrize("unit", [1e-8, 1.0, 60.0])
def test_times_that_rounding_alone_sets_apart_are_followed(unit):
    """Ends of windows fall beside samples by a rounding error, which is a gap that no integrator begins."""
    chain, schedule = np.eye(3, k=1) / unit, sd.PeriodicSchedule([0.1 * unit]).between(0.0, 3.0 * unit)
    still = TimeVaryingPlant(lambda t: chain, lambda t: np.eye(1, 3), horizon=3.0 * unit)
    found = sd.window_sigma(still, schedule, 0.7 * unit)
    assert found.upper == pytest.approx(sd.window_sigma(sd.Plant(chain, np.eye(1, 3)), schedule, 0.7 * unit).upper)
