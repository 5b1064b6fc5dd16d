"""Nearly every detectable plant gets its certificate, whatever its modes, coordinates and units; the rest is told why.

A slice of `tests/benchmarks/bench_certify_random.py` that takes seconds, with what once was left undecided among it.
"""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates import certification as room
from sampling_design.certificates.exact import efforts, precise, riccati, riccati_peak, weight_choice
from sampling_design.certificates.exact import proof as proofs
from sampling_design.certificates.exact.canonical import canonical
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.errors import UndecidedError
from tests.benchmarks.bench_certify_random import drawn
from tests.cases import few
from tests.oracles.riccati import settled

QUICK = (3, 5, 6, 7)
"""One to three states in mixed units; 5: two gauges, 1e12 apart, of one state."""


@pytest.mark.parametrize("seed", few(QUICK, 0, 1))
def test_a_drawn_plant_is_certified(seed):
    plant, schedule = drawn(seed)
    made = certify(plant, schedule)
    assert made.verify().passed
    assert np.isfinite(made.horizon().minimum)


@pytest.mark.long
@pytest.mark.parametrize("seed", [311, 360, 465, 487, 739])
def test_a_budget_in_units_that_nobody_stated_leaves_a_round_shape(seed):
    """States 1e22 apart, no scales: no P2 near the budget's own can be held. 311, 487: nine modes behind one output.

    739: slow rates use up the work, and a fast one has its own.
    """
    plant, schedule = drawn(seed)
    made = certify(plant, schedule)
    assert np.linalg.cond(canonical(plant, schedule, weights_of(plant, None, None, None)).inside(made.P2)) < 1e12
    assert made.verify().passed


SEEN_LATE = {
    "scalar": lambda a: Plant([[a]], [[1.0]]),
    "spiral": lambda a: Plant([[a, 2.0], [-2.0, a]], [[1.0, 0.0]]),
    "defective": lambda a: Plant([[a, 1.0], [0.0, a]], [[1.0, 0.0]]),
    "undisturbed": lambda a: Plant([[a, 0.0], [1.0, -1.0]], [[0.0, 1.0]], G=[[0.0], [1.0]]),
}


@pytest.mark.parametrize(
    ("kind", "growth", "gaps", "first"),
    [
        ("scalar", 2.0, [1.0, 1.0], 2.0),
        ("scalar", 5.0, [0.3] * 8, 2.4),
        pytest.param("defective", 2.0, [0.5, 1.0, 0.7], 2.2, marks=pytest.mark.long),
        *(
            pytest.param(kind, growth, gaps, sum(gaps), marks=pytest.mark.long)
            for kind in SEEN_LATE
            for growth in (0.3, 2.0, 5.0)
            for gaps in ([1.0, 1.0], [0.3] * 8)
        ),
    ],
)
def test_a_growing_plant_is_certified_however_late_its_first_sample(kind, growth, gaps, first):
    """Before the first sample the error outgrows all that the rhythm ever leaves: no P1 can be judged by that alone."""
    assert first > gaps[0]
    plant = SEEN_LATE[kind](growth)
    made = certify(plant, PeriodicSchedule(gaps, first))
    assert made.lam >= np.exp((2 * growth + made.eta) * (first - gaps[0]))
    assert made.verify().passed


def test_the_least_noise_of_a_late_start_is_that_of_its_windows():
    """From a known state the error of x' = a x + w has variance (e^{ct} - 1)/c after t, c = 2a + eta."""
    plant, eta, first = Plant([[2.0]], [[1.0]]), 0.5, 2.0
    problem = window_problem(
        plant, PeriodicSchedule([1.0, 1.0], first), np.eye(1), np.eye(1), np.eye(1), np.eye(1), eta
    )
    rate = 4.0 + eta
    assert WindowSet.of(problem).least_floor(np.ones(1)) == pytest.approx(np.expm1(rate * first) / rate, rel=1e-12)


