"""Accuracy for all real sample times within a tolerance, against a search over them by a program of its own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from sampling_design import PeriodicSchedule, Plant, Schedule, guaranteed_accuracy
from sampling_design.accuracy.recursion import PeriodicGains
from sampling_design.accuracy.timing import ENOUGH
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.schedules.jitter import TimingTolerance
from sampling_design.schedules.sensor import Sensor
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few
from tests.counted_clock import Counted

Array = npt.NDArray[np.float64]

INTEGRATOR = Plant([[0.0]], [[1.0]])
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DRIVEN = Plant(OSCILLATOR.A, OSCILLATOR.C, G=[[0.0], [1.0]])
EVEN = PeriodicSchedule([1.0])
UNEVEN = PeriodicSchedule([1.0, 0.6])
BACK, CELLS = 9, 5
"""Samples and cells of a gap of the search, which begins at rest: what it reaches is attained."""


@cache
def uneven(late: float):
    """What several tests judge."""
    return guaranteed_accuracy(OSCILLATOR, UNEVEN, w_bound=0.02, v_bound=0.1, timing_tolerance=late)


def _reached(plant: Plant, row: Array, times: Array, w: float, v: float) -> float:
    """How far w within its bound moves a row by the last of the times while every sample before it reads zero."""
    n, q = plant.G.shape
    x, shown = np.zeros((n, 0)), list[Array]()
    for gap in np.diff(times):
        joint = expm(np.block([[plant.A, plant.G], [np.zeros((q, n + q))]]) * gap / CELLS)
        for _ in range(CELLS):
            x = np.hstack([joint[:n, :n] @ x, joint[:n, n:]])
        shown.append(plant.C @ x)
    rows = np.vstack([np.pad(part, ((0, 0), (0, x.shape[1] - part.shape[1]))) for part in shown[:-1]])
    found = linprog(-(row @ x), np.vstack([rows, -rows]), np.full(2 * len(rows), v), bounds=(-w, w))
    return -float(found.fun)


def _searched(plant: Plant, row: Array, schedule: PeriodicSchedule, late: float, w: float, v: float) -> float:
    """The largest error found by moving one sample after another, for the end in each gap."""
    best = 0.0
    for last in range(len(schedule)):
        planned = schedule.times[0] + np.cumsum(schedule.gaps[(last + np.arange(-BACK, 1)) % len(schedule)])
        real = planned.copy()
        top = _reached(plant, row, real, w, v)
        for _ in range(2):
            for k in range(len(planned) - 1, -1, -1):
                for e in (-late, 0.0, late):
                    trial = real.copy()
                    trial[k] = planned[k] + e
                    found = _reached(plant, row, trial, w, v)
                    if found > top:
                        top, real = found, trial
        best = max(best, top)
    return best


def _drawn(seed: int) -> tuple[Plant, PeriodicSchedule, float]:
    rng = np.random.default_rng(seed)
    n, count = 1 + seed % 3, 1 + seed % 2
    A = rng.normal(size=(n, n))
    A -= np.eye(n) * (np.max(np.linalg.eigvals(A).real) - rng.uniform(-0.3, 0.2))
    schedule = PeriodicSchedule(rng.uniform(0.4, 1.0, count))
    late = float(np.min(schedule.gaps)) * (0.01, 0.03, 0.1)[seed // 3 % 3]
    return Plant(A, rng.normal(size=(1, n))), schedule, late


@pytest.mark.parametrize("seed", few(range(45), 4))
def test_no_real_times_make_an_error_larger_than_is_proven(seed: int):
    plant, schedule, late = _drawn(seed)
    row, w = np.eye(plant.n_states)[0], [0.3] * plant.n_states
    found = guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=0.2, of=[row], timing_tolerance=late)
    assert found.verify()
    assert _searched(plant, row, schedule, late, 0.3, 0.2) <= found.upper[0]
    exact = guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=0.2, of=[row])
    assert exact.lower[0] * (1 - 1e-3) <= found.lower[0] <= found.upper[0]


def test_both_sides_are_close():
    drawn = [_drawn(seed) for seed in (2, 3, 7, 16)]
    share = []
    for plant, schedule, late in drawn:
        found = guaranteed_accuracy(
            plant, schedule, w_bound=[0.3] * plant.n_states, v_bound=0.2, of=[np.eye(plant.n_states)[0]],
            timing_tolerance=late,
        )  # fmt: skip
        share.append(found.lower[0] / found.upper[0])
    assert min(share) > 0.9
    assert np.mean(np.array(share) > 0.95) >= 0.75


def test_an_integrator_waits_from_an_early_sample_to_a_late_one():
    found = guaranteed_accuracy(INTEGRATOR, EVEN, w_bound=0.1, v_bound=0.3, timing_tolerance=0.1)
    assert found.lower[0] == pytest.approx(0.3 + 0.1 * 1.2)
    assert found.lower[0] <= found.upper[0] <= 0.42 * (1 + 1e-3)
    assert found.noise == pytest.approx(0.01, rel=0.02)
    assert found.at_samples == pytest.approx(0.32, rel=1e-3)  # the sample is in from 0.1 after its planned time on
    assert found.timing_tolerance == 0.1
    assert found.profile.edges[[0, -1]] == pytest.approx([1.1, 2.1])
    assert np.all(np.diff(found.profile.edges) > 0)
    assert "up to 0.1 s early or late" in found.explain()
    assert ("samples come", "up to 0.1 s early or late") in found._rows()
    assert found.to_dict()["timing_tolerance"] == 0.1


@pytest.mark.long
@pytest.mark.parametrize("v_bound", few([0.2, [0.2, 0.1]], 0))
def test_samples_of_several_outputs_in_a_ball_and_in_a_box(v_bound):
    A = np.array([[-0.2, 1.0, 0.0], [-1.0, -0.2, 0.3], [0.0, 0.0, -0.1]])
    plant = Plant(A, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    schedule = PeriodicSchedule([0.5, 0.7, 0.6], outputs=[[1, 0], [0, 1], [1, 1]])
    given = {"w_bound": 0.1, "v_bound": v_bound, "timing_tolerance": 0.02, "of": "x2"}
    found = guaranteed_accuracy(plant, schedule, **given)
    twice = PeriodicSchedule(np.tile(schedule.gaps, 2), outputs=np.tile(schedule.outputs, (2, 1)))
    again = guaranteed_accuracy(plant, twice, **given)
    assert found.verify()
    assert again.verify()
    assert np.array_equal(found.upper, again.upper)
    assert np.all(found.lower >= 0.95 * found.upper)


def test_a_finite_schedule_keeps_its_bounds_too():
    schedule = Schedule(1.7e9 + np.array([1.0, 1.6, 2.1, 2.9]))
    given = {"w_bound": 0.1, "v_bound": 0.2, "initial_error": 1.0, "start": 1.7e9, "of": "x1"}
    exact = guaranteed_accuracy(OSCILLATOR, schedule, end=1.7e9 + 3.0, **given)
    found = guaranteed_accuracy(OSCILLATOR, schedule, timing_tolerance=0.1, **given)
    assert found.question.end == schedule.times[-1] + 0.1
    assert found.verify()
    assert np.all(exact.lower <= found.upper)
    assert np.all(found.lower >= 0.9 * found.upper)
    rng = np.random.default_rng(3)
    for _ in range(2):
        real = Schedule(schedule.times + 0.1 * rng.choice([-1.0, 1.0], 4))
        moved = guaranteed_accuracy(OSCILLATOR, real, end=found.question.end, **given)
        assert np.all(moved.lower <= found.upper)


@pytest.mark.long
def test_nothing_jumps_as_the_tolerance_goes_to_zero():
    given = {"w_bound": 0.02, "v_bound": 0.1, "rtol": 1e-3, "of": "x1"}
    exact = guaranteed_accuracy(OSCILLATOR, UNEVEN, **given)
    for late, share in ((1e-7, 1e-3), (1e-3, 5e-3)):
        found = guaranteed_accuracy(OSCILLATOR, UNEVEN, timing_tolerance=late, **given)
        assert np.all(found.upper <= exact.upper * (1 + share))
        assert np.all(found.lower >= exact.lower * (1 - share))


@pytest.mark.long
@pytest.mark.parametrize("c", few([1e-12, 1e12], 0))
def test_units_change_nothing(c):
    wanted = uneven(0.06)
    slow = Plant(OSCILLATOR.A / c, OSCILLATOR.C)
    timed = PeriodicSchedule(UNEVEN.gaps * c)
    found = guaranteed_accuracy(slow, timed, w_bound=0.02 / c, v_bound=0.1, timing_tolerance=0.06 * c)
    sized = guaranteed_accuracy(
        Plant(OSCILLATOR.A, OSCILLATOR.C * c), UNEVEN, w_bound=0.02, v_bound=0.1 * c, timing_tolerance=0.06
    )
    assert np.allclose(found.upper, wanted.upper, rtol=1e-5)
    assert np.allclose(sized.upper, wanted.upper, rtol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("gap", few([8.0, 20.0], 1))
def test_both_sides_stand_on_the_same_panels_in_long_gaps(gap):
    falling = Plant([[-1.0, 1.0], [0.0, -1.0]], [[1.0, 0.0]])
    schedule = PeriodicSchedule([gap])
    found = guaranteed_accuracy(falling, schedule, w_bound=0.1, v_bound=0.2, of="x1", timing_tolerance=1.0)
    assert found.verify()
    assert np.all(found.profile.lower <= found.profile.upper)
    assert found.lower[0] == pytest.approx(found.profile.lower[0].max(), rel=0.05)


def test_too_little_noise_and_times_beyond_the_tolerance_are_not_proven():
    found = uneven(0.06)
    assert found.verify()
    assert not replace(found, noise=found.noise * 0.98).verify()
    assert not replace(found, noise=None).verify()
    assert not replace(found, upper=found.upper * 0.999).verify()
    tight = replace(found.question, timing_tolerance=TimingTolerance.of(0.05))
    assert not replace(found, question=tight).verify()
    exact = uneven(0.0)
    longer = replace(exact.question, nodes=exact.question.nodes * 0.99)  # a witness at other times than the schedule's
    assert not replace(exact, question=longer, upper=exact.upper * 2)._attained(0, exact.question.known(), 0.0)


@pytest.mark.long
@pytest.mark.parametrize(("early", "late"), few([(0.02, 0.08), (0.1, 0.0)], 0))
def test_early_apart_from_late_is_one_number_about_another_time(early, late):
    sides = (early, late)
    said = guaranteed_accuracy(OSCILLATOR, UNEVEN, w_bound=0.02, v_bound=0.1, timing_tolerance=sides)
    same = uneven(0.05)
    assert said.upper == pytest.approx(same.upper, rel=1e-9)
    assert said.lower == pytest.approx(same.lower, rel=1e-9)
    assert said.verify()
    shift = (late - early) / 2
    assert said.profile.edges == pytest.approx(same.profile.edges + shift)
    finite = {"w_bound": 0.02, "v_bound": 0.1, "initial_error": 1.0, "start": 0.0}
    told = guaranteed_accuracy(OSCILLATOR, FINITE, timing_tolerance=sides, **finite)
    moved = Schedule(FINITE.times + shift)
    again = guaranteed_accuracy(OSCILLATOR, moved, timing_tolerance=0.05, **finite)
    assert told.upper == pytest.approx(again.upper, rel=1e-9)
    assert told.verify()


def apart_from_rest(
    plant: Plant, row: Array, real: list[Array], t: float, w: float, v: float, begun: tuple[float, float] | None = None
) -> float:
    """How far w moves a row by t while each output reads zero at its own times (within v).

    From rest; or from a time on, where each state is so large.
    """
    n, q = plant.G.shape
    times = np.unique(np.concatenate([*real, [t], [] if begun is None else [begun[0]]]))
    x, shown, e = np.eye(n)[:, : n * (begun is not None)], list[Array](), begun[1] if begun else 0.0
    for a, b in pairwise(times.tolist()):
        joint = expm(np.block([[plant.A, plant.G], [np.zeros((q, n + q))]]) * (b - a) / CELLS)
        for _ in range(CELLS):
            x = np.hstack([joint[:n, :n] @ x, joint[:n, n:]])
        shown += [plant.C[i] @ x for i, own in enumerate(real) if (b in own and b < t) or (b == t and b in own)]
    rows = np.vstack([np.pad(part, (0, x.shape[1] - part.size)) for part in shown])
    bounds = np.where(np.arange(x.shape[1]) < n * (begun is not None), e, w)
    found = linprog(
        -(row @ x), np.vstack([rows, -rows]), np.full(2 * len(rows), v), bounds=np.array([-bounds, bounds]).T
    )
    return -float(found.fun)


@pytest.mark.parametrize("seed", few(range(20), 0))
def test_outputs_that_fall_apart_make_no_error_larger_than_is_proven(seed: int):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, 2))
    A -= np.eye(2) * (np.max(np.linalg.eigvals(A).real) + 0.1)
    plant, gap = Plant(A, rng.normal(size=(2, 2)), outputs=["a", "b"]), float(rng.uniform(0.5, 1.0))
    sides = np.round(0.06 * gap * rng.choice([0.0, 0.5, 1.0], size=(2, 2)), 6)
    tolerance = {"a": tuple(sides[0]), "b": tuple(sides[1])}
    row = np.eye(2)[0]
    found = guaranteed_accuracy(
        plant, PeriodicSchedule([gap]), w_bound=[0.3, 0.3], v_bound=[0.2, 0.2], of=[row], timing_tolerance=tolerance
    )
    assert found.verify()
    planned, least = 10 * gap * np.ones(1) + gap * np.arange(BACK), np.inf
    best = 0.0
    for _ in range(12):
        real = [planned - a + rng.choice([0.0, 0.5, 1.0], planned.size) * (a + b) for a, b in sides]
        last = min(float(own[-1]) for own in real)
        best = max(best, apart_from_rest(plant, row, [own[:-1] for own in real], last, 0.3, 0.2))
        least = min(least, best)
    assert best <= found.upper[0] * (1 + 1e-9)
    assert 0 < found.lower[0] <= found.upper[0]


@pytest.mark.parametrize("seed", few(range(30), 1))
def test_what_is_still_out_says_nothing_of_the_times_of_what_is_in(seed: int):
    """Of two outputs one is in after the other: the moment before each result, a linear program at times drawn."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, 2))
    A -= np.eye(2) * (np.max(np.linalg.eigvals(A).real) + rng.uniform(-0.1, 0.3))
    plant, gap = Plant(A, rng.normal(size=(2, 2)), outputs=["a", "b"]), float(rng.uniform(0.5, 1.0))
    rows, after = np.eye(2), np.array([0.0, rng.choice([0.3, 0.9, 1.6]) * gap])
    w, v, e = rng.uniform([0.01, 0.05, 0.5], [0.1, 0.5, 2.0]).tolist()
    planned, sides = gap * np.arange(1, 4), gap * rng.uniform(0.0, 0.2, size=(2, 2))
    found = guaranteed_accuracy(
        plant, Schedule(planned), w_bound=[w, w], initial_error=[e, e], start=0.0, rtol=0.05,
        v_bound={"a": v, "b": Sensor(noise_bound=v, result_delay=float(after[1]))},
        timing_tolerance={"a": tuple(sides[0]), "b": tuple(sides[1])},
    )  # fmt: skip
    comes, edges = planned + sides[:, 1:] + after[:, None], found.profile.edges
    for t in np.sort(np.ravel(comes))[1:] - 1e-6 * gap:
        real = planned + np.where(rng.random((2, 3)) < 0.5, -sides[:, :1], sides[:, 1:])
        shown, at = [own[own_in <= t] for own, own_in in zip(real, comes, strict=True)], np.searchsorted(edges, t)
        for upper, row in zip(found.profile.upper[:, at - 2 : at + 1].max(axis=1), rows, strict=True):
            assert apart_from_rest(plant, row, shown, t, w, v, (0.0, e)) <= upper * (1 + 1e-6)


