"""Certificates for uncertain plants: proven, tight, refused where they are wrong, read back from their file."""

import functools
import json
import time
from collections import Counter
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, Schedule, certify, read_certificate
from sampling_design.certificates.exact import certificate as record
from sampling_design.certificates.exact import proof
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers import check, claims, inclusion, numbers
from sampling_design.checkers import members as checked_members
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.parts import digest
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError, UndecidedError
from sampling_design.numerics import balls
from sampling_design.plants.plant import Signals
from sampling_design.records.budget import Budget
from sampling_design.uncertain.inclusion import inclusion_balls, search
from sampling_design.uncertain.inclusion import members as coordinates
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion, longest_gap
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.uncertain.inclusion.program import InclusionProgram
from sampling_design.uncertain.inclusion.search import InclusionSearch
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests import kept_certificates
from tests.cases import few
from tests.oracles import inclusions

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], name="oscillator")
STIFFNESS = UncertainParameter("omega^2", 0.81, 1.21, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
UNCERTAIN = UncertainPlant(OSCILLATOR, [STIFFNESS])


@pytest.fixture(scope="module")
def certificate():
    return certify(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1)


def resealed(data, **keys):
    data = json.loads(json.dumps({**data, **keys}))
    return {**data, "digest": digest(data)}


def members(certificate):
    found = certificate.model.members(np.random.default_rng(0))
    n = certificate.plant.n_states
    return [(M[:, :n], C, M[:, n:]) for M in found.dynamics for C in found.outputs]


def test_an_uncertain_oscillator_is_certified(certificate):
    assert isinstance(certificate, InclusionCertificate)
    assert certificate.verify().verdict == "proven"
    assert certificate.lam < 4.5
    assert certificate.horizon("arrival").minimum == pytest.approx(np.log(4) / 0.1)
    assert certificate.horizon().minimum == pytest.approx(np.log(4 * certificate.lam_proven) / 0.1)
    assert certificate.horizon("paper").minimum == pytest.approx(2 * np.log(2 * certificate.lam_proven) / 0.1)


@pytest.mark.parametrize("schedule", few([GapRange(0.5, 1.5), PeriodicSchedule([1.0, 0.7])], 0))
def test_a_set_with_one_member_is_the_plant(schedule):
    alone = certify(OSCILLATOR, schedule, eta=0.1)
    for given in ({"vertices": [OSCILLATOR]}, {"parameters": [replace(STIFFNESS, low=1.0, high=1.0)]}):
        found = certify(UncertainPlant(OSCILLATOR, **given), schedule, eta=0.1)
        assert found.to_dict() == alone.to_dict()


def test_no_switching_plant_violates_it(certificate):
    rng = np.random.default_rng(0)
    worst = max(inclusions.adversary(certificate, members(certificate), rng) for _ in range(40))
    assert 0.2 < worst <= 1.0


def test_it_comes_back_from_its_file(certificate, tmp_path):
    path = certificate.save(tmp_path / "certificate.json")
    again = read_certificate(path)
    assert isinstance(again, InclusionCertificate)
    assert again.to_dict() == certificate.to_dict()
    assert isinstance(again.model, UncertainPlant)
    assert again.verify().passed
    with pytest.raises(CertificateError, match="certifies another plant"):
        read_certificate(path, Plant([[0.0]], [[1.0]]))


@pytest.mark.parametrize("longest", few([3.0, 2.86], 0))
def test_a_range_that_holds_a_pathological_gap_is_refused_with_its_plant(longest):
    with pytest.raises(CertificateError, match=r"at omega\^2 = 1.21 the gaps \[2.85599\] have none") as caught:
        certify(UNCERTAIN, GapRange(0.5, longest), eta=0.1)
    assert caught.value.details["counterexample"].verify()
    assert caught.value.details["parameters"] == "omega^2 = 1.21"


def test_what_is_only_too_hard_is_undecided():
    with pytest.raises(UndecidedError, match=r"undecided: no P\(tau\) was proven at rate 0.1"):
        certify_inclusion(UNCERTAIN, GapRange(0.5, 2.8), eta=0.1, pieces=8)


def wrong(data, by):
    """The certificate with one matrix moved until some inequality is violated by about `by`, relatively."""
    P = np.array(data["P"])
    last = int(np.argmax(np.array(data["nodes"]) == data["times"]["longest"]))
    C, Rt = np.array(data["plant"]["matrices"]["C"]), np.array(data["R"]) / 2
    jump = P[last] + C.T @ Rt @ C - P[0]
    values, vectors = np.linalg.eigh(jump)
    size = float(np.abs(P[0]).max())
    P[0] += (values[0] + by * size) * np.outer(vectors[:, 0], vectors[:, 0])
    return resealed(data, P=P.tolist())


@pytest.mark.parametrize("by", [1e-9, 1e-6, 1e-2])
def test_wrong_by_a_billionth_is_refused(by, certificate):
    verdict = check(wrong(certificate.to_dict(), by))
    assert verdict["verdict"] == "refuted"
    assert verdict["amount"] < 0
    found = verify_rigorously(wrong(certificate.to_dict(), by))
    assert found.verdict == "refuted"
    with pytest.raises(AssertionError, match="fails by"):
        raise AssertionError(found.reason)


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"lam": 1.5, "lam_samples": 1.5}, "< lam P1 fails by"),
        ({"margin": 1.0}, r"P1 < P\(tau\) fails by"),
        ({"eta": 0.5}, "fails by"),
        ({"R": [[1e-3]], "Qv": [[1e-3]]}, "C'R~C fails by"),
        ({"P2": [[1e-3, 0.0], [0.0, 1e-3]]}, r"P\(tau\) < P2 fails by"),
        ({"Qw": [[-1.0, 0.0], [0.0, 1.0]]}, "Qw > 0 fails by"),
    ],
)
def test_changed_numbers_are_refused(keys, match, certificate):
    data = resealed(certificate.to_dict(), **keys)
    verdict = check(data)
    assert verdict["verdict"] == "refuted"
    with pytest.raises(AssertionError, match=match):
        raise AssertionError(verdict["reason"])


