"""Detectability certificates: judged by the plain dissipation matrix, tight where the best constants are known."""

import cvxpy as cp
import numpy as np
import pytest
import scipy.linalg as sla

from sampling_design import ArgumentError, Plant, named_plant
from sampling_design.certificates.detectability import best_rate as room
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.errors import CertificateError, NotDetectableError, SolverError
from tests.cases import few
from tests.oracles.proof_constants import dissipation_top

DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
UNSEEN = Plant(np.diag([0.5, -0.3]), [[1.0, 0.0]])


def random_plant(seed):
    rng = np.random.default_rng(seed)
    n, p, q = rng.integers(1, 6), rng.integers(1, 3), rng.integers(1, 4)
    A = rng.normal(size=(n, n)) * 10 ** rng.uniform(-2, 2)
    return Plant(A, rng.normal(size=(p, n)) * 10 ** rng.uniform(-2, 2), G=rng.normal(size=(n, q)))


def oracle(certificate):
    plant = certificate.plant
    return dissipation_top(
        plant.A, plant.C, plant.G, certificate.P, certificate.eta, certificate.c_w, certificate.c_y
    ) / np.linalg.norm(certificate.P, 2)


@pytest.mark.parametrize("seed", few(range(40), *range(0, 40, 8)))
def test_every_certificate_satisfies_the_dissipation_inequality(seed):
    plant = random_plant(seed)
    for found in (certify_detectability(plant), detectability_from_proof(plant)):
        assert found.verify().passed
        assert oracle(found) <= 1e-12 * np.linalg.norm(plant.A, 2)
        assert np.linalg.eigvalsh(found.P)[0] > 0


@pytest.mark.parametrize("plant", [DOUBLE, OSCILLATOR, UNSEEN, random_plant(3), random_plant(11)])
def test_least_gain_is_the_optimum_of_the_matrix_inequality(plant):
    n, rate = plant.n_states, 0.2
    found = certify_detectability(plant, rate, margin=1e-6, floor=0.0)
    ratio = found.c_y / found.c_w
    P, c_y = cp.Variable((n, n), symmetric=True), cp.Variable()
    corner = plant.A.T @ P + P @ plant.A + rate * P - c_y * plant.C.T @ plant.C
    scale = np.sqrt(ratio)
    block = cp.bmat([[corner, scale * P @ plant.G], [scale * plant.G.T @ P, -c_y * np.eye(plant.n_disturbances)]])
    problem = cp.Problem(cp.Minimize(c_y), [P >> np.eye(n), (block + block.T) / 2 << 0])
    problem.solve(solver=cp.CLARABEL)
    assert found.c_y == pytest.approx(problem.value, rel=1e-4)


def test_scalar_plant_has_the_gain_of_its_quadratic_equation():
    a, rate = 1.0, 0.5
    found = certify_detectability(Plant([[a]], [[1.0]]), rate, margin=1e-9, floor=0.0)
    s = 2 * a + rate
    assert found.c_y == pytest.approx((s + np.sqrt(s**2 + 4)) / 2, rel=1e-8)
    assert found.c_w == pytest.approx(found.c_y, rel=1e-12)


def test_best_rate_reaches_its_bounds_and_no_further():
    best = certify_detectability(DOUBLE, c_w=5.0, c_y=8.0)
    assert (best.c_w, best.c_y) == pytest.approx((5.0, 8.0))
    assert certify_detectability(DOUBLE, best.eta, c_w=5.0, c_y=8.0).verify().passed
    with pytest.raises(CertificateError, match="more than the bounds") as caught:
        certify_detectability(DOUBLE, best.eta * 1.001, c_w=5.0, c_y=8.0)
    assert caught.value.details["least_c_y"] > 8.0
    assert certify_detectability(DOUBLE, noise_gain=20).eta > certify_detectability(DOUBLE, noise_gain=5).eta


def test_bounds_below_those_of_rate_zero_are_refused():
    with pytest.raises(CertificateError, match="No rate is possible within these bounds") as caught:
        certify_detectability(DOUBLE, c_w=0.1, c_y=0.1)
    assert caught.value.details["least_c_y"] > 0.1