def test_where_the_error_grows_with_the_times_nothing_is_claimed():
    growing = Plant([[0.0, 1.0], [2.0, 0.0]], [[1.0, 0.0]])
    with pytest.raises(UndecidedError, match="Ask for a smaller `timing_tolerance`"):
        guaranteed_accuracy(growing, PeriodicSchedule([2.0]), w_bound=0.1, v_bound=0.1, timing_tolerance=0.9)


@pytest.mark.parametrize(("rate", "late"), few([(3.0, 0.3), (1.0, 0.2), (-0.5, 0.3)], 0))
def test_an_error_that_grows_is_that_from_the_earliest_sample_to_the_latest(rate, late):
    """Of one state the last sample alone counts where the error grows: v e^{ah} + w (e^{ah} - 1)/a, h = T + 2d."""
    plant, h = Plant([[rate]], [[1.0]]), 1.0 + 2 * late
    exact = 0.1 * np.exp(rate * h) + np.expm1(rate * h) / rate
    found = guaranteed_accuracy(plant, EVEN, w_bound=1.0, v_bound=0.1, timing_tolerance=late)
    assert found.lower[0] == pytest.approx(exact, rel=1e-6)
    assert exact <= found.upper[0] <= 1.07 * exact
    assert found.verify()
    assert found.profile.edges[0] == pytest.approx(1.0 + late)  # when the sample is known, whatever it is counted from
    assert not replace(found, noise=found.noise / ENOUGH).verify()