def test_a_wider_box_is_refused(certificate):
    data = certificate.to_dict()
    wide = [{**data["model"]["parameters"][0], "high": 1.8}]
    assert check(resealed(data, model={**data["model"], "parameters": wide}))["verdict"] == "refuted"


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: {"nodes": d["nodes"][::-1]}, "`nodes` must be 2 to 2000 times that increase from 0"),
        (lambda d: {"nodes": [*d["nodes"][:-1], 2.0]}, "must have ends that are nodes of its source"),
        (lambda d: {"P": d["P"][1:]}, "`P` must hold one matrix per node"),
        (lambda d: {"witness": {"t": 1}}, "`witness` must be null"),
        (lambda d: {"lam_samples": d["lam"] / 2}, "`lam_samples` must be at least `lam`"),
        (lambda d: {"times": {**d["times"], "time_unit": "h"}}, "`times.time_unit` must be the plant's"),
        (lambda d: {"times": {**d["times"], "shortest": 9.0}}, "`times.longest` must be at least"),
        (lambda d: {"model": {"kind": "sphere"}}, "`model.kind` must be one of box, vertices, nonlinear"),
        (lambda d: {"multipliers": [[[1.0]]]}, "`multipliers` must have shape"),
        (
            lambda d: {"model": {**d["model"], "parameters": [{**d["model"]["parameters"][0], "nominal": 9.0}]}},
            "must have low <= nominal <= high",
        ),
        (
            lambda d: {"model": {**d["model"], "parameters": [{**d["model"]["parameters"][0], "A": [[1.0]]}]}},
            r"`model.parameters\[0\].A` must have shape",
        ),
        (lambda d: {"model": {"kind": "vertices", "varying": False, "A": [], "C": [], "G": []}}, "at least one"),
        (
            lambda d: {"multipliers": [[[1.0]]], "model": {"kind": "vertices", "varying": False, **stacks()}},
            "must be null unless the model is a box",
        ),
    ],
)
def test_a_file_is_a_grammar(change, match, certificate, tmp_path):
    data = certificate.to_dict()
    data = resealed(data, **change(data))
    assert check(data)["verdict"] == "bad file"
    path = tmp_path / "c.json"
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=match):
        read_certificate(path)


def test_multipliers_prove_a_box_and_are_needed():
    # by hand: x' = theta x, |theta| <= 1, P(tau) = a - b tau; m p^2 - m z^2 with p = theta x
    uncertain = UncertainPlant(Plant([[0.0]], [[1.0]]), [UncertainParameter("theta", -1.0, 1.0, A=[[1.0]])])
    made = certify_inclusion(uncertain, GapRange(0.1, 0.2), eta=0.5, pieces=4)
    data = made.to_dict()
    values = made.P.ravel().tolist()
    plenty = [[[a], [b]] for a, b in pairwise(values)]  # m = P is the best: -P' > eta P + m + P^2/m
    assert check(resealed(data, multipliers=plenty))["verdict"] == "proven"
    none = [[[0.0] for _ in range(2)] for _ in range(made.nodes.size - 1)]
    assert check(resealed(data, multipliers=none))["verdict"] != "proven"
    assert verify_rigorously(resealed(data, multipliers=plenty)).verdict == "proven"
    assert verify_rigorously(resealed(data, multipliers=none)).verdict != "proven"


