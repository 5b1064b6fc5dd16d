"""The checker of family certificates: independent, and not to be fooled."""

import ast
import copy
import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from sampling_design.certificates import family_checker
from sampling_design.certificates.checker import Refused
from sampling_design.certificates.form import seal
from tests.oracles.families import step_holds

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
WHICH = {
    "gap-range": GapRange(0.5, 1.5),
    "spaced-windows": SpacedWindows(4.0, 3, 0.5),
    "lost-samples": LostSamples(PeriodicSchedule([1.0]), 1, 3),
    "jitter": Jitter(PeriodicSchedule([1.0, 1.5]), 0.2),
}


@cache
def made(kind):
    return sd.certify_family(OSCILLATOR, WHICH[kind], eta=0.3, memory=1)


def data_of(kind):
    return copy.deepcopy(made(kind).to_dict())


def verdict(data):
    data["digest"] = seal.digest(data)
    return family_checker.check(data)


@pytest.mark.parametrize("kind", WHICH)
def test_every_stated_inequality_holds_by_the_oracle(kind):
    c = made(kind)
    weights = (c.Qw, c.R, c.Qv)
    for edge in c.graph.edges:
        for h in np.linspace(edge.low, edge.high, 9):
            assert step_holds(c.plant, weights, c.eta, c.P[edge.source], c.P[edge.target], h, edge.outputs) > 0
    for P, top in zip(c.P, c.graph.tops, strict=True):
        for s in np.linspace(0.0, top, 33):
            for target in (c.P1 * (1 + c.margin), (1 - 1e-3) * c.P2 / c.lam):
                assert step_holds(c.plant, weights, c.eta, P, target, s, []) > 0


@pytest.mark.parametrize("kind", WHICH)
@pytest.mark.parametrize("name", ["P1", "P2", "P", "Qw", "R", "eta", "lam"])
def test_wrong_numbers_are_refused_though_the_digest_fits(kind, name):
    data = data_of(kind)
    if name == "P":
        data["graph"]["P"][-1] = (1.3 * np.array(data["graph"]["P"][-1])).tolist()
    elif name in ("eta", "lam"):
        data[name] *= {"eta": 1.1, "lam": 0.99}[name]
    else:
        factor = {"P1": 1.01, "P2": 0.8, "Qw": 0.8, "R": 0.2}[name]
        data[name] = (factor * np.array(data[name])).tolist()
    found = verdict(data)
    assert not found["passed"]
    assert "fails by" in found["reason"] or "could not be decided" in found["reason"]


def test_a_failed_inequality_names_the_gap():
    data = data_of("gap-range")
    data["P1"] = (1.02 * np.array(data["P1"])).tolist()
    found = verdict(data)
    assert found["inequality"] == "(1 + margin) P1 <= Pi(t)"
    assert -0.03 < found["amount"] < -0.01
    assert 0.0 <= found["time"] <= 1.5


@pytest.mark.parametrize("kind", WHICH)
def test_no_edge_can_be_left_out(kind):
    whole = data_of(kind)
    for k, (_, _, low, high, _) in enumerate(whole["graph"]["edges"]):
        if kind == "spaced-windows" and high - low < 1e-9:
            continue  # there only so that rounding loses no schedule
        data = copy.deepcopy(whole)
        del data["graph"]["edges"][k]
        found = verdict(data)
        assert not found["passed"]
        assert "does not hold the family" in found["reason"]


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("gap-range", "shortest", 0.4),
        ("gap-range", "longest", 1.6),
        ("spaced-windows", "window", 4.5),
        ("spaced-windows", "count", 2),
        ("spaced-windows", "spacing", 0.4),
        ("lost-samples", "most", 2),
        ("lost-samples", "of", 1),
        ("jitter", "radius", 0.25),
    ],
)
def test_a_larger_family_is_not_covered(kind, key, value):
    data = data_of(kind)
    data["times"][key] = value
    assert "does not hold the family" in verdict(data)["reason"]


def test_a_smaller_family_is_covered():
    data = data_of("gap-range")
    data["times"] |= {"shortest": 0.6, "longest": 1.4}
    assert verdict(data)["passed"]


