"""Certificates in ball arithmetic: all are proven, mutations refused, no tight case is wrongly accepted."""

import copy
import dataclasses
import json
import sys

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from sampling_design import Certificate, PeriodicSchedule, Plant, Schedule, certify, named_plant
from sampling_design.certificates.paper.proof_constants import certify_from_proof
from sampling_design.certificates.rigorous import ball_proof
from sampling_design.certificates.rigorous.ball_problem import BallTimes, BallWeights, ScheduleFrame, noise
from sampling_design.certificates.rigorous.ball_proof import long_run, settled
from sampling_design.certificates.rigorous.decide import (
    assumption_7,
    attained,
    decided_on_schedule,
    replays_in_balls,
    targets,
    verify_rigorously,
)
from sampling_design.certificates.rigorous.refutation import RefutationSearch, fails_at, refute
from sampling_design.checkers import numbers
from sampling_design.checkers.claims import certificate as content
from sampling_design.checkers.outcome import Refused, Undecided, WorkLimit
from sampling_design.errors import CertificateError, MissingExtraError
from sampling_design.numerics import balls
from sampling_design.numerics.filtering import propagate
from sampling_design.records.budget import ENDLESS, Budget, BudgetSpentError
from tests.cases import few
from tests.checkers.test_sampled import redigested, scaled, verdict_by_scan
from tests.oracles import riccati as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
TILTED = Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4], [1.0, 0.2]], G=[[1.0], [0.4]])
FOUR = Plant(
    [[-1.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 0.0]], [[1.0, 1.0, 1.0, 0.0]]
)
STIFF = Plant([[-1000.0, 3.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], [[1.0, 1.0, 0.0]])
ORBIT = PeriodicSchedule(
    np.array([310.0, 540.0, 420.0, 505.0, 390.0, 610.0, 450.0, 470.0, 380.0, 560.0, 430.0, 489.0]),
    outputs=[[1, 1, 1], [1, 0, 0], [0, 1, 0]] * 4,
)


def satellite():
    plant = named_plant("satellite")
    outputs = np.array(ORBIT.outputs)[:, : plant.n_outputs]
    outputs[~outputs.any(axis=1)] = True
    return plant, PeriodicSchedule(ORBIT.gaps, outputs=outputs)


CASES = {
    "double integrator": lambda: certify(DOUBLE, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2)),
    "oscillator": lambda: certify(OSCILLATOR, PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=np.diag([0.5, 0.2])),
    "four states": lambda: certify(FOUR, PeriodicSchedule([1.0]), eta=0.4, P2=0.1 * np.eye(4)),
    "worst start inside a gap": lambda: certify(
        Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4]]),
        PeriodicSchedule([1.2]),
        eta=0.3,
        P2=[[0.3, -0.3], [-0.3, 2.1]],
        R=[[2.0]],
        Qv=[[2.0]],
    ),
    "partial outputs": lambda: certify(
        TILTED, PeriodicSchedule([1.2, 0.7], 0.3, [[1, 0], [1, 1]]), eta=0.3, P2=[[0.3, -0.3], [-0.3, 2.1]]
    ),
    "finite": lambda: certify(TILTED, Schedule([0.4, 1.5, 2.1]), eta=0.3, P2=np.eye(2)),
    "finite from zero": lambda: certify(OSCILLATOR, Schedule([0.0, 0.5, 1.3, 2.9]), eta=0.4, P2=np.eye(2)),
    "first sample late": lambda: certify(OSCILLATOR, PeriodicSchedule([0.6, 1.1], 1.7), eta=0.4, P2=np.eye(2)),
    "stiff": lambda: certify(STIFF, PeriodicSchedule([1.0]), eta=0.1, P2=np.eye(3)),
    "large prior": lambda: certify(DOUBLE, PeriodicSchedule([1.0]), eta=0.4, P2=1e4 * np.eye(2)),
    "satellite": lambda: certify(*satellite(), eta=2e-4, P2=np.diag([1e-6] * 3 + [1.0] * 3)),
}


@pytest.fixture(scope="module")
def made():
    kept = {}

    def get(name):
        if name not in kept:
            kept[name] = CASES[name]()
        return kept[name]

    return get


def framed(c, target, name):
    return ScheduleFrame(BallWeights(c.plant, c.weights), BallTimes(c.schedule), target, name)