def test_vertices_and_uncertain_outputs_and_inputs():
    base = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], G=[[0.0], [1.0]])
    parts = [
        UncertainParameter("c", 0.9, 1.1, C=[[1.0, 0.0]]),
        UncertainParameter("g", 0.5, 1.5, G=[[0.0], [1.0]]),
    ]
    box = certify_inclusion(UncertainPlant(base, parts), GapRange(0.2, 0.8), eta=0.3, pieces=8)
    worst = max(inclusions.adversary(box, members(box), np.random.default_rng(1)) for _ in range(8))
    assert worst <= 1.0
    corners = [UncertainPlant(base, parts).at([c, g]) for c in (0.9, 1.1) for g in (0.5, 1.5)]
    listed = certify_inclusion(UncertainPlant(base, vertices=corners), GapRange(0.2, 0.8), eta=0.3, pieces=8)
    assert listed.lam == pytest.approx(box.lam, rel=0.05)
    assert load_dict(listed).verify().passed


def stacks():
    return {key: [getattr(OSCILLATOR, key).tolist()] for key in "ACG"}


def load_dict(certificate):
    from sampling_design.certificates.files import certificate_from_dict

    return certificate_from_dict(json.loads(json.dumps(certificate.to_dict())))


@pytest.mark.long
def test_the_rate_is_chosen_and_what_is_certified_is_what_was_given():
    given = PeriodicSchedule([0.6, 1.4], 0.6)
    chosen = certify(UNCERTAIN, given)
    fixed = certify_inclusion(UNCERTAIN, given, eta=0.1, pieces=8)
    assert chosen.horizon().minimum < fixed.horizon().minimum
    assert np.array_equal(chosen.covers.gaps, given.gaps)
    assert load_dict(chosen).to_dict() == chosen.to_dict()
    assert fixed.lam < certify_inclusion(UNCERTAIN, GapRange(0.6, 1.4), eta=0.1, pieces=8).lam


def test_equal_gaps_are_one_gap():
    many, one = (certify_inclusion(UNCERTAIN, PeriodicSchedule(g, 0.5), eta=0.1, pieces=8) for g in ([1.0] * 6, [1.0]))
    assert many.lam == one.lam
    assert many.words == 1


def test_a_first_sample_that_comes_late_has_a_start_of_its_own():
    gaps = [0.5, 0.5, 0.5, 0.5]
    early, late = (certify_inclusion(UNCERTAIN, PeriodicSchedule(gaps, f), eta=0.1, pieces=8) for f in (0.5, 1.5))
    assert (early.words, late.words) == (1, 5)
    assert late.lam > early.lam
    assert late.verify(rigorous=True).passed
    data = late.to_dict()
    start = int(np.flatnonzero(np.array(data["nodes"]) == 0)[1])
    cut = {"nodes": data["nodes"][start:], "P": data["P"][start:]}
    found = check(resealed(data, **cut))
    assert found["verdict"] == "bad file"
    with pytest.raises(AssertionError, match="is a first gap that no longer one holds: the start needs its own P"):
        raise AssertionError(found["reason"])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (
            lambda d: {key: d[key] for key in d if key != "graph"},
            "`graph` is missing: only a range of gaps goes without",
        ),
        (
            lambda d: {**d, "graph": {**d["graph"], "words": [[0]]}},
            "`graph.words` must begin with an empty word for the start, and hold another one",
        ),
        (lambda d: {**d, "nodes": [0.0, 0.0, 0.5, 0.0, 0.0, 0.7]}, "must begin at 0 once for each word"),
    ],
)
def test_a_graph_in_a_file_is_a_grammar(change, match):
    data = certify_inclusion(UNCERTAIN, PeriodicSchedule([0.5, 0.7]), eta=0.1, pieces=2).to_dict()
    found = check(resealed(change(data)))
    assert found["verdict"] == "bad file"
    with pytest.raises(AssertionError, match=match):
        raise AssertionError(found["reason"])


def test_a_graph_that_leaves_out_a_gap_is_refuted():
    data = certify_inclusion(UNCERTAIN, PeriodicSchedule([0.5, 0.7]), eta=0.1, pieces=2).to_dict()
    edges = [edge for edge in data["graph"]["edges"] if edge[:2] != [0, 1]]
    found = check(resealed(data, graph={**data["graph"], "edges": edges}))
    assert (found["verdict"], found["inequality"]) == ("refuted", "graph")
    assert verify_rigorously(resealed(data, graph={**data["graph"], "edges": edges})).inequality == "graph"


# --- what a sample shows at least, over all C -------------------------------------------------------------------------


