"""The checker of family certificates: independent, and not to be fooled."""

import copy
import re
from functools import cache
from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers import check, claims, families, parts
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.strict import BadFile
from sampling_design.schedules.output_jitter import OutputJitter
from tests.cases import few
from tests.oracles.families import step_holds

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
TWO = Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2))
WHICH = {
    "gap-range": GapRange(0.5, 1.5),
    "spaced-windows": SpacedWindows(4.0, 3, 0.5),
    "lost-samples": LostSamples(PeriodicSchedule([1.0]), 1, 3),
    "jitter": Jitter(PeriodicSchedule([1.0, 1.5]), 0.2),
    "output-jitter": OutputJitter(PeriodicSchedule([1.0]), [0.1, 0.05], [0.05, 0.1]),
}


@cache
def made(kind):
    plant, memory = (TWO, 0) if kind == "output-jitter" else (OSCILLATOR, 1)
    return sd.certify(plant, WHICH[kind], eta=0.3, memory=memory, P2=np.eye(2))


def data_of(kind):
    return copy.deepcopy(made(kind).to_dict())


def verdict(data):
    data["digest"] = parts.digest(data)
    return check(data)


@pytest.mark.parametrize("kind", few(WHICH, 0, 2))
def test_every_stated_inequality_holds_by_the_oracle(kind):
    c = made(kind)
    weights = (c.Qw, c.R, c.Qv)
    for edge in c.graph.edges:
        for h in np.linspace(edge.low, edge.high, 5):
            assert step_holds(c.plant, weights, c.eta, c.P[edge.source], c.P[edge.target], h, edge.outputs) > 0
    for P, top in zip(c.P, c.graph.tops, strict=True):
        for s in np.linspace(0.0, top, 9):
            for target in (c.P1 * (1 + c.margin), (1 - 1e-3) * c.P2 / c.lam):
                assert step_holds(c.plant, weights, c.eta, P, target, s, []) > 0


@pytest.mark.parametrize(
    ("name", "kind"),
    few(
        product(["P1", "P2", "P", "Qw", "R", "eta", "lam"], WHICH),
        *(0, 2, 6, 8, 12, 14, 17, 20, 23, 26, 29, 32),
    ),
)
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
        ("jitter", "timing_tolerance", 0.25),
        ("output-jitter", "early", [0.1, 0.06]),
        ("output-jitter", "late", [0.06, 0.1]),
    ],
)
def test_a_larger_family_is_not_covered(kind, key, value):
    data = data_of(kind)
    data["times"][key] = value
    assert "does not hold the family" in verdict(data)["reason"]


def test_a_family_of_nothing_is_no_family():
    data = data_of("lost-samples")
    data["times"]["of"] = 1
    assert "`times.most` must be less than `times.of`" in verdict(data)["reason"]


def test_a_smaller_family_is_covered():
    data = data_of("gap-range")
    data["times"] |= {"shortest": 0.6, "longest": 1.4}
    assert verdict(data)["passed"]


def test_a_forged_start_that_leaves_no_room_for_a_gap_is_refused():
    """A start that takes a gap of 1e9 for granted would need no edge, and pass for an unobservable, unstable plant."""
    data = data_of("spaced-windows")
    data["plant"]["matrices"] = {"A": [[1.0, 0.0], [0.0, 2.0]], "C": [[0.0, 0.0]]}
    data |= {"P1": (0.99 * np.array(data["P2"])).tolist(), "lam": 1.0, "lam_samples": 1.0}
    for root, words in (([1e9], "must have an empty word for the window's start"), ([], "at node 0, gaps from 0 to 3")):
        data["graph"] = {"words": [root], "edges": [], "P": []}
        assert words in verdict(data)["reason"]
        assert words in verify_rigorously(data).reason


@pytest.mark.parametrize("source", [True, False, "0", 0.0, None])
def test_what_is_no_number_of_a_node_is_no_edge(source):
    data = data_of("lost-samples")
    data["graph"]["edges"][0][0] = source
    assert "`graph.edges[0][0]` must be a whole number" in verdict(data)["reason"]


@pytest.mark.parametrize("kind", ["lost-samples", "jitter"])
def test_the_nominal_schedule_is_in_the_plants_unit(kind):
    data = data_of(kind)
    data["times"]["schedule"]["time_unit"] = "h"
    assert "`times.schedule.time_unit` must be the plant's, 's', got 'h'" in verdict(data)["reason"]


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
    assert "`times.schedule.gaps[0]` must be positive" in verdict(data)["reason"]
    data["times"]["schedule"] |= {"gaps": [1.0, 1.5], "outputs": [[1], [1, 1]]}
    assert "must have 2 rows of 1 numbers 0 or 1" in verdict(data)["reason"]
    data = data_of("jitter")
    del data["times"]["schedule"]["period"]
    data["digest"] = parts.digest(data)
    with pytest.raises(BadFile, match="must have `times` and `period` together, or neither"):
        claims.certificate(data)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(eta=0.0), "`eta` must be positive"),
        (lambda d: d.update(lam_samples=1.0), "`lam_samples` must be at least `lam`"),
        (lambda d: d.update(witness={"t": 1.0, "start": 0.0, "direction": [1.0, 0.0], "ratio": 1.0}), "has no witness"),
        (lambda d: d["P1"][0].__setitem__(1, 5.0), "`P1` must be symmetric"),
        (lambda d: d.update(P1=[[1.0, 0.0], [0.0, -1.0]]), "not positive definite"),
        (lambda d: d["graph"]["edges"][0].__setitem__(1, 99), "must join two of"),
        (lambda d: d["graph"]["words"].append([1.0]), "one matrix per word"),
        (lambda d: d["graph"]["words"].__setitem__(0, [1e9]), "must have an empty word"),
        (lambda d: d["graph"]["edges"].pop(), "the graph does not hold the family: at node"),
        (lambda d: d["graph"]["edges"][-1].__setitem__(4, [0]), "does not measure every output"),
        (lambda d: d["times"].update(time_unit="h"), "`times.time_unit` must be the plant's, 's', got 'h'"),
        (lambda d: d["times"].update(shortest=1.7), "`times.longest` must be at least `times.shortest`"),
    ],
)
def test_what_is_no_certificate_is_refused_in_words(change, words):
    data = data_of("gap-range")
    change(data)
    found = verdict(data)
    assert words in found["reason"]
    with pytest.raises((Refused, BadFile), match=re.escape(words)):
        families.prove(claims.certificate(data))