@pytest.mark.parametrize("size", [1e150, 1e200, 1e308])
def test_gains_beyond_double_precision_are_refused_in_words(size):
    with pytest.raises(
        SolverError, match=r"are not finite with the floor .*: ask for a smaller `noise_gain` or `floor`"
    ):
        certify_detectability(OSCILLATOR, floor=size)


def test_noise_gains_and_rates_beyond_double_precision_are_refused_in_words():
    with pytest.raises(SolverError, match=r"times the noise gain .* are not finite"):
        certify_detectability(OSCILLATOR, noise_gain=1e308)
    with pytest.raises(SolverError, match="has no stabilising solution in floating point"):
        certify_detectability(OSCILLATOR, 1e308)
    with pytest.raises(ArgumentError, match=r"`c_y / c_w` must be finite"):
        certify_detectability(OSCILLATOR, c_w=1e-300, c_y=1e300)


@pytest.mark.parametrize("rate", [0.1, 0.59, 0.599, 0.5999])
def test_rates_just_below_twice_the_unseen_decay_are_certified(rate):
    assert oracle(certify_detectability(UNSEEN, rate, margin=1e-5)) <= 0


@pytest.mark.parametrize("rate", [0.6, 0.601, 0.61, 5.0])
def test_rates_from_twice_the_unseen_decay_are_refused_with_the_mode(rate):
    with pytest.raises(NotDetectableError, match="Not detectable: no output observes") as caught:
        certify_detectability(UNSEEN, rate)
    assert caught.value.eigenvalues == pytest.approx([-0.3])
    assert np.abs(caught.value.directions[:, 0]) == pytest.approx([0.0, 1.0])


def test_best_rate_stays_below_the_unseen_decay_however_large_the_noise_gain():
    rates = [certify_detectability(UNSEEN, noise_gain=b).eta for b in (10, 100, 1000)]
    assert rates[0] < rates[1] < rates[2] < 0.6
    assert rates[2] > 0.59


def test_rate_between_the_threshold_and_the_margin_says_what_to_change():
    with pytest.raises(SolverError, match="ask for a smaller rate"):
        certify_detectability(UNSEEN, 0.59999)
    assert certify_detectability(UNSEEN, 0.59999, margin=1e-7).verify().passed


@pytest.mark.parametrize("eigenvalue", [0.0, 0.2, 1e-9])
def test_unseen_mode_that_does_not_decay_is_refused_by_both(eigenvalue):
    plant = Plant(sla.block_diag([[eigenvalue]], [[0, 1.0], [-1, 0]]), [[0.0, 1.0, 0.0]])
    for function in (certify_detectability, detectability_from_proof):
        with pytest.raises(NotDetectableError) as caught:
            function(plant)
        assert caught.value.eigenvalues == pytest.approx([eigenvalue], abs=1e-8)
        assert np.abs(caught.value.directions[:, 0]) == pytest.approx([1.0, 0.0, 0.0], abs=1e-8)


@pytest.mark.parametrize("name", ["satellite", "tidal_gauge", "cart_pendulum", "three_compartment", "helicopter_he1"])
def test_plants_of_the_library_are_certified_by_every_method(name):
    plant = named_plant(name)
    for found in (certify_detectability(plant), detectability_from_proof(plant)):
        assert found.verify().passed
        assert oracle(found) <= 1e-12 * np.linalg.norm(plant.A, 2)


def test_proof_constants_are_those_of_the_formulas():
    L, Q = np.array([[2.0], [3.0]]), np.diag([2.0, 1.0])
    found = detectability_from_proof(DOUBLE, L, Q)
    A_L = DOUBLE.A - L @ DOUBLE.C
    P = sla.solve_continuous_lyapunov(A_L.T, -Q)
    np.testing.assert_allclose(found.P, P)
    assert found.eta == pytest.approx(0.5 / np.linalg.eigvalsh(P)[-1])
    assert found.c_w == pytest.approx(4 * np.linalg.norm(P, 2) ** 2)
    assert found.c_y == pytest.approx(4 * np.linalg.norm(P @ L, 2) ** 2)
    assert all(c.source.startswith("Theorem 10") and c.formula for c in found.constants)


