"""Detectability certificates in ball arithmetic: proven, refuted by 1e-9, and what stops a proof."""

import copy
import dataclasses
import json
from itertools import product

import numpy as np
import pytest

from sampling_design import Plant, named_plant, read_certificate
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.certificates.rigorous.dissipation_balls import INEQUALITY, decided, detectability, downhill
from sampling_design.checkers.claims import certificate
from sampling_design.checkers.outcome import Refused
from sampling_design.checkers.parts import digest
from sampling_design.numerics import balls as balls
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.oracles import dissipation as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SCALAR = Plant([[1.0]], [[1.0]])
PLANTS = ["satellite", "tidal_gauge", "cart_pendulum", "three_compartment", "helicopter_he1", "triple_integrator"]


def redigested(data):
    return {**data, "digest": digest(data)}


def stated():
    return json.loads(json.dumps(certify_detectability(OSCILLATOR).to_dict()))


@pytest.mark.parametrize(("method", "name"), few(product(["riccati", "proof"], PLANTS), 0, 1, 7, 11))
def test_what_is_made_is_proven_with_the_slack_of_the_checker(name, method, tmp_path):
    plant = named_plant(name)
    made = detectability_from_proof(plant) if method == "proof" else certify_detectability(plant)
    back = read_certificate(made.save(tmp_path / "certificate.json"), plant)
    plain, rigorous = back.verify(), back.verify(rigorous=True)
    assert (plain.passed, rigorous.verdict) == (True, "proven")
    assert rigorous.amount == pytest.approx(plain.amount, rel=2e-3)
    assert rigorous.amount <= plain.amount
    assert min(oracle.least_eigenvalues(back.to_dict())) > 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "key"),
    [
        (name, key)
        for name in PLANTS
        for key in ("eta", "margin", "c_w", "c_y")
        if name != "tidal_gauge" or key == "eta"
    ],
)
def test_wrong_by_1e_9_is_refuted_along_a_direction_in_which_it_fails(name, key):
    """The value at which the inequality is tight, by bisection at 60 digits, and 1e-9 to either side."""
    data = certify_detectability(named_plant(name)).to_dict()
    up = key in ("eta", "margin")
    low, high = 0.0, 20.0 if key == "margin" else 0.9
    while high - low > 1e-13:
        middle = (low + high) / 2
        tried = {**data, key: data[key] * (1 + middle if up else 1 - middle)}
        low, high = (middle, high) if min(oracle.least_eigenvalues(tried, 30)) > 0 else (low, middle)
    step = 1e-9 if key != "margin" else 1e-9 / data["margin"]
    for off, verdict in ((-step, "proven"), (step, "refuted")):
        tried = redigested({**data, key: data[key] * (1 + low + off if up else 1 - low - off)})
        found = verify_rigorously(tried)
        assert found.verdict == verdict, found.reason
        assert oracle.holds(tried, 60) is (verdict == "proven")
    assert (found.inequality, found.passed) == (INEQUALITY, False)
    assert -1e-6 < found.amount < 0
    A, C, G, P, eta, c_w, c_y, margin = oracle.parts(tried)
    x, w = np.split(np.array(found.direction), [len(A)])
    growth = 2 * x @ P @ (A @ x + G @ w) + (1 + margin) * eta * x @ P @ x - c_w * w @ w - c_y * np.sum((C @ x) ** 2)
    assert growth > -1e-12 * np.linalg.norm(P, 2) * np.linalg.norm(A, 2)


def test_exactly_tight_is_undecided_and_refused_by_the_checker():
    made = DetectabilityCertificate(SCALAR, [[1.0]], eta=1.0, c_w=1.0, c_y=4.0)
    verdict = made.verify(rigorous=True)
    assert (verdict.verdict, verdict.inequality) == ("undecided", INEQUALITY)
    assert "tight or nearly so" in verdict.explain()
    assert not made.verify().passed