def with_ratio(certificate, factor):
    """P1 such that the worst inequality is (1 + factor) of tight, as far as the witness knows."""
    return dataclasses.replace(
        certificate, P1=certificate.P2 / certificate.witness.ratio / (1 + certificate.margin) * factor
    )


@pytest.mark.parametrize("name", few(CASES, *range(10)))
def test_every_certificate_is_proven(name, made):
    verdict = made(name).verify(rigorous=True)
    assert verdict.verdict == "proven"
    assert verdict.passed
    assert 0 < verdict.amount < 1
    assert "Proven in ball arithmetic" in verdict.explain()
    assert ("verdict", "proven") in verdict._rows()


@pytest.mark.parametrize("name", few(CASES, 0, 4, 8))
def test_wrong_by_1e_9_is_refuted_at_a_point_where_it_fails(name, made):
    wrong = with_ratio(made(name), 1 + 1e-9)
    verdict = wrong.verify(rigorous=True)
    assert verdict.verdict == "refuted", verdict.reason
    assert -1e-6 < verdict.amount < -0.9e-9
    if name != "stiff":  # the oracle's block exponential overflows
        Pi = oracle.information_at(wrong.to_dict(), verdict.start, verdict.time)
        least = scipy.linalg.eigh(Pi, wrong.P1, eigvals_only=True)[0]
        assert least == pytest.approx((1 + wrong.margin) * (1 + verdict.amount), rel=1e-6)


@pytest.mark.parametrize("name", few(["double integrator", "oscillator", "four states", "finite", "stiff"], 0, 2, 3, 4))
def test_right_by_1e_6_is_proven(name, made):
    assert with_ratio(made(name), 1 - 1e-6).verify(rigorous=True).verdict == "proven"


@pytest.mark.parametrize("name", ["double integrator", "partial outputs", "finite"])
def test_a_wrong_lambda_is_refuted(name, made):
    lam = made(name).witness.ratio * (1 - 1e-3)
    low = dataclasses.replace(
        made(name), P1=made(name).P1 / 2, lam=lam * (1 - 1e-9), lam_samples=lam * (1 - 1e-9), witness=None
    )
    verdict = low.verify(rigorous=True)
    assert verdict.verdict == "refuted"
    assert verdict.inequality == "(1 - 1e-3) P2 <= lam Pi(t)"


def test_a_wrong_lambda_of_sample_starts_is_refuted_and_the_right_one_proven(made):
    case = made("worst start inside a gap")
    assert case.lam_samples < 0.95 * case.lam
    assert case.verify(rigorous=True).passed
    exact = oracle.worst_ratio(case.to_dict(), case.P2, samples=True, fine=40)[0]
    low = dataclasses.replace(case, lam_samples=exact * (1 - 1.2e-3))
    verdict = low.verify(rigorous=True)
    assert verdict.verdict == "refuted"
    assert "sample starts" in verdict.inequality
    assert dataclasses.replace(case, lam_samples=exact * (1 - 0.8e-3)).verify(rigorous=True).passed


def test_a_witness_that_does_not_reach_its_ratio_is_refuted(made):
    case = made("oscillator")
    wrong = dataclasses.replace(case, witness=dataclasses.replace(case.witness, ratio=case.witness.ratio * (1 + 2e-6)))
    verdict = wrong.verify(rigorous=True)
    assert (verdict.verdict, verdict.inequality) == ("refuted", "witness")
    late = dataclasses.replace(case, witness=dataclasses.replace(case.witness, start=-1.0))
    assert late.verify(rigorous=True).inequality == "form"


@pytest.mark.long
def test_mutations_agree_with_the_riccati_oracle():
    rng = np.random.default_rng(5)
    originals = [
        json.loads(json.dumps(CASES[name]().to_dict())) for name in ("oscillator", "partial outputs", "finite")
    ]
    decided = {True: 0, False: 0}
    while sum(decided.values()) < 40:
        data = copy.deepcopy(originals[rng.integers(len(originals))])
        field = scaled(data, rng)
        expected = verdict_by_scan(data)
        if expected is None:
            continue
        found = verify_rigorously(redigested(data))
        assert found.verdict == ("proven" if expected else "refuted"), (field, found.reason, expected)
        decided[expected] += 1
    assert min(decided.values()) >= 8