def gained(low, high, share):
    """A scalar plant with a gain in [low, high] and P(tau) whose jump takes this share of what the least gain shows."""
    plant = UncertainPlant(Plant([[-1.0]], [[1.0]]), [UncertainParameter("c", low, high, C=[[1.0]], nominal=1.0)])
    made = certify_inclusion(plant, GapRange(0.5, 0.5), eta=0.1, pieces=1)
    data = made.to_dict()
    least = 0.0 if low < 0 < high else min(low**2, high**2)
    P0 = 1.0
    P = [[[P0]], [[P0 - share * least]]]
    return resealed(data, P=P, P1=[[0.01]], P2=[[1.1]], lam=111.0, lam_samples=111.0, R=[[2.0]], Qv=[[2.0]],
                    Qw=[[100.0]])  # fmt: skip


@pytest.mark.parametrize("rigorous", [False, True])
@pytest.mark.parametrize(("low", "high"), [(0.3, 1.7), (0.9, 1.1), (0.5, 4.0)])
def test_what_the_least_gain_shows_is_proven_and_more_is_refuted_with_it(low, high, rigorous):
    judge = (lambda d: verify_rigorously(d).verdict) if rigorous else (lambda d: check(d)["verdict"])
    assert judge(gained(low, high, 0.999)) == "proven"
    assert judge(gained(low, high, 1.001)) == "refuted"
    assert check(gained(low, high, 1.001))["reason"].endswith(f"where c = {low:g}")


@functools.cache
def turned():
    """Two gains that turn against each other: no tangent serves all of (cos t, sin t) between two vertices."""
    plants = [Plant(-np.eye(2), C) for C in ([[1.0, 0.0]], [[0.0, 1.0]])]
    model = UncertainPlant(Plant(-np.eye(2), [[0.5, 0.5]]), vertices=plants)
    return certify_inclusion(model, GapRange(0.5, 0.5), eta=0.1, pieces=1).to_dict()


def counted(monkeypatch, kind, name):
    """What a method is called with from now on."""
    calls, own = [], getattr(kind, name)
    monkeypatch.setattr(kind, name, lambda *given: calls.append(given) or own(*given))
    return calls


def test_sets_of_outputs_are_halved_until_nothing_is_lost(monkeypatch):
    halved, looks = (
        counted(monkeypatch, kind, name)
        for kind, name in ((checked_members.Members, "halves"), (checked_members.Jump, "bounds"))
    )
    assert check(turned())["verdict"] == "proven"
    assert 100 < len(looks) < len(halved) / 2  # many sets at once
    wide = UncertainPlant(OSCILLATOR, [UncertainParameter("c", 0.3, 1.7, C=[[1.0, 0.0]], nominal=1.0), STIFFNESS])
    assert certify_inclusion(wide, GapRange(0.5, 0.7), eta=0.1, pieces=4).verify(rigorous=True).passed


def test_what_is_proven_by_the_end_of_the_budget_is_returned_and_less_is_undecided(monkeypatch):
    with pytest.raises(UndecidedError, match=r"was proven within `budget` = 1e-06 s\. Give it more time") as seen:
        certify(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1, budget=1e-6)
    assert seen.value.details["status"] == "budget"
    assert certify(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1, budget=60.0).lam < 4.5
    kept, calls = InclusionSearch.proven, []

    def interrupted(self, *given):
        calls.append(given)
        if len(calls) > 1:
            raise KeyboardInterrupt
        return kept(self, *given)

    monkeypatch.setattr(InclusionSearch, "proven", interrupted)
    assert certify(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1).verify().passed
    with pytest.raises(KeyboardInterrupt):
        certify(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1)


@pytest.mark.parametrize("solves", few([5, 8], 0))
def test_the_choice_of_a_rate_leaves_time_for_a_proof(solves, monkeypatch):
    """All of a budget went to it, and nothing was proven of what had been found."""
    kept, clock = InclusionSearch.solve, []
    monkeypatch.setattr(time, "perf_counter", lambda: 100.0 * len(clock))
    monkeypatch.setattr(InclusionSearch, "solve", lambda *given, **how: clock.append(0) or kept(*given, **how))
    schedule = PeriodicSchedule([1.0, 0.5], 1.5)
    assert certify(UNCERTAIN, schedule, timing_tolerance=0.05, budget=100.0 * solves + 50.0).verify().passed


def test_multipliers_that_prove_nothing_refute_nothing():
    uncertain = UncertainPlant(Plant([[0.0]], [[1.0]]), [UncertainParameter("theta", -1.0, 1.0, A=[[1.0]])])
    made = certify_inclusion(uncertain, GapRange(0.1, 0.2), eta=0.5, pieces=4)
    none = [[[0.0] for _ in range(2)] for _ in range(made.nodes.size - 1)]
    found = check(resealed(made.to_dict(), multipliers=none))
    assert found["verdict"] == "undecided"
    with pytest.raises(AssertionError, match="could not be decided: these multipliers do not prove it"):
        raise AssertionError(found["reason"])
    broken = check(resealed(made.to_dict(), multipliers=none, eta=5.0))
    assert broken["verdict"] == "refuted"
    assert broken["reason"].endswith("where theta = 1")