@pytest.mark.long
def test_what_is_proven_about_the_latest_times_holds_at_all_and_of_finite_schedules():
    growing = Plant([[0.0, 1.0], [2.0, 0.0]], [[1.0, 0.0]])
    found = guaranteed_accuracy(growing, PeriodicSchedule([2.0]), w_bound=[0.1, 0.1], v_bound=0.1, timing_tolerance=0.5)
    assert found.question.timing_tolerance.moved == 0.5
    assert found.verify()
    for k, row in enumerate(np.eye(2)):
        assert _searched(growing, row, PeriodicSchedule([2.0]), 0.5, 0.1, 0.1) <= found.upper[k]
    plant, schedule = Plant([[3.0]], [[1.0]]), Schedule([1.0, 2.0, 3.0])
    exact = 0.1 * np.exp(4.8) + np.expm1(4.8) / 3
    finite = guaranteed_accuracy(
        plant, schedule, w_bound=1.0, v_bound=0.1, timing_tolerance=0.3, initial_error=1e-3, start=0.0
    )
    assert finite.verify()
    assert finite.lower[0] <= finite.upper[0] <= 1.07 * exact


def test_a_mode_that_only_late_samples_show_is_named():
    turning = Plant([[0.0, 2 * np.pi, 0.0], [-2 * np.pi, 0.0, 0.0], [0.0, 0.0, -1.0]], [[1.0, 0.0, 1.0]])
    with pytest.raises(UndecidedError, match="which samples on time do not"):
        guaranteed_accuracy(turning, EVEN, w_bound=0.1, v_bound=0.1, of=[[0, 0, 1.0]], timing_tolerance=0.01)