@pytest.mark.long
def test_outputs_that_are_nearly_exact_in_the_plants_units(monkeypatch):
    """Eight states, noises 1e-30 of what a unit disturbance does: composed periods once settled nowhere."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", weight_choice.SEARCH_WORK / 20)  # the best first guess will do
    plant, schedule = drawn(16)
    assert certify(plant, schedule).verify().passed


def test_weights_of_a_large_condition_are_proven_in_floats():
    """P2 of condition 1e10 in random coordinates: its inverse loses twenty digits of Y, Z with Y = Z'Z loses ten."""
    rng = np.random.default_rng(4)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plant = Plant(Q @ np.diag([-0.1, -0.2, -0.3]) @ Q.T, np.eye(3) @ Q.T)
    P2 = Q @ np.diag([1.0, 1e-5, 1e-10]) @ Q.T
    made = certify(plant, PeriodicSchedule([1.0]), eta=0.1, P2=(P2 + P2.T) / 2)
    assert verdict_of(made.to_dict()).passed


def test_where_the_best_rate_cannot_be_proven_another_is(monkeypatch):
    """The least horizon may ask for a rate and a lambda that no proof in doubles reaches."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    plant, schedule = drawn(2)
    plain = certify(plant, schedule)
    failing = plain.eta
    closed = proofs.ScheduleProof.closed

    def fails(proof, solver, plainly=False):
        if proof.eta == pytest.approx(failing, rel=0.2):
            raise UndecidedError("undecided: the proof is made to fail")
        return closed(proof, solver, plainly)

    monkeypatch.setattr(proofs.ScheduleProof, "closed", fails)
    spare = certify(plant, schedule)
    assert spare.eta != pytest.approx(failing, rel=0.2)
    assert "at the best rate no proof closed" in spare.solver.details["weights"]
    assert spare.horizon().minimum >= plain.horizon().minimum * (1 - 1e-3)


def test_where_no_shape_can_be_proven_a_round_one_is(monkeypatch):
    """The covariance itself, inverted, may have a condition that no proof in doubles bears."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    plant, schedule = drawn(2)
    closed, choices, rounder = proofs.ScheduleProof.closed, room.round_choices, list[float]()

    def fails(proof, solver, plainly=False):
        if not rounder:
            raise UndecidedError("undecided: the proof is made to fail")
        return closed(proof, solver, plainly)

    def asked(canon, rates, budget, whole):
        found = list(choices(canon, rates, budget, whole))
        rounder.extend(np.linalg.cond(choice.P2) for some in found for choice in some)
        return found

    monkeypatch.setattr(proofs.ScheduleProof, "closed", fails)
    monkeypatch.setattr(room, "round_choices", asked)
    made = certify(plant, schedule)
    assert made.verify().passed
    assert rounder
    assert min(rounder) < 100


@pytest.mark.long
def test_what_doubling_and_walking_lose_is_followed_from_above():
    """Three defective clusters, noises 1e-30 apart: nothing settles; with a floor it does, near what 400 digits say."""
    plant, schedule = drawn(98)
    canon = canonical(plant, schedule, weights_of(plant, None, None, None), driven=False)
    problem = window_problem(canon.plant, canon.schedule, np.eye(plant.n_states), *canon.weights, 0.05)
    with np.errstate(all="ignore"):
        found = riccati.periodic_riccati_solution(problem)
    exact = settled(problem.A.tolist(), problem.noise.tolist(), problem.rows.tolist(), problem.gaps.tolist(), 0.05)
    for Y, true in zip(found, exact, strict=True):
        assert np.all(np.diagonal(Y) >= 0.99 * np.diagonal(true))
        assert np.all(np.diagonal(Y) <= 1.5 * np.diagonal(true))


def test_near_aliasing_is_certified():
    """A period that misses pi by a millionth: what is seen barely is followed for long, and proven."""
    oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    made = certify(oscillator, PeriodicSchedule([np.pi * (1 + 1e-6)]), eta=0.4)
    assert made.verify().passed
    assert made.horizon().minimum == pytest.approx(2 * np.pi, rel=1e-3)