@pytest.mark.long
def test_the_largest_rate_serves_the_arrival_weight():
    made = certify_inclusion(UNCERTAIN, GapRange(0.6, 1.4), arrival=True, pieces=8)
    other = certify_inclusion(UNCERTAIN, GapRange(0.6, 1.4), pieces=8)
    assert made.horizon("arrival").minimum <= other.horizon("arrival").minimum


def test_lambda_is_the_least_that_linear_pieces_can_have():
    # P' <= -P on 8 pieces of 1/8: P falls by (1 - 1/8) on each, and nothing else stands in the way
    slow = UncertainPlant(Plant([[0.0]], [[1.0]]), [UncertainParameter("a", -1.0, 0.0, A=[[1.0]], nominal=0.0)])
    made = certify_inclusion(slow, GapRange(0.5, 1.0), eta=1.0, pieces=8, noise_gain=1e6)
    assert (7 / 8) ** -8 <= made.lam <= 1.005 * (7 / 8) ** -8


def lambda_of_the_chain(noise_gain):
    A, decay = np.diag(np.ones(3), 1), np.diag([0.0, 0.0, 0.0, -1.0])
    known = Plant(A + 0.5 * decay, [[1.0, 0.0, 0.0, 0.0]], G=[[0.0], [0.0], [0.0], [1.0]])
    chain = UncertainPlant(known, [UncertainParameter("rate", 1 / 12, 3.0, A=decay, nominal=0.5)])
    return certify_inclusion(chain, GapRange(0.005, 0.25), eta=0.3, pieces=8, noise_gain=noise_gain).lam


@pytest.mark.parametrize(("budget", "most"), few([(3.0, 2.65), (1e12, 2.0)], 0))
def test_coordinates_and_matrices_are_chosen_at_once(budget, most):
    assert lambda_of_the_chain(budget) < most


@pytest.mark.long
@pytest.mark.parametrize("seed", few(range(2), 1))
def test_the_last_digit_of_the_coordinates_decides_nothing(seed, monkeypatch):
    """The solver failed at one step or the next, and lambda was 1.946 or 2.014."""
    solution, rng = coordinates.periodic_riccati_solution, np.random.default_rng(seed)

    def moved(*given, **named):
        Y = solution(*given, **named)
        return Y * (1 + 1e-14 * rng.normal(size=Y.shape))

    monkeypatch.setattr(coordinates, "periodic_riccati_solution", moved)
    assert lambda_of_the_chain(1e12) < 1.95


@pytest.mark.long
def test_more_pieces_prove_longer_gaps():
    found = [longest_gap(UNCERTAIN, eta=0.02, most=2.9, pieces=count).family.longest for count in (4, 8)]
    assert found[0] < found[1]
    assert found[1] > 2.05


@pytest.mark.parametrize(("state", "per_second"), few(product([1e-9, 1.0, 1e9], [1.0, 3600.0]), 1))
def test_units_change_nothing(state, per_second, certificate):
    unit = np.array([state, 1.0])
    turned = UncertainPlant(
        Plant(
            OSCILLATOR.A * unit / unit[:, None] * per_second,
            OSCILLATOR.C * unit,
            G=np.diag(1 / unit) * np.sqrt(per_second),
            states=Signals(("a", "b"), scales=1 / unit),
        ),
        [UncertainParameter("k", 0.81, 1.21, A=STIFFNESS.A * unit / unit[:, None] * per_second, nominal=1.0)],
    )
    made = certify(turned, GapRange(0.5 / per_second, 1.5 / per_second), eta=0.1 * per_second)
    assert made.lam == pytest.approx(certificate.lam, rel=0.05)
    assert made.nodes.size == certificate.nodes.size


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: certify(UNCERTAIN, Schedule([1.0, 2.0])), "`schedule` must be a GapRange, another family"),
        (lambda: certify(UNCERTAIN, GapRange(1, 2), P2=np.eye(2)), "`P2` must be left out for a plant"),
        (lambda: certify(UNCERTAIN, GapRange(1, 2), memory=1), "`memory` must be left out for a plant"),
        (
            lambda: certify(UNCERTAIN, PeriodicSchedule([1.0], outputs=[[True]], time_unit="h")),
            "`schedule` is in h and the plant in s",
        ),
        (lambda: certify(UNCERTAIN, GapRange(1, 2), noise_gain=1.0), "`noise_gain` must be above 1"),
        (lambda: certify_inclusion(UNCERTAIN, 3.0), "`schedule` must be"),
        (lambda: longest_gap(UNCERTAIN, eta=0.1, shortest=2.0, most=1.0), "`most` must be at least `shortest`"),
        (lambda: certify(UNCERTAIN, GapRange(0.5, 1.0), eta=0.1).at(2.0), "`tau` must lie in"),
        (
            lambda: certify(UNCERTAIN, GapRange(0.5, 1.0), eta=0.1).horizon("best"),
            "`theorem` must be one of improved, arrival, paper",
        ),
    ],
)
def test_wrong_arguments_are_refused(call, match):
    with pytest.raises(ArgumentError, match=match):
        call()


