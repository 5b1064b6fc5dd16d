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