def test_no_weights_are_tried_twice(monkeypatch):
    """Descents that gain nothing end where they began, and would be proven, or not, once more."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    plant, schedule = drawn(2)
    canon = canonical(plant, schedule, weights_of(plant, None, None, None))
    choices = weight_choice.choose_weights(canon, (0.3, 0.3), [3.0])[0]
    pairs = [(one, other) for k, one in enumerate(choices) for other in choices[:k]]
    assert pairs
    for one, other in pairs:
        assert not np.allclose(one.P2, other.P2, rtol=1e-9, atol=0)


def open_proof(monkeypatch, *, spent=0.0, beyond=0.0):
    """A proof that neither floats nor balls close, which spend so much on it; what lambda each was asked, relative.

    `beyond` is the long run's lambda in those that were met, where it was looked for.
    """
    tried, handed = list[float](), list[float]()

    def floats(content, work):
        tried.append(content.weights.lam)
        work.spend(spent)
        return still_open

    def balls(content, work):
        handed.append(content.weights.lam)
        assert work.left == efforts.ONE_IN_BALLS
        return still_open

    oscillator, schedule = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([1.0])
    weights = (np.eye(2), *weights_of(oscillator, None, None, None))
    made = certify(oscillator, schedule, eta=0.4, P2=np.eye(2))
    still_open = dataclasses.replace(made.verify(), passed=False, verdict="undecided", time=None, start=None)
    monkeypatch.setattr(proofs, "verdict_on_schedule", floats)
    monkeypatch.setattr(proofs, "decided_on_schedule", balls)
    proof = proofs.ScheduleProof(oscillator, schedule, weights, 0.4, efforts.SearchEffort(), beyond * made.lam_samples)

    def asked(plainly=False):
        with pytest.raises(UndecidedError, match="the proof of the certificate did not close"):
            proof.closed(made.solver, plainly)
        return [lam / made.lam for lam in tried], [lam / made.lam for lam in handed]

    return asked


@pytest.mark.parametrize("beyond", [0.0, 100.0], ids=["met", "far below the long run"])
def test_no_proof_is_tried_twice(beyond, monkeypatch):
    """What floats leave open at one lambda goes to balls once, and then only a larger lambda is tried.

    Where the long run is far above all windows that could be followed, it alone is tried with room, and in balls.
    """
    tried, handed = open_proof(monkeypatch, beyond=beyond)()
    rooms = (1.0, 1.003 * beyond) if beyond else (1.0, *efforts.ROOM)
    assert tried == pytest.approx(rooms, rel=1e-6)
    assert handed == ([tried[1]] if beyond else [tried[0]])


def test_a_proof_that_is_taken_up_again_goes_on(monkeypatch):
    """Others have their turn before the best choice is stated with room; what was tried then is not tried again."""
    asked = open_proof(monkeypatch)
    assert asked(plainly=True) == (pytest.approx([1.0], rel=1e-6), pytest.approx([1.0], rel=1e-6))
    assert asked(plainly=False) == (pytest.approx([1.0, *efforts.ROOM], rel=1e-6), pytest.approx([1.0], rel=1e-6))


def test_what_only_took_too_much_work_is_stated_with_a_wide_room(monkeypatch):
    """Balls would take a hundred times as much, and a lambda that is hardly larger as much again."""
    wide = [room for room in efforts.ROOM if room >= efforts.WIDE]
    tried, handed = open_proof(monkeypatch, spent=1.01 * efforts.ONE_CHECK)(plainly=False)
    assert tried == pytest.approx([1.0, *wide], rel=1e-6)
    assert not handed


def test_the_work_after_the_search_is_bounded():
    """Every group of choices has its turn, balls at their price, and no group more than all."""
    first = efforts.SearchEffort()
    first.check_in_balls().spend(efforts.ONE_IN_BALLS)
    assert first.total.left == pytest.approx(efforts.ALL_WORK - efforts.BALL_PRICE * efforts.ONE_IN_BALLS)
    assert first.balls.left == efforts.BALL_WORK - efforts.ONE_IN_BALLS
    assert first.later().balls.left == efforts.ONE_IN_BALLS
    groups = [first, first.later(), first.later().later()]
    for group in groups:
        assert not group.over
        group.check().spend(group.whole.left)
        assert group.over
        assert group.check().over
        assert group.check_in_balls().over
    assert first.later().whole.left < 0.2 * efforts.ALL_WORK
    assert efforts.SearchEffort(alone=True).check().left == efforts.CHECK_WORK  # one choice alone may do it all


def test_a_window_that_starts_at_a_sample_counts_for_both_lambdas():
    """Else the same window is found twice, once for all starts and once for those at samples."""
    plant, schedule = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([0.5, 1.0], first=0.25)
    problem = window_problem(plant, schedule, np.eye(2), *weights_of(plant, None, None, None), 0.4)
    for start, at_sample in ((0.0, True), (0.25, True), (1.25, True), (1.75, True), (0.1, False), (0.7, False)):
        assert riccati_peak.starts_at_sample(problem, riccati_peak.located(problem, start, 4.0)) is at_sample, start


@pytest.mark.long
def test_what_doubles_cannot_follow_is_certified_in_more_digits(monkeypatch):
    """Chains of integrators and a growing one, driven by one disturbance: nothing settles in doubles."""
    monkeypatch.setattr(precise, "ROOM", (1.0, 1.0, 3.0))  # the widest at once
    plant, schedule = drawn(331)
    rate = 1 / float(np.mean(schedule.gaps))
    made = certify(plant, schedule, eta=rate)
    assert "binary digits" in made.solver.details["weights"]
    monkeypatch.setattr(precise, "find_spec", lambda name: None)
    with pytest.raises(UndecidedError, match="the schedule is on the edge of what can be certified"):
        certify(plant, schedule, eta=rate)


UNDRIVEN = {
    "growing": ([[0.3]], [[-0.4]]),
    "decaying, defective": ([[-0.5, 1.0], [0.0, -0.5]], [[0.8, -0.2]]),
    "an unobserved mode decays": (np.diag([-0.3, -0.3, 0.1]), [[-0.2, -1.3, -0.5]]),
}


@pytest.mark.parametrize(
    ("name", "schedule"),
    few(product(UNDRIVEN, [PeriodicSchedule([7e5, 1e6]), Schedule([0.7, 1.0, 1.3, 2.3])]), 0, 2, 3, 5),
)
def test_a_plant_that_nothing_drives_is_certified(name, schedule, monkeypatch):
    """What is known of it stays known for ever: no noise gain has a least, and weights are those of a driven one."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    A, C = UNDRIVEN[name]
    made = certify(Plant(np.divide(A, 1e6 if schedule.endless else 1.0), C, G=np.zeros((len(A), 1))), schedule)
    assert "nothing drives" in made.solver.details["weights"]
    assert made.verify().passed


PARTLY_DRIVEN = {
    "beside a drift, unobserved": (np.diag([0.0, -0.125]), [[1.0, 0.0]]),
    "beside a mode that grows, observed": (np.diag([0.1, -0.5]), np.eye(2)),
    "moves the drift": ([[0.0, 1.0], [0.0, -0.125]], [[1.0, 0.0]]),
}


@pytest.mark.parametrize("name", few(list(PARTLY_DRIVEN), 2))
def test_a_state_that_nothing_drives_beside_one_that_is_driven(name, monkeypatch):
    """It decays faster than errors are discounted, and in the long run has no variance: any weight serves for it.

    In coordinates that mix both states lambda is the same.
    """
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    A, C = PARTLY_DRIVEN[name]
    turned, schedule = np.array([[0.8, -0.6], [0.6, 0.8]]), PeriodicSchedule([1.0])
    lam = [certify(Plant(T @ A @ T.T, C @ T.T, G=T[:, :1]), schedule, eta=0.1).lam for T in (np.eye(2), turned)]
    assert lam[0] == pytest.approx(lam[1], rel=1e-3)