@pytest.mark.long
@settings(max_examples=12)
@given(seed=st.integers(0, 10_000), factor=st.sampled_from([1 + 1e-9, 1 + 1e-7, 1 + 1e-4]))
def test_a_violated_inequality_is_never_accepted(seed, factor):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    plant = Plant(rng.standard_normal((n, n)), rng.standard_normal((1, n)))
    try:
        right = certify(
            plant, PeriodicSchedule(rng.uniform(0.3, 0.9, 2)), eta=0.2, P2=np.diag(rng.uniform(0.1, 2.0, n))
        )
    except CertificateError:
        return
    assert right.verify(rigorous=True).verdict == "proven"
    assert not with_ratio(right, factor).verify(rigorous=True).passed


def test_hand_made_certificate_of_a_scalar_plant_is_tight():
    """x' = 0, y = x every second: Y rises to e^(eta) (Y+ + ...) just before a sample; P1 at the fixed point exactly."""
    plant, schedule = Plant([[0.0]], [[1.0]]), PeriodicSchedule([1.0])
    parts = {"P2": [[1.0]], "Qw": [[1.0]], "R": [[2.0]], "Qv": [[2.0]], "eta": 0.1}
    top = oracle.worst_ratio(Certificate.from_matrices(plant, schedule, P1=[[0.2]], **parts).to_dict(), [[1.0]])[0]
    for factor, verdict in ((1 - 1e-9, "proven"), (1 + 1e-9, "refuted")):
        made = Certificate.from_matrices(plant, schedule, P1=[[factor / top]], lam=2 * top, **parts)
        assert made.verify(rigorous=True).verdict == verdict


def test_an_aliased_schedule_is_never_proven():
    schedule = PeriodicSchedule([np.pi])
    made = Certificate.from_matrices(
        OSCILLATOR, schedule, P1=1e-9 * np.eye(2), P2=np.eye(2), Qw=np.eye(2), R=[[2.0]], Qv=[[2.0]], eta=0.4
    )
    verdict = made.verify(rigorous=True)
    assert verdict.verdict == "refuted"
    assert verdict.time > 20


def test_no_states_are_proven():
    plant = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    assert certify(plant, PeriodicSchedule([1.0])).verify(rigorous=True).passed


def test_a_spent_budget_is_undecided(made):
    verdict = made("four states").verify(rigorous=True, budget=0.0)
    assert (verdict.verdict, verdict.inequality, verdict.passed) == ("undecided", "budget", False)


def test_without_the_extra_nothing_is_claimed(monkeypatch, made):
    case = made("oscillator")
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(MissingExtraError, match=r"Install the extra: pip install 'sampling-design\[rigorous\]'"):
        case.verify(rigorous=True)


def change(path, value):
    def apply(data):
        *head, last = path
        for key in head:
            data = data[key]
        data[last] = value

    return apply


@pytest.mark.parametrize(
    ("apply", "inequality", "verdict"),
    [
        (change(["P1"], [[1.0, 2.0], [2.0, 1.0]]), "P1 > 0", "refuted"),
        (change(["P2"], [[1.0, 1.0], [1.0, 1.0]]), "P2 > 0", "undecided"),
        (change(["Qw"], [[-1.0, 0.0], [0.0, 1.0]]), "Qw > 0", "refuted"),
        (change(["R"], [[-1.0]]), "R > 0", "refuted"),
        (change(["eta"], 0.0), "form", "bad file"),
        (change(["lam"], -1.0), "form", "bad file"),
        (change(["margin"], -0.1), "form", "bad file"),
        (change(["P1"], [[1.0]]), "form", "bad file"),
        (change(["eta"], "fast"), "form", "bad file"),
        (change(["times", "gaps"], [1.0, -0.5]), "form", "bad file"),
        (change(["claim"], "wishful"), "form", "bad file"),
    ],
)
def test_malformed_data_are_refused_with_the_right_word(apply, inequality, verdict, made):
    data = json.loads(json.dumps(made("oscillator").to_dict()))
    apply(data)
    found = verify_rigorously(redigested(data))
    assert (found.inequality, found.verdict, found.passed) == (inequality, verdict, False)


def test_an_altered_file_is_refused_by_its_digest(made):
    data = made("oscillator").to_dict()
    data["eta"] = 0.39
    assert verify_rigorously(data).inequality == "digest"
    del data["digest"]
    assert verify_rigorously(data).inequality == "form"


