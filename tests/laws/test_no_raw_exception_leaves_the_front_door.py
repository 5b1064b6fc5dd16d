"""Whatever the arguments, a public function, class or method returns a value or raises one sentence of ours.

A call that does not fit names the nearest keyword; a seed is taken wherever a generator is.
`python -m tests.front_door 2000 7` makes as many calls as one likes.
"""

import functools
import inspect

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import CallError
from sampling_design.records.checks import ELSEWHERE
from sampling_design.records.record import Record
from tests import front_door
from tests.cases import few

DRAWN = [(0, 8), (0, 40), *((seed, 200) for seed in range(4))]


FOUND = (
    ("next_sample", {"record": "inf array"}),
    ("next_sample", {"record": "ragged"}),
    ("Constraints", {"w_model": "objects"}),
    ("output_predictor", {"plant": "no states"}),
    ("simulate_record", {"inputs": "objects"}),
    ("PlanRequirement", {"calendar": "{}"}),
    ("PlanRequirement", {"sensors": "range"}),
    ("ConvexSet.ball", {"dimension": "1e18"}),
    ("tradeoff_curve", {"eta": "1e-308"}),
    ("four_horizons", {"schedule": "schedule", "plant": "nothing to observe"}),
    ("FamilyCertificate.error_bound", {"t": "-inf"}),
    ("SpacedWindows.draw", {"duration": "1e308"}),
    ("KalmanFilter.update", {"u": "objects"}),
    ("weights_from_bounds", {"initial_error": "1e-308"}),
    ("NonlinearPlant", {"limits": "complex array"}),
    ("check_detectability", {"pairs": "1e18"}),
    ("standard_deviation", {"schedule": "deep"}),
    ("KalmanFilter.update", {"y": "deep"}),
    ("MovingHorizonEstimator.update", {"t": "deep"}),
    ("unobservable_modes", {"rtol": "span of time"}),
    ("SpacedWindows", {"window": "extended"}),
    ("KalmanFilter.smooth", {"record": "0-d array"}),
    ("OpeningCalendar", {"start": "no date"}),
    ("OpeningCalendar.elapsed_at", {"date": "no date"}),
    ("write_ics", {"start": "no date"}),
    ("OpeningCalendar.closed", {"own": "text in text"}),
    ("TimeVaryingPlant.transitions", {"times": "[]"}),
    ("read_plan", {"path": "zero byte"}),
    ("write_estimates", {"path": "half a letter"}),
    ("Plant", {"name": "half a letter"}),
    ("NonlinearPlant.linearise", {"u": "0-d array"}),
    ("error_map", {"horizon": "0"}),
    ("plant_along", {"u": "ragged"}),
    ("ConvexSet.ball", {"centre": "ragged"}),
)
"""Calls that were raw once, found by seeds 90101 to 90104, 91001 to 91030 and 501 to 503."""