@pytest.mark.parametrize(("field", "factor"), [("eta", 1.01), ("c_w", 0.98), ("c_y", 0.98)])
def test_altered_constants_fail_their_check(field, factor):
    best = certify_detectability(DOUBLE, eta=1.0)
    values = {key: getattr(best, key) for key in ("eta", "c_w", "c_y")}
    values[field] *= factor
    check = DetectabilityCertificate(DOUBLE, best.P, **values).verify()
    assert not check.passed
    assert check.amount < 0
    assert "fails by" in check.explain()


def test_constants_do_not_depend_on_the_unit_of_time():
    slow = certify_detectability(Plant(DOUBLE.A * [[1, 1], [1, 1]] / 60, DOUBLE.C, G=np.eye(2) / 60))
    fast = certify_detectability(DOUBLE)
    assert slow.eta * 60 == pytest.approx(fast.eta, rel=1e-4)


@pytest.mark.parametrize(
    "plant",
    [
        Plant([[-1.0]], [[0.0]]),
        Plant(np.zeros((2, 2)), np.eye(2), G=np.zeros((2, 0))),
        Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
        Plant(np.diag([-1e6, 0.1]), [[1.0, 1.0]]),
        Plant(sla.block_diag(np.diag([1.0] * 2, 1), [[-2.0]]), [[1.0, 0.0, 0.0, 1.0]]),
    ],
)
def test_degenerate_plants_are_certified_both_ways(plant):
    for found in (certify_detectability(plant), detectability_from_proof(plant)):
        assert found.verify().passed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"c_w": 1.0}, "must be bounded together or not at all"),
        ({"eta": -1.0}, "`eta` must be positive"),
        ({"noise_gain": 0.0}, "`noise_gain` must be positive"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        certify_detectability(DOUBLE, **arguments)


def test_plants_without_states_and_useless_gains_are_refused():
    with pytest.raises(ArgumentError, match="must have at least one state"):
        certify_detectability(Plant(np.zeros((0, 0)), np.zeros((1, 0))))
    with pytest.raises(ArgumentError, match="must make A - LC Hurwitz"):
        detectability_from_proof(DOUBLE, gain=[[-1.0], [0.0]])
    with pytest.raises(ArgumentError, match="`Q` must be positive definite"):
        detectability_from_proof(DOUBLE, Q=-np.eye(2))
    with pytest.raises(ArgumentError, match="`P` must be positive definite"):
        DetectabilityCertificate(DOUBLE, -np.eye(2), 1.0, 1.0, 1.0)


def test_certificate_that_fails_is_never_returned(monkeypatch):
    monkeypatch.setattr(room, "_largest_P", lambda *_: (np.eye(2), np.zeros((2, 1))))
    with pytest.raises(CertificateError, match="No detectability certificate"):
        certify_detectability(DOUBLE, eta=1.0)


def test_record_shows_itself():
    found = detectability_from_proof(DOUBLE)
    assert "c_w" in str(found)
    assert "come together" in found.explain()
    assert found.to_dict()["eta"] == found.eta
    assert found.claim.theorem.startswith("Theorem 10")
    assert "<table>" in found._repr_html_()
    assert found.verify().explain().startswith("Proven: P > 0 and")
    assert found.verify()._rows()[0] == ("passed", "yes")


def test_a_riccati_equation_without_solution_is_a_sentence(monkeypatch):
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    monkeypatch.setattr(room, "_filter", lambda *given: None)
    with pytest.raises(SolverError, match=r"equation at rate 0\.1 has no stabilising solution"):
        room._largest_P(plant, 0.1, 1.0, 0.0, 1.0)
    with pytest.raises(SolverError, match="equation at rate 0 has no stabilising solution"):
        room.detectability_from_proof(plant)