def test_the_verdict_is_that_of_the_file(made, tmp_path):
    from sampling_design import read_certificate

    path = made("partial outputs").save(tmp_path / "certificate.json")
    assert read_certificate(path).verify(rigorous=True).verdict == "proven"
    assert verify_rigorously(json.loads(path.read_text())).verdict == "proven"


def test_noise_is_eliminated_exactly():
    rng = np.random.default_rng(4)
    G, root = rng.standard_normal((3, 4)), rng.standard_normal((4, 4))
    Qw = root @ root.T
    with balls.precision():
        assert np.allclose(balls.floats(noise(G, Qw)), G @ np.linalg.solve(Qw, G.T), rtol=1e-9)
        assert noise(np.zeros((0, 0)), np.zeros((0, 0))).nrows() == 0


@pytest.mark.parametrize("exact", [lambda G, Qw: numbers.inner(G, Qw, np.ones(len(G))), noise])
def test_rows_that_are_eliminated_in_rational_numbers_are_counted(exact, monkeypatch):
    """Their digits grow with each: a hundred coupled disturbances would take half a minute."""
    monkeypatch.setattr(numbers, "MOST_ROWS", 5)
    with balls.precision():
        exact(np.eye(6), np.kron(np.eye(3), [[2.0, 1.0], [1.0, 2.0]]))  # in pairs: three rows
        with pytest.raises(Undecided, match="Qw couples more disturbances than rational numbers can invert in a check"):
            exact(np.eye(4), np.eye(4) + 1.0)  # six


def test_a_channel_that_does_not_drive_may_be_without_weight():
    """Qw = 2 u u' for u = (1, 1), and a plant that is driven along u only: x'Qw x is |2 w|^2/2 there."""
    Qw = np.array([[2.0, 2.0], [2.0, 2.0]])
    with balls.precision():
        assert np.allclose(balls.floats(noise(np.array([[1.0, 1.0], [3.0, 3.0]]), Qw)), [[0.5, 1.5], [1.5, 4.5]])
        assert np.allclose(balls.floats(noise(np.array([[1.0, 0.0]]), np.diag([2.0, 0.0]))), [[0.5]])
        with pytest.raises(Refused, match="Qw is singular in a direction that drives the plant"):
            noise(np.array([[1.0, 1.0 + 2.0**-50]]), Qw)
        for indefinite in ([[0.0, 1.0], [1.0, 0.0]], [[1.0, 2.0], [2.0, 1.0]]):
            with pytest.raises(Refused, match="Qw is not positive semidefinite"):
                noise(np.zeros((1, 2)), np.array(indefinite))


@pytest.mark.parametrize(
    "plant", few([OSCILLATOR, DOUBLE, FOUR], 0, 1), ids=["oscillator", "double integrator", "four states"]
)
def test_the_papers_own_constants_are_proven(plant):
    assert certify_from_proof(plant, PeriodicSchedule([1.0])).verify(rigorous=True).verdict == "proven"


def test_chosen_weights_are_proven():
    assert certify(DOUBLE, PeriodicSchedule([1.0]), eta=0.4).verify(rigorous=True).verdict == "proven"


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (lambda c: BallWeights(c.plant, dataclasses.replace(c.weights, Qv=-np.eye(1))), "Qv is not positive definite"),
        (lambda c: framed(c, -BallWeights(c.plant, c.weights).P2, "0 < -1"), "the left side is not"),
    ],
)
def test_what_stops_a_proof_says_why(run, message, made):
    with balls.precision(), pytest.raises(Refused, match=message):
        run(content(made("oscillator").to_dict()))


def test_an_inequality_that_is_exactly_tight_is_undecided():
    """Y keeps its value, for growth and discount cancel in the last bit: P1 = P2 holds, with nothing to spare."""
    held = Certificate.from_matrices(
        Plant([[-0.05]], [[1.0]], G=[[0.0]]),
        PeriodicSchedule([1.0]),
        P1=[[1.0]],
        P2=[[1.0]],
        Qw=[[1.0]],
        R=[[2.0]],
        Qv=[[2.0]],
        eta=0.1,
    ).to_dict()
    assert verify_rigorously(held).verdict == "undecided"
    with balls.precision(), pytest.raises(Refused, match="could not be decided: it is tight or nearly so"):
        assumption_7(content(held), Budget(60.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"digest": "0"}, "the digest does not fit the content: something was altered"),
        ({"claim": "wishful"}, "the data are no certificate: `claim` must be"),
    ],
)
def test_files_that_are_not_understood_stop_the_proof(change, message, made):
    data = made("oscillator").to_dict() | change
    data = data if "digest" in change else redigested(data)
    found = verify_rigorously(data)
    assert found.verdict == "bad file"
    assert message in found.reason


