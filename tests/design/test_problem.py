"""Defaults, allowed times, and impossible requirements: what is in the way, and what would work."""

import contextlib
import re
from dataclasses import replace

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.problem.canonical import canonical
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.posing import pose, resolve, split_for
from sampling_design.errors import ArgumentError, InfeasibleRequirementError, NotObservableError, SolverError
from sampling_design.plants.modes import split_modes
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BASE = {"window": 4.0, "spacing": 0.5, "samples": 3}


def test_defaults_come_from_the_modes_and_are_told():
    requirement, used, _ = resolve(split_modes(OSCILLATOR), Requirement())
    assert requirement.period == pytest.approx(2 * np.pi)
    assert requirement.timing_tolerance == pytest.approx(0.01 * requirement.spacing)
    assert requirement.window == pytest.approx(requirement.period + 2 * requirement.timing_tolerance)
    assert requirement.samples == {"exactly": 4}  # k* = 1 + T delta/(2 pi) = 3, strictly more
    assert requirement.spacing == pytest.approx(2 * np.pi / 16)
    assert set(used) == {"window", "period", "samples", "spacing", "timing_tolerance"}
    again, filled, _ = resolve(split_modes(OSCILLATOR), requirement)
    assert (again.to_dict(), filled) == (requirement.to_dict(), {})


def test_a_schedule_may_be_moved_where_the_same_is_measured_whenever_it_is():
    """Bounds by gaps alone are told of such problems only: hours of one output bar them."""
    plant, none, some = Plant(OSCILLATOR.A, np.eye(2)), np.zeros((0, 2)), np.array([[0.5, 3.0]])
    wait = np.linspace(0.0, 4.0, 41)
    for forbidden, *available in ((none, None, None), (some, None, None), (none, None, some), (none, some, some)):
        case = DesignProblem(plant, 4.0, 4.0, 0.5, 3, forbidden, np.zeros(0), tuple(available))
        assert case.is_shift_invariant == bool(case.mask(wait).all())
    assert not replace(case, available=(None, None), fixed=np.array([1.0])).is_shift_invariant
    assert not replace(case, available=(None, None), chosen=np.eye(3, 2, dtype=bool)).is_shift_invariant


@pytest.mark.parametrize("kind", ["hours", "hours of one output", "fixed"])
def test_canonical_periods_begin_where_those_of_the_requirement_do(kind):
    """A time that rounding leaves just before the end of a period is at its beginning."""
    rng, plant, none = np.random.default_rng(7), Plant(OSCILLATOR.A, np.eye(2)), np.zeros((0, 2))
    for _ in range(100):
        period, window = rng.uniform(1.0, 9.0, size=2)
        hours = period * np.sort(rng.uniform(size=(1, 2)))
        bare = DesignProblem(plant, window, period, 0.1 * period, 2, none, np.zeros(0), (None, None))
        case = {
            "hours": replace(bare, forbidden=hours),
            "hours of one output": replace(bare, available=(hours, None)),
            "fixed": replace(bare, fixed=hours[0, :1]),
        }[kind]
        assert abs(case.origin - hours).min() <= 1e-9 * period
        assert canonical(case).inside.origin == 0


def test_a_window_that_is_given_is_taken_as_it_is():
    exact, used, _ = resolve(split_modes(OSCILLATOR), Requirement(window=4.0))
    assert (exact.window, exact.timing_tolerance) == (4.0, 0.0)
    assert "timing_tolerance" not in used
    on_time = resolve(split_modes(OSCILLATOR), Requirement(timing_tolerance=0.0)).requirement
    assert on_time.window == on_time.period
    late, used, _ = resolve(split_modes(OSCILLATOR), Requirement(timing_tolerance=(0.0, 0.1)))
    assert (late.window, used["window"]) == (pytest.approx(2 * np.pi + 0.1),) * 2
    assert late.period == pytest.approx(2 * np.pi)
    assert late.samples == {"exactly": 4}


def test_without_oscillation_the_window_is_four_over_the_norm():
    plant = Plant([[0.0, 2.0], [0.0, 0.0]], [[1.0, 0.0]])
    assert resolve(split_modes(plant), Requirement())[0].period == pytest.approx(2.0)


def test_the_default_count_is_cut_with_a_notice():
    A = np.kron(np.diag(np.arange(1.0, 6.0)), [[0.0, 1.0], [-1.0, 0.0]])
    plant = Plant(A, np.tile([[1.0, 0.0]], 5))
    requirement, used, _ = resolve(split_modes(plant), Requirement(window=20.0))
    assert requirement.samples == {"exactly": 24}
    assert "24 are designed" in used["notice"]


