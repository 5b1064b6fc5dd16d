"""Whatever the arguments, a public function, class or method returns a value or raises one sentence of ours.

Only a keyword that does not exist, or a number of arguments that does not fit, stays Python's own TypeError.
`python -m tests.front_door 2000 7` makes as many calls as one likes.
"""

import pytest

import sampling_design as sd
from sampling_design._record import Record
from tests import front_door

SEEDS = range(4)
CALLS = 200


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
    ("four_horizons", {"schedule": "schedule", "plant": "nothing to see"}),
    ("FamilyCertificate.error_bound", {"t": "-inf"}),
    ("SpacedWindows.draw", {"duration": "1e308"}),
    ("KalmanFilter.update", {"u": "objects"}),
    ("weights_from_bounds", {"initial_error": "1e-308"}),
    ("NonlinearPlant", {"limits": "complex array"}),
    ("check_detectability", {"pairs": "1e18"}),
)
"""Calls that were raw once, found by seeds 90101 to 90104 and 91001 to 91030."""


def test_calls_that_were_raw_once_are_no_longer(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    doors = {door.name: door for door in front_door.doors()}
    calls = [front_door.Call(doors[name], tuple(faults.items())) for name, faults in FOUND]
    assert {str(call): found for call in calls if (found := call.raw())} == {}


@pytest.mark.parametrize("seed", SEEDS)
def test_random_calls_end_in_a_value_or_in_one_sentence(seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # "nosuch" is a name that a file may have
    raw = {str(call): found for call in front_door.drawn(CALLS, seed) if (found := call.raw())}
    assert raw == {}


def test_every_public_callable_is_among_them_with_arguments_that_are_right():
    doors = {door.name: door for door in front_door.doors()}
    assert set(sd.__all__) - front_door.UNCALLED - {"__version__"} <= set(doors)
    kinds = {name for name, kind in front_door.public().items() if isinstance(kind, type) and issubclass(kind, Record)}
    assert kinds <= set(front_door.OWNERS), "a record has methods that no call tries"


def test_the_sweep_sees_what_is_raw(monkeypatch):
    no_such_keyword = front_door.Door("certify", {"plant": 3, "nosuch": 4})
    assert front_door.Call(no_such_keyword, ()).raw() == ""  # stays Python's own error
    monkeypatch.setitem(front_door.public(), "broken", lambda x: [][x])
    assert "IndexError" in front_door.Call(front_door.Door("broken", {"x": 0}), ()).raw()
