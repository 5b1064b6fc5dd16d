"""The float checker and ball arithmetic agree on a forged file: malformed in both or in neither, never yes and no.

What is malformed is called a bad file and never refuted, nothing is proven of an empty region, and both end within a
count of their work.
"""

import json
from functools import cache

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers import verdict
from sampling_design.checkers.frame import Frame
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.checkers.parts import digest
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few

WORK = 2e6
"""About microseconds that each route may do."""
WORST = 2.0
"""Times that a route may exceed it: it is counted before each of its steps, and the last one may be large."""
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
NOMINAL = sd.PeriodicSchedule([1.0, 0.5])
SLOPES = UncertainPlant(sd.Plant([[0.0]], [[1.0]]), [UncertainParameter("theta", -1.0, 1.0, A=[[1.0]])])
BETWEEN = UncertainPlant(sd.Plant([[0.0]], [[1.0]]), vertices=[sd.Plant([[-0.1]], [[1.0]]), sd.Plant([[0.1]], [[1.1]])])
SINE = {"code": [["x", 0], ["sin", 0], ["w", 0], ["add", 1, 2]], "outputs": [3]}
PRODUCT = {"code": [["x", 0], ["w", 0], ["mul", 0, 1]], "outputs": [2]}


def region(f, **changes):
    """A file of a nonlinear plant: x' = f(x, w), y = x."""
    free = {"low": [None], "high": [None]}
    model = {"kind": "nonlinear", "f": f, "h": {"code": [["x", 0]], "outputs": [0]}, "x": free, "w": free,
             "u": {"low": [], "high": []}, "rows": [[1.0]], "offsets": [5.0], **changes}  # fmt: skip
    return certify_inclusion(SLOPES, sd.GapRange(0.1, 0.2), eta=0.5, pieces=4).to_dict() | {"model": model}


FILES = {
    "periodic": lambda: sd.certify(OSCILLATOR, NOMINAL, eta=0.4, P2=np.eye(2)).to_dict(),
    "finite": lambda: sd.certify(OSCILLATOR, sd.Schedule([0.5, 1.5]), eta=0.4, P2=np.eye(2)).to_dict(),
    "jitter": lambda: sd.certify(OSCILLATOR, sd.Jitter(NOMINAL, 0.1), eta=0.1, memory=0, P2=np.eye(2)).to_dict(),
    "lost": lambda: sd.certify(OSCILLATOR, sd.LostSamples(NOMINAL, 1, 3), eta=0.1, memory=0, P2=np.eye(2)).to_dict(),
    "detectability": lambda: sd.certificates.certify_detectability(OSCILLATOR).to_dict(),
    "inclusion": lambda: certify_inclusion(SLOPES, sd.GapRange(0.1, 0.2), eta=0.5, pieces=4).to_dict(),
    "vertices": lambda: certify_inclusion(BETWEEN, sd.GapRange(0.1, 0.2), eta=0.5, pieces=2).to_dict(),
    "region": lambda: region(SINE),
}


@cache
def text(kind):
    return json.dumps(FILES[kind]())


def matrices(data):
    """Every square matrix of a file, by where it stands."""
    return [key for key in ("P", "P1", "P2", "Qw", "R", "Qv") if key in data]


def forged_files(kind):
    """Label, file, and whether it is malformed (None: the mathematics decides)."""
    whole = json.loads(text(kind))
    for key in sorted(whole):
        yield f"without {key}", {k: v for k, v in whole.items() if k != key}, True
    for key in matrices(whole):
        stack = isinstance(whole[key][0][0], list)
        one = whole[key][0] if stack else whole[key]
        for label, M, wrong in (
            ("short", one[:-1], True),
            ("text", [["NaN", *one[0][1:]], *one[1:]], True),
            ("negative", (-np.array(one)).tolist(), None),
            ("skew", (np.array(one) + np.triu(np.full(np.shape(one), 1e-3), 1)).tolist(), len(one) > 1),
        ):
            changed = [M, *whole[key][1:]] if stack else M
            yield f"{key} {label}", whole | {key: changed}, wrong or None
    if "graph" not in whole:
        yield "too fast", fast(whole), None
    if "graph" in whole or "model" in whole:
        yield "no edges", whole | {"graph": {"words": [[], []]} | whole.get("graph", {}) | {"edges": []}}, None
    words = whole.get("graph", {}).get("words")
    for word in ([0.5], [7.0], [0.0, 2.0], [0.0, 0.2, 0.1], []) if words and kind != "inclusion" else ():
        yield f"word {word}", whole | {"graph": whole["graph"] | {"words": [*words[:-1], word]}}, True
    if whole.get("witness"):
        for change in ({"start": 9.0, "t": 1.0}, {"t": 1e300}, {"direction": [0.0, 0.0]}, {"ratio": -1.0}):
            yield f"witness {change}", whole | {"witness": whole["witness"] | change}, True
        yield "a larger ratio", whole | {"witness": whole["witness"] | {"ratio": 2 * whole["witness"]["ratio"]}}, False
    if kind == "region":
        yield from of_regions()


def fast(whole):
    """A plant of 1e60 radians a unit of time."""
    numbers = whole["plant"]["matrices"]
    return whole | {"plant": whole["plant"] | {"matrices": numbers | {"A": (1e60 * np.array(numbers["A"])).tolist()}}}