def test_no_gap_at_all_is_undecided():
    blind = UncertainPlant(
        Plant(np.diag([1.0, 1.0]), [[1.0, 1.0]]), [UncertainParameter("k", 0, 1, A=[[1, 0], [0, 0]])]
    )
    with pytest.raises(UndecidedError, match="undecided: no gap of at least"):
        longest_gap(blind, eta=0.1, most=1.0, pieces=2)
    with pytest.raises(UndecidedError, match=r"at rate 0\.02 within `budget` = 1e-06 s"):
        longest_gap(UNCERTAIN, eta=0.02, most=2.9, budget=1e-6)


def test_the_record_and_its_picture(certificate):
    assert "parameters in a box" in str(certificate)
    assert "decays at rate 0.1" in certificate.explain()
    assert "share the parameters" in str(certificate.claim)
    assert certificate.error_bound(1000.0, [1.0, 0.0]) < 1e-3
    np.testing.assert_allclose(certificate.at(certificate.nodes), certificate.P)
    ax = certificate.plot()
    assert "proven for gaps up to 1.5" in ax.get_title("left")
    with pytest.raises(CertificateError, match="Theorem G needs M >"):
        certificate.horizon(length=1.0)


def test_records_by_hand_are_checked(certificate):
    from dataclasses import replace

    with pytest.raises(ArgumentError, match="`family` must be a GapRange, another family or a PeriodicSchedule, got"):
        replace(certificate, family=3)
    with pytest.raises(ArgumentError, match="`nodes` must increase from 0, for each word of the graph"):
        replace(certificate, nodes=certificate.nodes[::-1])
    with pytest.raises(ArgumentError, match="`word` must be one of the 1 words of the graph, got 1"):
        certificate.at(0.0, 1)
    with pytest.raises(ArgumentError, match="`P` must hold one matrix per node, shape"):
        replace(certificate, P=certificate.P[1:])


def test_a_plant_without_states_is_refused():
    nothing = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    model = UncertainPlant(nothing, vertices=[nothing])
    with pytest.raises(ArgumentError, match="`plant` must have states"):
        certify(model, GapRange(1, 2))


@pytest.mark.parametrize("listed", [0, 8])
def test_a_plant_without_disturbances_is_certified(listed, tmp_path, monkeypatch):
    """Its weight of disturbances is a matrix without rows, which is positive as every such matrix is."""
    monkeypatch.setattr("sampling_design.uncertain.plants.uncertain_plant.MOST_LISTED", listed)
    model = UncertainPlant(Plant(OSCILLATOR.A, OSCILLATOR.C, G=np.zeros((2, 0))), [STIFFNESS])
    made = certify_inclusion(model, GapRange(0.5, 1.0), eta=0.1, pieces=2)
    assert (made.multipliers is None) == (listed > 0)
    assert made.horizon().C_w == 0
    made.save(tmp_path / "certificate.json")
    assert read_certificate(tmp_path / "certificate.json").verify().verdict == "proven"
    assert verify_rigorously(made.to_dict()).verdict == "proven"


def test_a_sample_of_part_of_the_outputs_is_one_of_that_part():
    two = UncertainPlant(Plant(OSCILLATOR.A, np.eye(2)), [STIFFNESS])
    some = PeriodicSchedule([0.6, 0.6], outputs=[[1, 0], [0, 1]])
    part, whole = (certify_inclusion(two, s, eta=0.1, pieces=4) for s in (some, PeriodicSchedule([0.6])))
    first = certify_inclusion(UNCERTAIN, PeriodicSchedule([1.2]), eta=0.1, pieces=8)
    assert whole.lam < part.lam < first.lam


# --- many parameters --------------------------------------------------------------------------------------------------


def many_parameters():
    A = np.array([[0.0, 1.0, 0.0], [-1.0, -0.2, 0.3], [0.0, 0.1, -0.5]])
    G = np.array([[0.0], [1.0], [0.2]])
    off = 0.03 * np.abs(A) + 0.005
    return UncertainPlant.from_intervals((A - off, A + off), [[1.0, 0.0, 0.0]], (0.95 * G, 1.05 * G))