def test_a_spent_budget_is_undecided():
    verdict = certify_detectability(OSCILLATOR).verify(rigorous=True, budget=-1.0)
    assert (verdict.verdict, verdict.inequality, verdict.passed) == ("undecided", "budget", False)


def test_an_altered_file_is_refused_by_its_digest():
    assert verify_rigorously({**stated(), "eta": 0.1}).inequality == "digest"


@pytest.mark.parametrize(
    ("change", "inequality", "verdict"),
    [
        ({"eta": 0.0}, "form", "bad file"),
        ({"c_w": -1.0}, "form", "bad file"),
        ({"c_y": float("1e999")}, "form", "bad file"),
        ({"margin": -0.1}, "form", "bad file"),
        ({"P": [[1.0, 2.0], [2.0, 1.0]]}, "P > 0", "refuted"),
        ({"P": [[1.0, 1.0], [1.0, 1.0]]}, "P > 0", "undecided"),
        ({"P": [[1.0, 0.0], [0.0, 0.0]]}, "P > 0", "undecided"),
        ({"P": [[1.0]]}, "form", "bad file"),
        ({"P": None}, "form", "bad file"),
        ({"eta": "fast"}, "form", "bad file"),
        ({"claim": "assumption-7"}, "form", "bad file"),
    ],
)
def test_malformed_data_are_refused_with_the_right_word(change, inequality, verdict):
    data = {**stated(), **change}
    found = verify_rigorously(redigested(data) if change.get("c_y") is None else data)
    assert (found.inequality, found.verdict, found.passed) == (inequality, verdict, False)


@pytest.mark.parametrize(("off", "verdict"), [(1e-14, "proven"), (0.25, "bad file")])
def test_the_symmetric_part_is_what_counts_of_a_matrix_that_is_symmetric_but_for_rounding(off, verdict):
    data = stated()
    data["P"][0][1] += off
    data["P"][1][0] -= off
    assert verify_rigorously(redigested(data)).verdict == verdict


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"P": [[1.0, 2.0], [2.0, 1.0]]}, "fails by 1, an eigenvalue relative to the size of its terms"),
        ({"P": [[1.0, 1.0], [1.0, 1.0]]}, "could not be decided: it is tight or nearly so"),
        ({"eta": 30.0}, "an eigenvalue relative to the size of its terms, along"),
    ],
)
def test_what_stops_a_proof_says_why(change, message):
    with balls.precision(), pytest.raises(Refused, match=message):
        detectability(certificate(redigested({**stated(), **change})), Budget(60.0))


def test_elimination_finds_a_direction_where_floats_see_none():
    """Beside 2^100 a float of the least eigenvalue is noise; the pivot of L D L' is not."""
    huge = 2.0**100
    with balls.precision():
        form = balls.matrix([[huge, huge], [huge, huge]]) + balls.matrix([[0.0, 0.0], [0.0, -1.0]])
        value, z = downhill(form)
        assert -1.0 < float(value) < 0
        assert z == pytest.approx([-1.0, 1.0])
        with pytest.raises(Refused, match="an eigenvalue relative to the size of its terms") as stop:
            decided("form > 0", form, [form[0, 0], form[0, 0]])
    assert stop.value.amount < 0
    assert np.abs(stop.value.direction) == pytest.approx([np.sqrt(0.5)] * 2)
    with balls.precision():
        assert downhill(balls.identity(3)) is None


def test_the_record_is_the_file(tmp_path):
    made = certify_detectability(OSCILLATOR)
    wrong = dataclasses.replace(made, c_w=made.c_w / 2)
    verdict = read_certificate(wrong.save(tmp_path / "wrong.json")).verify(rigorous=True)
    assert verdict.verdict == "refuted"
    assert [label for label, _ in verdict._rows()][:4] == ["verdict", "passed", "inequality", "direction"]
    assert copy.deepcopy(verdict).to_dict()["direction"] == verdict.direction
