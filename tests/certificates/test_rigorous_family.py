"""Family certificates in ball arithmetic: each kind is proven, what is wrong by 1e-9 or leaves a gap out is refused."""

import dataclasses
import json
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import minimize_scalar

from sampling_design import (
    GapRange,
    Jitter,
    LostSamples,
    PeriodicSchedule,
    Plant,
    SpacedWindows,
    certify,
)
from sampling_design.certificates.families.certify_family import certify_family
from sampling_design.certificates.rigorous.ball_problem import BallWeights
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.certificates.rigorous.family_balls import BallIntervals
from sampling_design.checkers.claims import certificate
from sampling_design.checkers.cover import covers
from sampling_design.checkers.outcome import Refused
from sampling_design.numerics import balls as balls
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.checkers.test_sampled import redigested
from tests.oracles import riccati as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
WEIGHTS = {"Qw": np.eye(2), "R": [[1.0]], "Qv": [[1.0]], "eta": 0.1}
CASES = {
    "oscillator, gap range": (OSCILLATOR, GapRange(0.5, 1.5)),
    "oscillator, wide gap range": (OSCILLATOR, GapRange(0.5, 2.5)),
    "double integrator, gap range": (DOUBLE, GapRange(0.1, 4.0)),
    "spaced windows": (OSCILLATOR, SpacedWindows(4.0, 3, 0.5)),
    "lost samples": (OSCILLATOR, LostSamples(PeriodicSchedule([1.0]), 1, 3)),
    "jitter": (OSCILLATOR, Jitter(PeriodicSchedule([1.0, 0.7]), 0.1)),
}


@pytest.fixture(scope="module")
def made():
    kept = {}

    def get(name):
        if name not in kept:
            plant, family = CASES[name]
            kept[name] = certify(plant, family, P2=np.eye(2), **WEIGHTS)
        return kept[name]

    return get


def tightest(certificate):
    """Least factor of P1 <= Phi_s(P_u) over nodes and times: a scan, then Brent's method around its best point."""
    plant, S = certificate.plant, np.linalg.inv(certificate.Qw)

    def factor(s, P):
        F, W = oracle.flow(plant.A, S, certificate.eta, s)
        return scipy.linalg.eigh(np.linalg.inv(F @ np.linalg.solve(P, F.T) + W), certificate.P1, eigvals_only=True)[0]

    least = np.inf
    for P, top in zip(certificate.P, certificate.graph.tops, strict=True):
        times = np.linspace(0, top, 60)
        values = [factor(s, P) for s in times]
        k = int(np.argmin(values))
        around = (times[max(k - 1, 0)], times[min(k + 1, 59)])
        polished = minimize_scalar(factor, bounds=around, args=(P,), method="bounded", options={"xatol": 1e-10})
        least = min(least, polished.fun, *values)
    return least


@pytest.mark.parametrize("name", few(CASES, 0, 2, 4, 5))
def test_every_family_is_proven(name, made):
    verdict = made(name).verify(rigorous=True)
    assert verdict.verdict == "proven"
    assert verdict.amount > 0
    assert "every schedule of the family" in verdict.reason


@pytest.mark.parametrize("name", few(CASES, 0, 4, 5))
def test_p1_wrong_by_1e_9_is_refuted_and_right_by_1e_9_is_proven(name, made):
    case = made(name)
    exact = tightest(case) / (1 + case.margin)
    wrong = dataclasses.replace(case, P1=case.P1 * exact * (1 + 1e-9)).verify(rigorous=True)
    assert wrong.verdict == "refuted"
    assert wrong.inequality == "(1 + margin) P1 <= Pi(t)"
    assert dataclasses.replace(case, P1=case.P1 * exact * (1 - 1e-9)).verify(rigorous=True).verdict == "proven"


@pytest.mark.parametrize("name", CASES)
def test_a_node_that_claims_too_much_is_refuted_on_its_edge(name, made):
    data = json.loads(json.dumps(made(name).to_dict()))
    data["graph"]["P"][-1] = (1.2 * np.array(data["graph"]["P"][-1])).tolist()
    verdict = verify_rigorously(redigested(data))
    assert verdict.verdict == "refuted"
    assert verdict.inequality.startswith("Phi_h(P_u) + C'R~C >= P_")


def test_an_edge_is_tight_to_1e_9():
    """x' = 0, y = x, no disturbance counts: Phi_h(P) = e^(-eta h) P, so that P_1 = e^(-eta h_max) P_1 + R~ exactly."""
    plant, eta, top = Plant([[0.0]], [[1.0]], G=[[0.0]]), 0.1, 1.5
    right = certify(plant, GapRange(0.5, top), P2=[[1.0]], Qw=[[1.0]], R=[[2.0]], Qv=[[2.0]], eta=eta)
    settled = 1.0 / (1 - np.exp(-eta * top))
    for factor, verdict in ((1 - 1e-9, "proven"), (1 + 1e-9, "refuted")):
        data = json.loads(json.dumps(right.to_dict()))
        data["graph"] = {"words": [[], [0.0]], "edges": [[0, 1, 0.0, top, [1]], [1, 1, 0.5, top, [1]]]}
        data["graph"]["P"] = [[[settled * factor]]]
        data["P2"], data["P1"] = [[settled * 2]], [[settled * 0.5]]
        data["lam"] = data["lam_samples"] = 10.0
        assert verify_rigorously(redigested(data)).verdict == verdict