def test_a_box_of_many_parameters_is_certified_with_multipliers():
    plant = many_parameters()
    assert len(plant.parameters) == 11
    made = certify_inclusion(plant, GapRange(0.2, 0.8), eta=0.15, pieces=4)
    assert made.multipliers is not None
    assert made.verify().passed
    data = made.to_dict()
    assert check(resealed(data, multipliers=None))["verdict"] != "proven"
    rng = np.random.default_rng(0)
    drawn = [plant.draw(rng) for _ in range(20)]
    listed = [(one.A, one.C, one.G) for one in drawn]
    assert inclusions.adversary(made, listed, rng) <= 1.0
    few = np.asarray(made.multipliers).tolist()
    few[0][0][0] = few[0][0][0] * 1e-9 if few[0][0][0] > 1e-6 else 1e9
    assert check(resealed(data, multipliers=few))["verdict"] != "proven"


def test_multipliers_cost_nothing_where_one_parameter_is_unknown(monkeypatch, certificate):
    corners = certify_inclusion(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1, pieces=8)
    monkeypatch.setattr("sampling_design.uncertain.plants.uncertain_plant.MOST_LISTED", 0)
    for scale, per in ((1e6, 1e3),):
        D = np.array([scale, 1.0])
        plant = Plant(OSCILLATOR.A * D[:, None] / D / per, OSCILLATOR.C / D, G=np.diag(D) / per,
                      states=Signals(["a", "b"], (), D))  # fmt: skip
        part = UncertainParameter("k", 0.81, 1.21, A=np.array(STIFFNESS.A) * D[:, None] / D / per, nominal=1.0)
        made = certify_inclusion(UncertainPlant(plant, [part]), GapRange(0.5 * per, 1.5 * per), eta=0.1 / per,
                                 Qw=np.eye(2) / per, pieces=8)  # fmt: skip
        assert made.multipliers is not None
        assert made.lam == pytest.approx(corners.lam, rel=1e-2)


def test_matrices_of_a_file_are_not_made_symmetric_in_silence(certificate):
    P = np.array(certificate.P)
    P[0, 1, 0] += 0.1
    with pytest.raises(ArgumentError, match="must be symmetric"):
        replace(certificate, P=P)


@pytest.mark.long
def test_linear_coordinates_change_nothing_that_is_proven():
    rng = np.random.default_rng(4)
    T = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    inverse = np.linalg.inv(T)
    plant = Plant(inverse @ OSCILLATOR.A @ T, OSCILLATOR.C @ T, G=inverse)
    part = UncertainParameter("omega^2", 0.81, 1.21, A=inverse @ np.array(STIFFNESS.A) @ T, nominal=1.0)
    turned = certify_inclusion(UncertainPlant(plant, [part]), GapRange(0.2, 2.0), eta=0.02, pieces=8)
    assert turned.verify().passed
    with pytest.raises(UndecidedError):
        certify_inclusion(UncertainPlant(plant, [part]), GapRange(0.2, 2.4), eta=0.02, pieces=8)
    with pytest.raises(UndecidedError):
        certify_inclusion(UNCERTAIN, GapRange(0.2, 2.4), eta=0.02, pieces=8)


def test_coordinates_in_which_no_short_decimals_are_definite_are_proven_in_balls(monkeypatch):
    """Two states that are nearly the same number: seven decimals of P are indefinite, doubles leave it undecided.

    However often it is tried, numbers are judged as they are, and one file is sealed and read.
    """
    monkeypatch.setattr(kept_certificates, "keep", lambda made: None)
    counts = Counter()

    def counted(module, name):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, **named: [counts.update([name]), function(*given, **named)][1])

    for module, name in ((record, "with_digest"), (proof, "certificate"), (search, "judged_while_sought")):
        counted(module, name)
    T = np.array([[1.0, 0.0], [1.0, 1e-3]])
    inverse = np.linalg.inv(T)
    plant = Plant(T @ OSCILLATOR.A @ inverse, OSCILLATOR.C @ inverse, G=T[:, 1:])
    part = UncertainParameter("omega^2", 0.9, 1.1, A=T @ np.array(STIFFNESS.A) @ inverse, nominal=1.0)
    turned = certify_inclusion(UncertainPlant(plant, [part]), GapRange(0.5, 1.0), eta=0.1, pieces=8)
    assert turned.solver.details["digits"] == 15
    assert counts.pop("judged_while_sought") > 1
    assert counts == {"with_digest": 1, "certificate": 1}
    assert turned.verify().verdict == "proven"


def test_what_an_inaccurate_solver_leaves_is_no_solution(monkeypatch):
    """An indefinite P has a negative ratio of its ends, which is less than any: it must not count as the narrowest."""
    narrow = InclusionProgram.narrow

    def spoilt(self, ratio, floor):
        x, W, record = narrow(self, ratio, floor)
        return None if x is None else -x, W, record

    monkeypatch.setattr(InclusionProgram, "narrow", spoilt)
    found = certify_inclusion(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1, pieces=8)
    assert found.verify().verdict == "proven"
    monkeypatch.setattr(InclusionProgram, "matrices", lambda self, x: -np.ones((self.count, 2, 2)))
    with pytest.raises(UndecidedError, match="no P\\(tau\\) was proven"):
        certify_inclusion(UNCERTAIN, GapRange(0.5, 1.5), eta=0.1, pieces=8)