@pytest.mark.parametrize("kind", ["spaced-windows", "lost-samples"])
def test_words_may_not_remember_what_did_not_happen(kind):
    data = data_of(kind)
    word = next(w for w in data["graph"]["words"] if w and w[-1])
    word[-1] = word[-1] * 1.5 if kind == "spaced-windows" else 0
    if kind == "spaced-windows":
        assert "does not hold the family" in verdict(data)["reason"]
    else:  # to forget a loss is allowed, but then one more may follow
        assert not verdict(data)["passed"]


def test_nominal_schedules_are_judged_too():
    for change in ({"gaps": [1.1]}, {"gaps": [0.9]}, {"first": 1.1}):
        data = data_of("lost-samples")
        data["times"]["schedule"] |= change
        assert not verdict(data)["passed"]
    data = data_of("lost-samples")
    data["times"]["schedule"]["output_names"] = ["y"]
    assert "without names" in verdict(data)["reason"]
    data = data_of("jitter")
    data["times"]["schedule"]["gaps"] = [-1.0, 3.5]
    assert "positive gaps" in verdict(data)["reason"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(eta=0.0), "eta must be positive"),
        (lambda d: d.update(lam_samples=1.0), "lam_samples is lam"),
        (lambda d: d.update(witness={"t": 1.0}), "no witness"),
        (lambda d: d["P1"][0].__setitem__(1, 5.0), "not symmetric"),
        (lambda d: d.update(P1=[[1.0, 0.0], [0.0, -1.0]]), "not positive definite"),
        (lambda d: d["graph"]["edges"][0].__setitem__(1, 99), "is no edge"),
        (lambda d: d["graph"]["words"].append([1.0]), "the graph must have one matrix per word"),
        (lambda d: d["graph"]["edges"].pop(), "the graph does not hold the family: at node"),
    ],
)
def test_what_is_no_certificate_is_refused_in_words(change, words):
    data = data_of("gap-range")
    change(data)
    with pytest.raises(Refused, match=words):
        family_checker.family(data)
    assert words in verdict(data)["reason"]


def test_claim_and_digest_come_first():
    for change in ({"claim": "guess"}, {"times": {"kind": "guess"}}):
        assert "no proof is known" in verdict(data_of("gap-range") | change)["reason"]
    assert "no certificate" in verdict(data_of("gap-range") | {"graph": {}})["reason"]
    data = data_of("gap-range")
    data["lam"] = 10.0
    assert family_checker.check(data)["inequality"] == "digest"


def test_a_violation_between_two_grid_points_is_seen():
    # a grid of 0.1 never meets pi: P_+ of that grid is accepted by every one of its points, and refused here
    data = data_of("gap-range")
    data["times"]["longest"] = 3.3
    for edge in data["graph"]["edges"]:
        edge[3] = 3.3 if edge[3] == 1.5 else edge[3]
    found = verdict(data)
    assert not found["passed"]
    assert "at gap" in found["reason"]


def test_a_plant_in_other_units_is_judged_alike():
    scale = np.array([2.0**30, 2.0**-20])
    plant = Plant(np.diag(scale) @ OSCILLATOR.A @ np.diag(1 / scale), OSCILLATOR.C / scale, G=np.diag(scale))
    data = data_of("gap-range")
    there = data_of("gap-range")
    there["plant"] = plant.to_dict()
    for key in ("P1", "P2"):
        there[key] = (np.array(data[key]) / scale / scale[:, None]).tolist()
    there["graph"]["P"] = [(np.array(P) / scale / scale[:, None]).tolist() for P in data["graph"]["P"]]
    assert verdict(there)["amount"] == verdict(data)["amount"]


def test_it_runs_alone_and_imports_nothing_else(tmp_path):
    room = Path(family_checker.__file__)
    imported = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(room.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names])
    }
    assert imported == {"hashlib", "json", "sys", "types", "typing", "numpy", "sampling_design"}
    assert room.read_text().count("from sampling_design") == 1
    text = json.dumps(data_of("gap-range"))
    command = [sys.executable, "-m", "sampling_design.certificates.family_checker"]
    good = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert (good.returncode, "every schedule of the family" in good.stdout) == (0, True)
    bad = subprocess.run(
        command, input=text.replace('"eta": 0.3', '"eta": 0.4'), capture_output=True, text=True, check=False
    )
    assert (bad.returncode, "digest" in bad.stdout) == (1, True)