FINITE = Schedule([1.0, 2.0])


@pytest.mark.parametrize(
    ("schedule", "given", "said"),
    [
        (UNEVEN, {"timing_tolerance": 0.3}, "must be less than half of the least gap 0.6"),
        (UNEVEN, {"timing_tolerance": -0.1}, "`timing_tolerance` must not be negative"),
        (UNEVEN, {"w_bound": (0.0, 0.1)}, "is for bounds centred at 0"),
        (UNEVEN, {"w_intensity": 0.1, "v_deviation": 0.1}, "are for errors that are guaranteed"),
        (FINITE, {}, "`initial_error` must bound every state where samples"),
        (FINITE, {"initial_error": 1.0}, "`start` must lie before the first sample, `timing_tolerance` 0.05"),
        (FINITE, {"initial_error": 1.0, "start": 0.0, "end": 2.0}, "`start` must lie before the first sample"),
    ],
)
def test_what_does_not_fit_is_refused(schedule, given, said):
    with pytest.raises(ArgumentError, match=said):
        guaranteed_accuracy(
            OSCILLATOR if "w_bound" not in given else DRIVEN, schedule,
            **{"w_bound": 0.1, "v_bound": 0.1, "timing_tolerance": 0.05, **given},
        )  # fmt: skip


def test_what_is_of_samples_on_time_alone_is_refused():
    found = uneven(0.06)
    with pytest.raises(ArgumentError, match="`projection` is of samples on time"):
        found.projection("x1", "x2")
    with pytest.raises(ArgumentError, match="`found` must be of samples on time"):
        PeriodicGains(found, initial_error=1.0)
    with pytest.raises(ArgumentError, match="`rigorous` is for samples on time"):
        found.verify(rigorous=True)
    box = UncertainPlant(INTEGRATOR, [UncertainParameter("rate", -0.1, 0.0, A=[[1.0]], nominal=0.0)])
    with pytest.raises(ArgumentError, match="`timing_tolerance` must be left out for accuracy over a box"):
        guaranteed_accuracy(box, EVEN, w_bound=[0.1], v_bound=[0.1], timing_tolerance=0.1)