def test_growth_beyond_all_numbers_within_a_gap_is_undecided_and_not_a_warning():
    plant = Plant([[800.0, 1.0], [0.0, -1.0]], [[1.0, 1.0]])
    part = UncertainParameter("k", -0.1, 0.1, A=[[0.0, 0.0], [0.0, 1.0]], nominal=0.0)
    with pytest.raises(UndecidedError, match="no P\\(tau\\) was proven"):
        certify_inclusion(UncertainPlant(plant, [part]), GapRange(0.5, 1.0), eta=0.1, pieces=8)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"name": ""}, r"`model\.parameters\[0\]\.name` must not be blank"),
        ({"A": [[0.0, 0.0], [0.0, 0.0]]}, "must have a name, and move"),
        (None, "must hold at least one parameter, each with a name of its own"),
    ],
)
def test_a_checker_reads_no_box_that_a_record_would_not_hold(change, match, certificate, tmp_path):
    data = json.loads(json.dumps(certificate.to_dict()))
    listed = data["model"]["parameters"]
    data["model"]["parameters"] = [*listed, *listed] if change is None else [{**listed[0], **change}]
    data["digest"] = digest(data)
    assert check(data)["verdict"] == "bad file"
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=match):
        read_certificate(path)


def test_sets_of_outputs_that_no_halving_decides_are_undecided(monkeypatch):
    """One C of two that turn against each other: no tangent serves both, the sets between them are to be halved."""
    made = turned()
    weights = {"Qw": [[100.0, 0.0], [0.0, 100.0]], "R": [[2.0]], "Qv": [[2.0]], "lam": 210.0, "lam_samples": 210.0}
    P = [[[1.0, 0.0], [0.0, 1.0]], [[1.1, -0.2], [-0.2, 1.1]]]
    whole = resealed(made, P=P, P1=[[0.01, 0.0], [0.0, 0.01]], P2=[[2.0, 0.0], [0.0, 2.0]], **weights)
    assert check(whole)["verdict"] == verify_rigorously(whole).verdict == "proven"
    tight = claims.certificate(whole)
    monkeypatch.setattr(checked_members, "MOST_SETS", 0)
    with pytest.raises(Undecided, match="could not be decided: it is tight or nearly so"):
        inclusion.prove(tight)
    monkeypatch.setattr(inclusion_balls, "MOST_SETS", 0)
    with balls.precision():
        with pytest.raises(Refused, match="could not be decided: it is tight or nearly so"):
            inclusion_balls.inclusion(tight, Budget(60.0))
        with pytest.raises(Refused, match="x > 0 could not be decided: it is tight or nearly so"):
            inclusion_balls.decided("x > 0", balls.matrix([[1.0, 1.0], [1.0, 1.0]]), [balls.ball(1.0)] * 2)


def test_numbers_whose_products_leave_all_doubles_are_undecided():
    with pytest.raises(Undecided, match="too large or too small for an honest check in doubles"):
        numbers.safe(np.array([[1e100]]), power=4)


OSCILLATING = np.array([[0.0, 1.0], [-1.0, -0.1]])


def between(order):
    """Plants between the same three vertices, listed in some order, one of them more than once perhaps."""
    rng = np.random.default_rng(3)
    vertices = [Plant(OSCILLATING + 0.06 * rng.normal(size=(2, 2)), [[1.0, 0.0]]) for _ in range(3)]
    return UncertainPlant(Plant(OSCILLATING, [[1.0, 0.0]]), vertices=[vertices[k] for k in order])


@pytest.mark.parametrize("order", [[2, 1, 0], [1, 0, 2, 2]])
def test_how_vertices_are_listed_changes_nothing_of_what_is_searched_with(order):
    one, other = (between(each).members(np.random.default_rng(0)) for each in ([0, 1, 2], order))
    assert np.array_equal(one.dynamics, other.dynamics)
    assert len(one.places) == len(other.places) == 3
    for place, own in zip(other.places, other.dynamics, strict=True):
        assert np.array_equal(own[:, :2], between(order).vertices[int(place.split()[1])].A)


@pytest.mark.long
def test_how_vertices_are_listed_changes_no_bit_of_a_certificate():
    made = [certify(between(order), PeriodicSchedule([0.5])) for order in ([0, 1, 2], [1, 0, 2, 2])]
    assert made[0].lam == made[1].lam
    assert np.array_equal(made[0].P2, made[1].P2)