def test_times_are_converted_to_the_unit_of_the_plant():
    requirement = resolve(
        split_modes(OSCILLATOR), Requirement(window=0.1, spacing=0.01, samples=3, time_unit="min")
    ).requirement
    assert requirement.window == pytest.approx(6.0)
    assert requirement.spacing == pytest.approx(0.6)
    assert requirement.time_unit == "s"


@pytest.mark.parametrize(
    ("changes", "obstacle", "words"),
    few(
        [
            ({"spacing": 1.5}, "spacing", "room for 2 samples in the period 4, 3 are asked for"),
            ({"forbidden": [[0.0, 3.2]]}, "forbidden", "`forbidden` and `fixed` times leave room for 2 samples"),
            ({"forbidden": [[0.0, 4.0]]}, "forbidden", "leave no time to sample at all"),
            ({"forbidden": [[0.0, 1.0]], "fixed": [0.5]}, "fixed", "`fixed` time 0.5 is forbidden"),
            ({"fixed": [0.0, 0.3]}, "fixed", "`fixed` times 0 and 0.3 lie 0.3 apart, closer than `spacing` 0.5"),
            ({"fixed": [0.0, 1.0, 2.0, 3.0]}, "fixed", "`fixed` names 4 times, `samples` allows 3"),
            ({"samples": 1}, "samples", "need at least 2. The nearest that works: samples 2"),
        ],
        0,
        2,
        3,
        4,
        5,
        6,
    ),
)
def test_an_impossible_requirement_names_the_obstacle_and_the_nearest_that_works(changes, obstacle, words):
    with pytest.raises(InfeasibleRequirementError, match=re.escape(words)) as caught:
        design_schedule(OSCILLATOR, Requirement(**{**BASE, **changes}))
    error = caught.value
    assert error.obstacle == obstacle
    assert error.exit_code == 1
    assert error.nearest
    alone = [{key: value} for key, value in error.nearest.items()]
    for change in [error.nearest, *alone] if len(alone) > 1 else alone:
        design = design_schedule(OSCILLATOR, Requirement(**{**BASE, **changes}).replace(**change), starts=1, branches=0)
        assert design.schedule is not None
        assert design.verify()


@pytest.mark.parametrize(
    ("changes", "keys"),
    few(
        [
            ({"forbidden": [[0.0, 4.0]]}, {"forbidden"}),
            ({"forbidden": [[0.0, 1.0], [1.2, 3.9]], "samples": 4}, {"samples", "spacing"}),
            ({"forbidden": [[0.0, 3.9]], "samples": 3}, {"spacing"}),
            ({"samples": 1, "spacing": 2.5}, {"samples", "spacing"}),
            ({"fixed": [0.0, 0.3], "spacing": 1.5, "samples": 3}, {"spacing"}),
            ({"fixed": [0.2, 1.0], "forbidden": [[0.0, 0.5], [1.1, 4.0]], "samples": 2}, {"fixed"}),
            ({"sensors": {"y1": {"available": [[0.0, 0.3]]}}}, {"spacing"}),
            ({"spacing": 5.0, "samples": 2}, {"spacing"}),
        ],
        1,
        4,
        5,
        6,
    ),
)
def test_the_nearest_requirement_works_where_several_constraints_bind(changes, keys):
    asked = Requirement(**{**BASE, **changes})
    with pytest.raises(InfeasibleRequirementError, match=r"nearest that works|Remove it or open") as caught:
        design_schedule(OSCILLATOR, asked)
    assert keys <= set(caught.value.nearest)
    design = design_schedule(OSCILLATOR, asked.replace(**caught.value.nearest), starts=1, branches=0)
    assert design.verify()


def asked_at_random(seed):
    """A requirement in minutes of a plant in hours; every third has samples that may be early or late."""
    rng = np.random.default_rng(seed)
    spans = np.sort(rng.choice(np.arange(0, 241, 5), 4, replace=False)).reshape(2, 2)
    changes = {
        "samples": int(rng.integers(1, 5)),
        "spacing": float(rng.choice([10.0, 60.0, 100.0])),
        "forbidden": spans[: rng.integers(3)],
        "fixed": np.sort(rng.choice(np.arange(2, 240, 4), rng.integers(3), replace=False)),
        "timing_tolerance": [0.0, (1.0, 3.0), 24.0][seed % 3],
    }
    changes["timing_tolerance"] = np.minimum(changes["timing_tolerance"], 0.4 * changes["spacing"]).tolist()
    prices = {"y1": {"price": 2.0}} if rng.random() < 0.5 else {}
    return Requirement(window=180.0, period=240.0, time_unit="min", sensors=prices, cost_limit=7.0).replace(**changes)