@pytest.mark.parametrize("delay", [0.4, 2.5])
def test_what_is_known_at_the_time_lacks_the_results_that_are_out(delay):
    given = {"w_bound": 0.1, "v_bound": {"y1": Sensor(noise_bound=0.3, result_delay=delay)}}
    found = guaranteed_accuracy(INTEGRATOR, EVEN, **given)
    assert found.verify()
    assert np.allclose([found.lower, found.upper], 0.3 + 0.1 * (1.0 + delay), rtol=1e-3)
    assert 0 <= found.worst[0] <= 1.0
    assert f"with results {delay:.6g} s after their samples" in found.explain()
    both = guaranteed_accuracy(INTEGRATOR, EVEN, timing_tolerance=0.1, **given)
    assert both.verify()
    assert np.allclose([both.lower, both.upper], 0.3 + 0.1 * (1.2 + delay), rtol=1e-3)
    assert ("results come after", f"{delay:.6g} s") in both._rows()


def test_a_delay_is_the_same_as_waiting_for_the_next_result():
    """Until the result of the second sample comes, the error is that of the first one alone."""
    given = {"w_bound": 0.02, "v_bound": 0.1, "initial_error": 1.0, "start": 0.0, "of": "x1"}
    delayed = given | {"v_bound": {"y1": Sensor(noise_bound=0.1, result_delay=0.5)}}
    late = guaranteed_accuracy(OSCILLATOR, Schedule([1.0, 2.0]), **delayed)
    assert late.question.end == 2.5
    alone = guaranteed_accuracy(OSCILLATOR, Schedule([1.0]), end=2.5, **given)
    at = np.searchsorted(late.profile.edges, 2.5) - 1
    assert late.profile.upper[0, at] == pytest.approx(alone.profile.upper[0, -1], rel=0.02)
    with pytest.raises(ArgumentError, match=r"`end` not before 2\.5, when the last result is in, got 0 and 2\.1"):
        guaranteed_accuracy(OSCILLATOR, Schedule([1.0, 2.0]), end=2.1, **delayed)