def test_a_gap_range_that_holds_half_a_turn_is_never_proven(made):
    """Every grid point may be fine: one gap, pi, is not."""
    case = made("oscillator, wide gap range")
    data = json.loads(json.dumps(case.to_dict()))
    data["times"]["longest"] = 3.3
    for edge in data["graph"]["edges"]:
        edge[3] = 3.3 if edge[3] == 2.5 else edge[3]
    shrunk = 1e-3 * np.eye(2)
    data["P1"], data["lam"], data["lam_samples"] = (1e-6 * np.eye(2)).tolist(), 1e6, 1e6
    data["graph"]["P"] = [shrunk.tolist() for _ in data["graph"]["P"]]
    assert not verify_rigorously(redigested(data)).passed


@pytest.mark.parametrize("name", CASES)
def test_a_graph_without_one_of_its_edges_does_not_hold_the_family(name, made):
    for k in range(len(made(name).graph.edges)):
        data = json.loads(json.dumps(made(name).to_dict()))
        del data["graph"]["edges"][k]
        verdict = verify_rigorously(redigested(data))
        assert (verdict.verdict, verdict.inequality) == ("refuted", "graph")
        assert "does not hold the family: at node" in verdict.reason


@pytest.mark.parametrize("name", ["oscillator, gap range", "spaced windows", "jitter"])
def test_an_edge_too_short_by_the_last_digits_leaves_schedules_out(name, made):
    data = json.loads(json.dumps(made(name).to_dict()))
    for edge in data["graph"]["edges"]:
        edge[3] *= 1 - 1e-13
    assert verify_rigorously(redigested(data)).inequality == "graph"


def test_words_that_take_a_longer_gap_for_granted_are_refused():
    remembering = certify_family(OSCILLATOR, SpacedWindows(4.0, 3, 0.5), memory=1, **WEIGHTS)
    data = json.loads(json.dumps(remembering.to_dict()))
    assert verify_rigorously(data).verdict == "proven"
    longest = max(range(len(data["graph"]["words"])), key=lambda u: sum(data["graph"]["words"][u]))
    data["graph"]["words"][longest][0] *= 1 + 1e-14
    assert verify_rigorously(redigested(data)).inequality == "graph"


@pytest.mark.parametrize(
    ("path", "value", "inequality"),
    [
        (["lam_samples"], 1.0, "form"),
        (["witness"], {"t": 1.0, "start": 0.0, "direction": [1.0, 0.0], "ratio": 1.0}, "form"),
        (["times", "time_unit"], "h", "form"),
        (["graph", "words"], [[]], "form"),
        (["graph", "edges"], [[0, 0, 0.0, 1.5, [1]]], "form"),
        (["graph", "edges"], [[0, 1, 1.5, 0.0, [1]]], "form"),
        (["graph", "edges"], [[0, 1]], "form"),
        (["times", "kind"], "whenever", "form"),
    ],
)
def test_malformed_families_are_refused_with_the_right_word(path, value, inequality, made):
    data = json.loads(json.dumps(made("oscillator, gap range").to_dict()))
    *head, last = path
    inner = data
    for key in head:
        inner = inner[key]
    inner[last] = value
    found = verify_rigorously(redigested(data))
    assert (found.inequality, found.passed) == (inequality, False)


@pytest.mark.parametrize(
    ("key", "value"), [("gaps", [1.0, -0.7]), ("first", 9.0), ("output_names", ["y"]), ("outputs", [[1, 1], [1, 1]])]
)
def test_a_nominal_schedule_must_be_one(key, value, made):
    data = json.loads(json.dumps(made("jitter").to_dict()))
    data["times"]["schedule"][key] = value
    found = verify_rigorously(redigested(data))
    assert (found.verdict, found.inequality) == ("bad file", "form")


def test_coverage_by_closed_intervals():
    F = Fraction
    assert covers([(F(0), F(1)), (F(1), F(2))], F(0), F(2))
    assert covers([(F(-1), F(3))], F(0), F(2))
    assert covers([(F(1), F(1))], F(1), F(1))
    assert not covers([(F(0), F(1)), (F(1) + F(1, 10**20), F(2))], F(0), F(2))
    assert not covers([(F(0), F(1)), (F(1, 2), F(3, 2))], F(0), F(2))
    assert not covers([(F(1, 10**20), F(2))], F(0), F(2))
    assert not covers([], F(0), F(0))
    assert not covers([(F(3), F(4))], F(0), F(2))


def test_an_interval_that_is_exactly_tight_is_undecided(made):
    data = made("oscillator, gap range").to_dict()
    with balls.precision():
        c = certificate(data)
        weights = BallWeights(c.plant, c.weights)
        tight = BallIntervals(weights, weights.P2, [], "P2 <= P2", Budget(60.0))
        with pytest.raises(Refused, match="could not be decided: it is tight or nearly so"):
            tight.prove(weights.P2, None, Fraction(0), Fraction(0))