def test_a_recursion_that_grows_has_no_family():
    made_up = Certificate.from_matrices(
        OSCILLATOR,
        PeriodicSchedule([np.pi]),
        P1=1e-9 * np.eye(2),
        P2=np.eye(2),
        Qw=np.eye(2),
        R=[[2.0]],
        Qv=[[2.0]],
        eta=0.4,
    ).to_dict()
    with balls.precision():
        c = content(made_up)
        frame = framed(c, BallWeights(c.plant, c.weights).P2, "aliased")
        with pytest.raises(ArithmeticError, match="settles far above what is claimed"):
            settled(frame, 1e-2, Budget(60.0))


def test_the_search_for_a_counterexample_keeps_to_the_budget(made):
    data = made("oscillator").to_dict()
    with balls.precision():
        c = content(data)

        def make():
            return framed(c, BallWeights(c.plant, c.weights).P2, "out of reach")

        with pytest.raises(BudgetSpentError, match="the budget ran out"):
            refute(make, Budget(-1.0))
        with pytest.raises(Refused, match="out of reach fails by"):
            refute(make, Budget(60.0))


@pytest.mark.parametrize("name", ["double integrator", "four states", "stiff"])
def test_fewer_digits_never_refute_what_is_proven(name, made):
    """Rounding makes a lower bound of Y indefinite; the least over gains, which is monotone, is then no number."""
    c, lost = content(made(name).to_dict()), []
    with balls.precision():
        frame = framed(c, BallWeights(c.plant, c.weights).P2 / balls.ball(c.weights.lam), "proven")
        points = RefutationSearch(frame, False, Budget(60.0)).grid()[:40]
    for bits in (6, 8, 10, 12, 16, 24):
        with balls.precision(bits):
            assert not any(fails_at(frame, point) for point in points), bits
            lost.append(frame.sampled(balls.lowered(frame.start - balls.identity(frame.n) * 10**9), 0))
    assert lost == [None] * 6


def test_a_witness_that_few_digits_lose_is_neither_reached_nor_refuted(made):
    c = content(made("double integrator").to_dict())
    assert replays_in_balls(c)
    with balls.precision(5), pytest.raises(Refused, match="the window of the witness is lost in rounding") as lost:
        attained(c, Budget(60.0))
    assert lost.value.verdict == "undecided"


def test_the_search_for_a_counterexample_walks_in_doubles(made):
    """What it finds is decided in balls; so far as doubles go it sees the same."""
    data = made("oscillator").to_dict()
    with balls.precision():
        c = content(data)
        frame = framed(c, BallWeights(c.plant, c.weights).P2, "out of reach")
        search, Y = RefutationSearch(frame, False, Budget(60.0)), frame.start
        for duration in (0.0, 0.3, float(frame.schedule.gaps[0])):
            exact = balls.floats(frame.flow.step(Y, balls.ball(duration)))
            assert search.step(balls.floats(Y), duration) == pytest.approx(exact, rel=1e-12)
        assert propagate(balls.floats(Y), *search.over_gaps[0]) == pytest.approx(exact, rel=1e-12)


@pytest.mark.long
def test_a_long_run_that_settles_over_thousands_of_periods_is_found():
    plant, eta = Plant([[0.0]], [[1.0]], G=[[1e-4]]), 0.005
    made = certify(plant, PeriodicSchedule([1.0]), eta=eta, P2=[[1e9]])  # Y begins so low that no gain holds it
    with balls.precision(400):
        frame = framed(made.content, targets(made.content.weights)[0].target, "slow")
        found, worst = settled(frame, 1e-30, ENDLESS)
    F, W = np.exp(eta), 1e-8 * np.expm1(eta) / eta  # after a sample Y = M/(1 + M), M = F Y + W before it
    Y = (np.sqrt((1 + W - F) ** 2 + 4 * F * W) - (1 + W - F)) / (2 * F)
    unit = made.P1[0, 0] * (1 + made.margin)
    assert balls.floats(found[0])[0, 0] == pytest.approx(Y * unit, rel=1e-9)
    assert worst == pytest.approx((F * Y + W) * unit, rel=1e-9)