@pytest.mark.long
def test_calls_that_were_raw_once_are_no_longer(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    doors = {door.name: door for door in front_door.doors()}
    calls = [front_door.Call(doors[name], tuple(faults.items())) for name, faults in FOUND]
    assert {str(call): found for call in calls if (found := call.raw())} == {}


@pytest.mark.parametrize(("seed", "calls"), few(DRAWN, 0))
def test_random_calls_end_in_a_value_or_in_one_sentence(seed, calls, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # "nosuch" is a name that a file may have
    raw = {str(call): found for call in front_door.drawn(calls, seed) if (found := call.raw())}
    assert raw == {}


def test_every_public_callable_is_among_them_with_arguments_that_are_right():
    doors = {door.name: door for door in front_door.doors()}
    assert set(sd.__all__) - front_door.UNCALLED - {"__version__"} <= set(doors)
    kinds = {name for name, kind in front_door.public().items() if isinstance(kind, type) and issubclass(kind, Record)}
    assert kinds <= set(front_door.OWNERS), "a record has methods that no call tries"


@functools.cache
def callables():
    """Made when a test asks, not when files are collected: certificates and a plan are among their arguments."""
    return [door for door in front_door.doors() if front_door.optional(door.name)]


@pytest.mark.parametrize("share", few(range(10), 0))
def test_a_keyword_that_is_mistyped_names_the_right_one(share):
    left = []
    for door in callables()[share::10]:
        thing = door.target(front_door.kept)
        if not refuses_words(thing):
            continue
        longest = max(front_door.optional(door.name), key=len)
        with pytest.raises(CallError, match=r"has no argument `.*`\. (Did you mean|Known:)") as told:
            thing(**{f"{longest}z": 1})
        if len(longest) > 3 and f"Did you mean {longest!r}?" not in str(told.value):
            left.append(door.name)
    assert left == []
    assert len(callables()) > 150


def refuses_words(thing):
    """Whether a keyword that is not known ends in a sentence: not of plain records, which nobody makes, nor of `**`."""
    plain = inspect.isclass(thing) and not issubclass(thing, Record) and "checked" not in vars(thing.__init__)
    return not plain and all(each.kind is not each.VAR_KEYWORD for each in inspect.signature(thing).parameters.values())


def test_what_other_packages_call_an_argument_names_ours():
    left, tried = [], 0
    for door in callables():
        thing = door.target(front_door.kept)  # each call is refused before its instance is asked
        known = {*inspect.signature(thing).parameters}
        for word, ours in ELSEWHERE.items():
            meant = [each for each in ours if each in known]
            if not meant or word in known or not refuses_words(thing):
                continue
            with pytest.raises(CallError) as told:
                thing(**{word: 1})
            tried += 1
            if f"Did you mean {meant[0]!r}?" not in str(told.value):
                left.append((door.name, word, str(told.value)))
    assert left == []
    assert tried > 300


def test_what_fits_nowhere_is_refused_by_the_name_of_its_argument():
    left, tried = [], 0
    for door in (each for each in front_door.doors() if each.name in sd.__all__):
        taken = inspect.signature(door.target()).parameters
        for key in front_door.optional(door.name):
            for came in (front_door.Odd(), *[None] * (taken[key].default is inspect.Parameter.empty)):
                tried += 1
                try:
                    door.target()(**door.arguments | {key: came})
                except sd.SamplingDesignError as error:
                    if f"`{key}" in str(error):
                        continue
                left.append((door.name, key, came))
    assert left == []
    assert tried > 350


def test_wherever_a_generator_is_taken_its_seed_is():
    taken = {door.name: inspect.signature(door.target(front_door.kept)).parameters.get("rng") for door in callables()}
    hints = {name: rng.annotation for name, rng in taken.items() if rng is not None and rng.default is None}
    assert {name: hint for name, hint in hints.items() if hint.rpartition(".")[2] != "Seed"} == {}
    assert len(hints) >= 8


@pytest.mark.parametrize("name", ["GapRange.draw", "Jitter.draw", "LostSamples.draw", "simulate_record"])
def test_a_seed_is_the_generator_with_that_seed(name):
    door = next(door for door in callables() if door.name == name)
    shown = []
    for rng in (7, np.random.default_rng(7), 8):
        made = door.target()(**door.arguments | {"rng": rng})
        shown.append(getattr(made, "measurements", made).to_dict() if hasattr(made, "to_dict") else made.measurements.y)
    assert str(shown[0]) == str(shown[1]) != str(shown[2])


def test_the_sweep_sees_what_is_raw(monkeypatch):
    no_such_keyword = front_door.Door("certify", {"plant": 3, "nosuch": 4})
    assert front_door.Call(no_such_keyword, ()).raw() == ""
    monkeypatch.setitem(front_door.public(), "broken", lambda x: [][x])
    assert "IndexError" in front_door.Call(front_door.Door("broken", {"x": 0}), ()).raw()


OSCILLATOR = np.array([[0.0, 1.0], [-1.0, 0.0]])
EDGES = {
    "no states": sd.Plant(np.zeros((0, 0)), np.zeros((1, 0))),
    "no disturbances": sd.Plant(OSCILLATOR, [[1.0, 0.0]], G=np.zeros((2, 0))),
    "no outputs of states that grow": sd.Plant(np.diag([0.1, 0.2]), np.zeros((1, 2))),
}
SCHEDULES = (sd.PeriodicSchedule([0.7]), sd.Schedule([0.0, 1.0, 2.5]), sd.Schedule([0.5]))
SMALL = {"w_bound": 0.1, "v_bound": 0.1}
ASKED = {
    "window_sigma": lambda plant, schedule: sd.window_sigma(plant, schedule, 4.0, timing_tolerance=0.1),
    "guaranteed_accuracy": lambda plant, schedule: sd.guaranteed_accuracy(plant, schedule, rtol=0.3, **SMALL),
    "deviations": lambda plant, schedule: sd.guaranteed_accuracy(
        plant, schedule, rtol=0.3, w_intensity=0.1, v_deviation=0.1, **SMALL
    ),
    "state_interval": lambda plant, schedule: sd.state_interval(plant, [(t, [0.1]) for t in schedule.times], **SMALL),
    "certificate_exists": lambda plant, schedule: sd.certificate_exists(plant, schedule, 0.01),
    "loss_tolerance": sd.observability.loss_tolerance,
    "accuracy_limit": lambda plant, schedule: sd.accuracy.accuracy_limit(plant, budget=1.0, **SMALL),
    "KalmanFilter": lambda plant, schedule: sd.KalmanFilter(plant, **SMALL).run([(t, [0.1]) for t in schedule.times]),
}


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("verb", ASKED)
def test_plants_at_the_edge_of_what_one_may_be_end_so_too(edge, verb):
    for schedule in SCHEDULES:
        try:
            found = ASKED[verb](EDGES[edge], schedule)
        except sd.SamplingDesignError:
            continue
        assert found.explain()
        assert str(found)
        assert found.to_dict() if hasattr(found, "to_dict") else True
        if hasattr(found, "verify"):
            assert found.verify()