def test_noise_that_stands_for_times_is_proven_again_where_filters_remember_long():
    """The gains that are kept look as far back as those by which the noise was found to be enough."""
    drifting = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found = guaranteed_accuracy(drifting, EVEN, w_bound=1e-3, v_bound=0.1, of="x1", timing_tolerance=1e-3)
    assert found.verify()


@pytest.mark.parametrize("endless", few([True, False], 1))
def test_what_a_spent_budget_leaves_proven_of_late_samples_verifies(endless):
    """The directions by which noise was found to be enough are in the proof, though rows had little time left."""
    plant = Plant([[0.2, 1.0, 0.0], [-1.0, 0.1, 0.0], [0.0, 0.3, -0.4]], [[1.0, 0.5, 0.0], [0.2, 0.0, 1.0]])
    schedule = PeriodicSchedule([0.9, 1.3, 0.7]) if endless else Schedule([1.0, 2.1, 2.9, 4.2])
    asked = {} if endless else {"initial_error": 0.7, "start": 0.5}
    with Counted().running():
        found = guaranteed_accuracy(
            plant, schedule, w_bound=0.1, v_bound=0.3, timing_tolerance=0.1, budget=1.0, **asked
        )
    assert found.verify()


def test_a_spent_budget_says_where_the_noise_of_late_samples_was_not_found():
    plant, schedule = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([1.0, 0.7])
    asked = {"w_bound": 0.1, "v_bound": 0.1, "of": "x1"}
    with pytest.raises(UndecidedError, match="`budget` ended before noise was found"):
        guaranteed_accuracy(plant, schedule, timing_tolerance=0.345, budget=1e-9, **asked)
    for late, most in ((0.1, 1.0), (0.33, 5.0)):
        rushed = guaranteed_accuracy(plant, schedule, timing_tolerance=late, budget=1e-9, **asked)
        assert 0 < rushed.lower[0] <= rushed.upper[0] < most
        assert rushed.verify()


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_gains_of_the_filter_alone_prove_nearly_what_searched_ones_do(late):
    rng = np.random.default_rng(3)
    T = rng.standard_normal((6, 6))
    A = T @ np.diag(rng.uniform(-1.0, 0.1, 6)) @ np.linalg.inv(T)
    plant, schedule = Plant(A, rng.standard_normal((2, 6))), PeriodicSchedule([1.0, 0.7, 1.2])
    asked = {"w_bound": [0.1] * 6, "v_bound": [0.1] * 2, "of": np.eye(6)[:1], "timing_tolerance": late}
    rushed, searched = (guaranteed_accuracy(plant, schedule, budget=seconds, **asked) for seconds in (1e-9, 4.0))
    assert rushed.verify()
    assert np.all(searched.lower <= rushed.upper)
    assert np.all(rushed.upper <= 1.3 * searched.upper)