def test_claim_and_digest_come_first():
    assert "`claim` must be" in verdict(data_of("gap-range") | {"claim": "guess"})["reason"]
    assert (
        "`times.kind` of a family must be one of"
        in verdict(data_of("gap-range") | {"times": {"kind": "guess"}})["reason"]
    )
    assert "no certificate" in verdict(data_of("gap-range") | {"graph": {}})["reason"]
    data = data_of("gap-range")
    data["lam"] = 10.0
    assert check(data)["inequality"] == "digest"


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


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("jitter", [0.5, 0.0, 0.0]),
        ("jitter", [0.0, 0.1, -0.1]),
        ("lost-samples", [9.0]),
        ("lost-samples", [0.0, 2.0]),
        ("output-jitter", [0.0, 0.1]),
        ("output-jitter", [0.0, 0.0, 0.1, 2.0]),  # no such output
        ("output-jitter", [0.0, 0.0, 0.1, 0.0, 1.0]),  # none was read
        ("output-jitter", [0.0, 0.1, 0.0, 1.0]),
    ],
)
def test_what_is_no_word_of_a_family_is_a_bad_file(kind, word):
    data = data_of(kind)
    data["graph"]["words"][1] = word
    with pytest.raises(BadFile, match="must be a word of the family, got a list"):
        claims.certificate(data | {"digest": parts.digest(data)})


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("jitter", {"timing_tolerance": 9.0}, "must be less than half of the least gap"),
        ("spaced-windows", {"count": 99}, "must have room for an endless schedule"),
        ("jitter", {"schedule": {"kind": "finite", "times": [1.0, 2.0]}}, "must be periodic and have `gaps`"),
        ("output-jitter", {"early": [0.1]}, "`times.early` must have 2 entries, one for each output, got 1"),
        ("output-jitter", {"late": [0.1, 0.9]}, "be less than the least gap, the largest of each"),
        ("output-jitter", {"schedule": {"kind": "periodic", "gaps": [1.0], "outputs": [[0, 0]]}}, "each row with a 1"),
    ],
)
def test_what_is_no_family_is_a_bad_file(kind, change, words):
    data = data_of(kind)
    data["times"] |= change
    with pytest.raises(BadFile, match=words):
        claims.certificate(data | {"digest": parts.digest(data)})


def test_weights_that_join_outputs_read_one_at_a_time_are_a_bad_file():
    data = data_of("output-jitter")
    data["R"] = [[2.0, 0.5], [0.5, 2.0]]
    with pytest.raises(BadFile, match="`R` must be diagonal, and `Qv`, where outputs are read one at a time"):
        claims.certificate(data | {"digest": parts.digest(data)})


def test_no_inclusion_has_outputs_that_are_read_one_at_a_time():
    box = sd.UncertainPlant(TWO, [sd.UncertainParameter("k", 0.9, 1.1, A=[[0.0, 0.0], [-1.0, 0.0]])])
    data = sd.certify(box, GapRange(0.5, 1.0), eta=0.1).to_dict()
    data["times"] = WHICH["output-jitter"].to_dict()
    with pytest.raises(BadFile, match=r"`times\.kind` must be another one for an inclusion: its samples are read tog"):
        claims.certificate(data | {"digest": parts.digest(data)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda g: g.update(words=[[], [0.0, -0.1, 0.1]], edges=[], P=g["P"][:1]), "outputs of a sample that are yet"),
        (lambda g: g["edges"][0].__setitem__(4, [1, 1]), "is no reading that may follow"),
        (lambda g: g["edges"][0].__setitem__(4, [1 - on for on in g["edges"][0][4]]), "does not hold the family"),
        (lambda g: g["edges"][0].__setitem__(3, 0.99 * g["edges"][0][3]), "leaves out gaps of that deviation"),
        (lambda g: g["words"][1].__setitem__(1, g["words"][1][1] + 0.01), "the graph does not hold the family"),
    ],
)
def test_a_graph_that_loses_an_order_or_a_time_of_readings_is_refused(change, words):
    data = data_of("output-jitter")
    change(data["graph"])
    assert words in verdict(data)["reason"]
    assert words in verify_rigorously(data).reason


def test_what_no_halving_decides_is_undecided(monkeypatch):
    monkeypatch.setattr(families, "ROUNDS", 0)
    with pytest.raises(Undecided, match="could not be decided: it is tight or nearly so"):
        families.prove(claims.certificate(data_of("gap-range")))