@pytest.mark.parametrize(
    ("A", "gap", "P2"), [([[-0.3, 11.0], [-1.6, -0.3]], 0.75, 0.3), ([[-0.5, 7.5], [-9.0, -0.5]], 1.0, 6.0)]
)
def test_a_long_run_whose_peak_lies_between_samples_is_proven(A, gap, P2):
    """Whatever samples leave of room, a family that is blown up at all has none left at its peak."""
    data = certify(Plant(A, [[1.0, 0.0]]), PeriodicSchedule([gap]), eta=0.8, P2=P2 * np.eye(2)).to_dict()
    assert verify_rigorously(data).passed


def test_a_long_run_that_never_comes_near_itself_is_no_family(made):
    c = content(made("oscillator").to_dict())
    with balls.precision():
        frame = framed(c, targets(c.weights)[0].target, "never")
        with pytest.raises(ArithmeticError, match="the recursion does not settle"):
            long_run(frame, frame.identity, lambda before, after: False, lambda maps: None)


def test_a_long_run_far_above_what_is_claimed_is_no_family(made):
    c = content(made("oscillator").to_dict())
    with balls.precision(), pytest.raises(ArithmeticError, match="settles far above what is claimed"):
        settled(framed(c, balls.symmetric(1e9 * c.weights.P1), "far"), 1e-14, ENDLESS)


@pytest.mark.parametrize("turn", [0.0, 2.0], ids=["decays", "turns as it decays"])
def test_windows_that_linger_are_caught_by_one_that_is_raised_and_comes_back(turn, monkeypatch):
    """What is hardly driven settles far below where windows begin, and they come down as slowly as it decays."""
    A = [[0.05, 0.0, 0.0], [0.0, -0.01, turn], [0.0, -turn, -0.01]]
    plant = Plant(A, [[1.0, 0.1, 0.0]], G=np.diag([1.0, 1e-4, 1e-4]))
    made = certify(plant, PeriodicSchedule([1.0]), eta=0.002, P2=np.diag([0.2, 1.0, 1.0]))
    assert decided_on_schedule(made.content, WorkLimit(2e4)).passed
    with monkeypatch.context() as without:
        without.setattr(ball_proof, "SOUGHT", 0)
        narrow = decided_on_schedule(made.content, WorkLimit(2e4))
    assert (narrow.verdict, narrow.reason) == ("undecided", "it takes more work than was handed over")


@pytest.mark.parametrize(
    ("gap", "room", "most", "kept"),
    [(1.0, 1.1, 40, 1), (1.0, 0.9, 40, 0), (1.0, 1.1, 1, 0), (np.pi, 1e6, 40, 0)],
    ids=["below I", "above I between samples", "not yet back", "never comes back"],
)
def test_a_window_is_a_family_if_it_comes_back_and_is_below_one_until_then(gap, room, most, kept, monkeypatch):
    """The target is what the window has at its peak, with room; the oscillator is observed nowhere every half turn."""
    monkeypatch.setattr(ball_proof, "WIDENED", 1.0)
    parts = {"P1": 1e-9 * np.eye(2), "P2": 0.1 * np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]], "eta": 0.4}
    c = content(Certificate.from_matrices(OSCILLATOR, PeriodicSchedule([gap]), **parts).to_dict())
    with balls.precision():
        plain = framed(c, balls.identity(2), "peak")
        before = plain.flow.step(plain.start, plain.schedule.gaps[0])
        after = plain.with_gain(before, 0, plain.gain(before, 0))
        peak = max(
            np.linalg.eigvalsh(balls.floats(plain.flow.step(after, balls.ball(s))))[-1]
            for s in gap * np.linspace(0, 1, 41)
        )
        windows = ball_proof.BallWindows(framed(c, balls.identity(2) / (peak * room), "peak"), ENDLESS)
        windows.widen(windows.frame.flow.step(windows.frame.start, windows.schedule.gaps[0]), 0, most)
    assert len(windows.families) == kept
