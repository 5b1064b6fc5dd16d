"""No change of a certificate file's structure is passed, or ends in anything but one sentence.

Every value of one file of each kind is replaced by a boolean, a text, nothing, a list or a table, every key and list
entry is left out, and unknown keys are added: the digest is made anew, so that only the grammar and the mathematics
stand between the file and a pass.
"""

import copy
import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from sampling_design.checkers import check
from sampling_design.checkers.grammar import digest

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
MADE = {
    "periodic": lambda: sd.certify(PLANT, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2)),
    "gap range": lambda: sd.certify_family(PLANT, GapRange(0.9, 1.1), eta=0.2, memory=0),
    "spaced windows": lambda: sd.certify_family(PLANT, SpacedWindows(3.0, 2, 1.0), eta=0.2, memory=0),
    "lost samples": lambda: sd.certify_family(PLANT, LostSamples(PeriodicSchedule([1.0]), 1, 3), eta=0.2, memory=0),
    "jitter": lambda: sd.certify_family(PLANT, Jitter(PeriodicSchedule([1.0]), 0.1), eta=0.2, memory=0),
    "detectability": lambda: sd.certify_detectability(PLANT),
}
WRONG = (True, "1", {"a": 1.0}, [[[1.0]]], 10**400)
MOST = 150
"""Places of one file; more of them are drawn at random."""


def places(value, path=()):
    """Every path into plain data."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inside:
        yield (*path, key)
        yield from places(item, (*path, key))


def holder(data, path):
    for key in path[:-1]:
        data = data[key]
    return data


@pytest.mark.parametrize("kind", MADE)
def test_no_value_of_another_type_passes(kind):
    whole = json.loads(json.dumps(MADE[kind]().to_dict()))
    rng = np.random.default_rng(12)
    free = {("solver",), ("tool", "name"), ("tool", "version"), ("plant", "name"), ("digest",), ("witness",)}
    every = [p for p in places(whole) if p not in free and p[0] not in ("solver", "tool") and p[-1] != "method"]
    for k in rng.permutation(len(every))[:MOST]:
        path = every[k]
        for wrong in WRONG:
            data = copy.deepcopy(whole)
            old = holder(data, path)[path[-1]]
            if isinstance(old, str) and isinstance(wrong, str):
                continue
            holder(data, path)[path[-1]] = wrong
            data["digest"] = digest(data)
            found = check(data)
            assert (found["verdict"], "\n" in found["reason"]) == ("bad file", False), (path, wrong, found)
        if isinstance(holder(whole, path), dict):
            data = copy.deepcopy(whole)
            holder(data, path)[f"{path[-1]}_"] = 1.0
            data["digest"] = digest(data)
            assert "unknown key" in check(data)["reason"], path