def of_regions():
    """Regions without a state, by a lot and by a hair; a disturbance without bound that multiplies the state."""
    box = {"low": [1.0], "high": [2.0]}
    for offset in (0.0, 1 - 1e-10, float(np.nextafter(1.0, 0.0))):
        yield f"empty up to {offset!r}", region(SINE, x=box, offsets=[offset]), True
    yield "one state", region(SINE, x=box, offsets=[1.0]), False
    yield "unbounded product", region(PRODUCT), False
    yield "unbounded product in a box", region(PRODUCT, x=box), False
    yield "unbounded slope", region({"code": [["x", 0], ["power", 0, 1e308]], "outputs": [1]}), False


@pytest.mark.parametrize("kind", few(FILES, 1, 2, 4, 5, 6, 7))
def test_the_two_routes_agree_on_forged_files(kind):
    counts = {}
    for label, data, malformed in forged_files(kind):
        data = data if label == "without digest" else {**data, "digest": digest(data)}
        in_floats, in_balls = WorkLimit(WORK), WorkLimit(WORK)
        found = verdict(data, in_floats).verdict, verify_rigorously(data, np.inf, in_balls).verdict
        kinds = {word == "bad file" for word in found}
        assert len(kinds) == 1, (label, found)
        assert malformed is None or kinds == {malformed}, (label, found)
        assert set(found) != {"proven", "refuted"}, (label, found)
        assert min(in_floats.left, in_balls.left) > -WORST * WORK, label
        counts[found] = counts.get(found, 0) + 1
    assert counts["bad file", "bad file"] >= len(json.loads(text(kind)))


@pytest.mark.parametrize("kind", ["vertices", "region"])
def test_the_plant_of_a_file_is_one_of_its_model(kind):
    """The plant that a reader compares with theirs stood beside the model, and nothing was proven of it."""
    whole = json.loads(text(kind))
    proven, plant = verdict(whole | {"digest": digest(whole)}), whole["plant"]
    assert proven.verdict == "proven"
    for key, value in (("A", [[5.0]]), ("C", [[0.0]]), ("G", [[30.0]])):
        forged = whole | {"plant": plant | {"matrices": plant["matrices"] | {key: value}}}
        forged["digest"] = digest(forged)
        found = verdict(forged), verify_rigorously(forged)
        assert [each.verdict for each in found] == ["refuted", "refuted"], key
        assert "where the plant is" in found[0].reason
        assert "the centre" in found[0].reason


def test_no_map_carries_every_plant_of_a_model():
    whole = json.loads(text("inclusion"))
    bare = {key: whole["plant"][key] for key in ("format", "matrices")}
    forged = whole | {"plant": whole["plant"] | {"part_of": {"plant": bare, "map": [[1.0]], "rows": 1}}}
    forged["digest"] = digest(forged)
    for found in (verdict(forged), verify_rigorously(forged)):
        assert found.verdict == "bad file"
        assert "`plant.part_of` must be left out: no map carries every plant of a model" in found.reason


@pytest.mark.parametrize(("more", "said"), [(1.0, "proven"), (1.004, "refuted")])
def test_a_witness_leaves_out_no_sample_of_its_window(more, said):
    """A billionth of a late time is no rounding of it: what a sample so near would forbid is not attained."""
    whole = sd.certify(sd.Plant([[10.0]], [[1.0]]), sd.PeriodicSchedule([1.0]), eta=1.0, P2=[[1.0]]).to_dict()
    late, near = 99_000.0, 0.999e-9 * 99_000.0
    peak = {"start": late - near, "t": late + 1 + near, "direction": [1.0]}
    lams = {key: whole[key] * more for key in ("lam", "lam_samples")}
    forged = whole | lams | {"witness": peak | {"ratio": whole["witness"]["ratio"] * more}}
    forged["digest"] = digest(forged)
    assert verdict(forged).verdict == verify_rigorously(forged).verdict == said


def test_what_a_flow_costs_is_counted_however_fast_the_plant(monkeypatch):
    """Two hundred doublings of a gap of 1e60 time constants took twenty times the work that was counted."""
    done, doubt = [0], Frame.doubt
    monkeypatch.setattr(Frame, "doubt", lambda self, w, *rest: done.append(len(w)) or doubt(self, w, *rest))
    forged = fast(json.loads(text("lost")))
    assert verdict({**forged, "digest": digest(forged)}, WorkLimit(WORK / 10)).verdict == "undecided"
    assert 0 < sum(done) < WORK / 40


@pytest.mark.parametrize("count", [1, 3])
def test_nothing_is_proven_of_windows_that_rounding_leaves_empty(count):
    """Samples a billionth too far apart fit no window: a graph without them was said to hold every schedule."""
    apart = 0.3 / count
    honest = sd.certify(OSCILLATOR, sd.SpacedWindows(0.3, count, apart), eta=0.1, memory=0, P2=np.eye(2)).to_dict()
    graph = {"words": [[], [0.0]], "edges": [[0, 1, 0.0, 0.3, [1]]], "P": honest["graph"]["P"][:1]}
    forged = honest | {"graph": graph, "times": honest["times"] | {"spacing": apart * (1 + 5e-10)}}
    for data, expected in ((honest, "proven"), (forged, "refuted")):
        data["digest"] = digest(data)
        assert verdict(data).verdict == verify_rigorously(data).verdict == expected