@pytest.mark.parametrize("first", few(range(0, 120, 6), 0, 3))
def test_each_way_that_is_said_to_work_does_in_the_unit_of_the_requirement(first):
    hourly, ways = Plant(OSCILLATOR.A, OSCILLATOR.C, time_unit="h"), 0

    def posed(asked):
        split = split_for(hourly, asked)
        return pose(split.retained, resolve(split, asked).requirement, asked.samples["exactly"])

    for seed in range(first, first + 6):
        asked = asked_at_random(seed)
        with contextlib.suppress(InfeasibleRequirementError):
            posed(asked)
            continue
        with pytest.raises(InfeasibleRequirementError, match=r"Times here are in h, as the plant's\.") as caught:
            design_schedule(hourly, asked)
        nearest, said = caught.value.nearest, str(caught.value).partition("The nearest that works: ")[2]
        named = [{key for key in nearest if key in way} for way in said.split(" or ")]
        for keys in [nearest, *named] if nearest else []:
            posed(asked.replace(**{key: nearest[key] for key in keys}))
            ways += 1
    assert ways > 2


def test_times_are_opened_no_more_than_needed():
    asked = Requirement(**BASE, forbidden=[[0.0, 4.0]])
    with pytest.raises(InfeasibleRequirementError, match="leave no time to sample at all") as caught:
        design_schedule(OSCILLATOR, asked)
    ((start, stop),) = caught.value.nearest["forbidden"]
    assert start == 0.0
    assert stop == pytest.approx(3.0, rel=2e-3)  # three samples half a time apart need one


def test_a_plant_whose_outputs_are_never_there_long_enough_is_offered_longer_hours():
    plant = Plant(np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]]), np.kron(np.eye(2), [[1.0, 0.0]]))
    outputs = {"y1": {"available": [[0.0, 0.01]], "price": 2.0}, "y2": {"available": [[0.0, 0.01]]}}
    asked = Requirement(window=4.0, spacing=4.0, samples=2, sensors=outputs)
    with pytest.raises(InfeasibleRequirementError, match="room for 1 sample in the period 4, 2 are asked") as caught:
        design_schedule(plant, asked)
    assert design_schedule(plant, asked.replace(**caught.value.nearest), starts=1).schedule is not None


def test_the_capacity_is_the_most_by_enumeration():
    from itertools import combinations

    grid = np.arange(16) / 4
    for forbidden in ([[0.4, 1.0]], [[0.0, 0.6], [2.0, 3.0]], [[1.0, 1.2], [3.4, 4.0]]):
        asked = Requirement(window=4.0, spacing=0.6, samples=2, forbidden=forbidden)
        requirement = resolve(split_modes(OSCILLATOR), asked).requirement
        problem = pose(OSCILLATOR, requirement, 2)
        allowed = grid[problem.mask(grid).any(axis=-1)]
        most = max(
            k
            for k in range(1, 8)
            for c in combinations(allowed, k)
            if k == 1 or np.min(np.diff([*c, c[0] + 4.0])) >= 0.6 - 1e-9
        )
        assert problem.capacity() >= most
        assert problem.capacity() <= most + 1  # off the grid there may be room for one more


def test_an_unknown_output_and_times_beyond_a_default_period_are_refused():
    with pytest.raises(ArgumentError, match="unknown key 'z' in `sensors` of the requirement"):
        design_schedule(OSCILLATOR, Requirement(**BASE, sensors={"z": {"price": 1.0}}))
    with pytest.raises(ArgumentError, match="`forbidden` must lie within the period"):
        design_schedule(OSCILLATOR, Requirement(**BASE, forbidden=[[5.0, 6.0]]))


def test_an_unseen_mode_is_refused_by_name():
    plant = Plant(np.diag([0.1, 0.2]), [[1.0, 0.0]])
    with pytest.raises(NotObservableError, match=r"0\.2"):
        design_schedule(plant, Requirement(window=4.0, spacing=0.5, samples=3))


def test_a_search_without_a_start_says_so(monkeypatch):
    monkeypatch.setattr("sampling_design.design.search.local_search.is_admissible", lambda problem, times: False)
    with pytest.raises(SolverError, match="No admissible start was found for 3 samples") as caught:
        design_schedule(OSCILLATOR, Requirement(**BASE))
    assert caught.value.status == "no start"


def test_a_sample_that_rounding_takes_before_an_output_opens_lies_on_the_opening():
    """The other output is read at all times, so that no sample is forbidden there."""
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
    sensors = {"b": {"available": [[0.0, 2.0], [2.5, 4.0]]}}
    asked = Requirement(window=4.0, period=4.0, spacing=0.4, samples=2, sensors=sensors)
    posed = pose(plant, asked, 2)
    canon = canonical(posed)
    found = np.array([0.5, 2.5 * (1 - 4e-15)]) - canon.shift
    times, _ = canon.times(found / canon.time, np.ones((2, 2), dtype=bool))
    assert times[1] == 2.5
    assert posed.mask(times).all()
