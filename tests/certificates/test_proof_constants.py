"""The chain of the paper's constants: reference numbers, validity by a plain Riccati recursion, each inequality."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg as sla

from sampling_design import ArgumentError, PeriodicSchedule, Plant, Schedule
from sampling_design.certificates.compare.four_horizons import four_horizons
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.paper import gain_sweep
from sampling_design.certificates.paper.observable_case import SamplingHypotheses, paper_weights, tightened_weights
from sampling_design.certificates.paper.proof_constants import certify_from_proof, constants_from_proof
from sampling_design.certificates.paper.restarts import output_predictor
from sampling_design.errors import CertificateError, NotDetectableError, SolverError
from sampling_design.observability.windows.window_sigma import window_sigma
from sampling_design.plants.modes import split_modes
from tests.cases import few
from tests.oracles.proof_constants import largest_on_a_grid, riccati_margin, worst_27, worst_28

DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
FOUR = Plant(sla.block_diag([[-1.0]], [[0.1]], [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 1.0, 1.0, 0.0]])
PLANTS = {"double integrator": DOUBLE, "oscillator": OSCILLATOR, "four states": FOUR}
EACH_SECOND = PeriodicSchedule([1.0])


@cache
def reference(name, variant):
    return constants_from_proof(PLANTS[name], EACH_SECOND, variant=variant)


def margin(proof, gaps, start=0.0, masks=None):
    plant = proof.plant
    weights = (proof.P1, proof.P2, proof.Qw, proof.R, proof.Qv, proof.eta)
    return riccati_margin(plant.A, plant.C, plant.G, gaps, *weights, start=start, masks=masks)


@pytest.mark.parametrize("weights", [paper_weights, tightened_weights])
def test_disturbances_that_are_turned_change_no_constant(weights):
    """All of |G|, |C e^{As} G| are norms of the largest disturbance, however many enter at one place."""
    samples = SamplingHypotheses(2.0, 3, 0.4, 1.0)
    one = certify_detectability(Plant(OSCILLATOR.A, OSCILLATOR.C, G=np.outer([0.3, 1.0], [1.0, 0.0, 0.0])))
    spread = Plant(OSCILLATOR.A, OSCILLATOR.C, G=np.outer([0.3, 1.0], np.ones(3) / np.sqrt(3)))
    first, second = weights(one, samples), weights(replace(one, plant=spread), samples)
    assert second.Qw[0, 0] == pytest.approx(first.Qw[0, 0], rel=1e-9)
    assert pytest.approx(first.R0, rel=1e-9) == second.R0


@pytest.mark.parametrize(
    ("name", "variant", "horizon", "window", "kappa", "sigma_bar", "margins"),
    few(
        [
            ("double integrator", "paper", 44.35, 2, 3, 0.382, (500, 5000)),
            ("double integrator", "tightened", 20.6, 2, 3, 0.382, (2.5, 9)),
            ("oscillator", "paper", 44.45, 2, 3, 0.678, (500, 5000)),
            ("oscillator", "tightened", 18.4, 2, 3, 0.678, (2.5, 9)),
            ("four states", "paper", 182.0, 3, 4, 0.319, (500, 5000)),
            ("four states", "tightened", 67.1, 3, 4, 0.319, (2.5, 9)),
        ],
        0,
    ),
)
def test_reference_numbers_are_reached_and_valid(name, variant, horizon, window, kappa, sigma_bar, margins):
    proof = reference(name, variant)
    assert proof.horizon <= horizon
    assert proof.horizon == pytest.approx(2 * np.log(2 * proof.lam) / proof.eta)
    assert (proof["T"].value, proof["kappa"].value) == (window, kappa)
    assert proof["sigma_bar"].value == pytest.approx(sigma_bar, rel=0.01)
    assert margins[0] < margin(proof, [1.0]) < margins[1]
    assert all(margin(proof, [1.0], start=s) > 1 for s in (0.2, 0.5, 0.9))


@pytest.mark.parametrize(
    ("name", "variant", "gains"),
    few(
        [
            ("double integrator", "paper", (4e8, 1.5e12, 2e11)),
            ("double integrator", "tightened", (3e4, 1.3e7, 1.5e6)),
            ("oscillator", "paper", (3e8, 3e10, 1.3e10)),
            ("oscillator", "tightened", (5e3, 1.4e5, 4.6e4)),
            ("four states", "paper", (1e12, 4e12, 9e11)),
        ],
        0,
        2,
        3,
        4,
    ),
)
def test_noise_gains_have_the_size_of_the_reference(name, variant, gains):
    proof = reference(name, variant)
    found = [proof[key].value for key in ("C_x", "C_w", "C_v")]
    assert np.all(np.abs(np.log10(np.divide(found, gains))) < 0.5)
    horizon = proof.certificate().horizon("paper")
    assert found == pytest.approx([horizon.C_x, horizon.C_w, horizon.C_v], rel=3e-3)


def test_lambda_of_the_paper_chain_is_its_formula():
    proof = constants_from_proof(DOUBLE, EACH_SECOND, gain=[[2.0], [2.0]])
    P = proof.detectability.P
    cond = np.linalg.cond(P)
    assert proof.lam == pytest.approx(8 * cond * np.exp((2 + proof.eta) * 2), rel=1e-8)
    assert proof["k_w"].value == pytest.approx(np.sqrt(5), rel=1e-9)
    assert proof["mu_bar"].value == pytest.approx(np.sqrt(5) / proof["sigma_bar"].value, rel=1e-8)
    assert proof["alpha_w"].value == pytest.approx(
        16 * proof["c_2"].value * (3 * proof["mu_bar"].value + 1) ** 2 * 5, rel=1e-8
    )
    assert proof["alpha_y"].value == pytest.approx(24 * proof["c_2"].value * proof["mu_bar"].value ** 2, rel=1e-8)


@pytest.mark.long
def test_longer_window_gives_the_second_row_of_the_reference():
    proof = constants_from_proof(FOUR, EACH_SECOND, window=4.0)
    assert proof["kappa"].value == 5
    assert proof["sigma_bar"].value == pytest.approx(0.745, rel=0.01)
    assert proof.horizon <= 215
    assert margin(proof, [1.0]) > 1e4


@pytest.mark.parametrize("name", ["double integrator", "oscillator"])
@pytest.mark.parametrize("variant", ["paper", "tightened"])
def test_27_and_28_hold_in_the_worst_case(name, variant):
    plant = PLANTS[name]
    proof = reference(name, variant)
    T, mu_bar, kappa, k_w = (proof[key].value for key in ("T", "mu_bar", "kappa", "k_w"))
    for samples in ([0.5, 1.5], [0.0, 1.0, 2.0], [0.9, 1.9]):
        assert worst_27(plant.A, plant.C, plant.G, T, samples, mu_bar, kappa, k_w) <= 1
    constants = [proof[key].value for key in ("alpha_w", "alpha_y", "c_2")]
    discount = 0.0 if variant == "paper" else proof.eta
    for t in (4.0, 6.0):
        samples = np.arange(0.5, t)
        assert worst_28(plant.A, plant.C, plant.G, T, t, samples, *constants, discount=discount) <= 1


def test_27_is_nearly_tight_without_the_losses_of_mu_bar():
    """The oracle reaches the inequality: with mu_bar = |H| of that window and no disturbance it is attained."""
    predictor = output_predictor(OSCILLATOR, Schedule([0.5, 1.5]), t=2.0, window=2.0)
    size = np.linalg.norm(predictor, 2)
    ratio = worst_27(OSCILLATOR.A, OSCILLATOR.C, np.zeros((2, 1)), 2.0, [0.5, 1.5], size, 0.5, 1.0)
    assert ratio == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("seed", few(range(12), 2, 3))
def test_composed_certificates_of_random_plants_are_valid(seed):
    variant = ("paper", "tightened")[seed % 2]
    rng = np.random.default_rng(seed)
    stable = np.diag(-rng.uniform(0.3, 2.0, 2)) + np.triu(rng.normal(size=(2, 2)), 1)
    kept = [np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.05, 1.0], [-1.0, 0.05]]), np.array([[0.2]])][seed % 3]
    V = rng.normal(size=(2 + len(kept), 2 + len(kept))) + 2 * np.eye(2 + len(kept))
    A = V @ sla.block_diag(stable, kept) @ np.linalg.inv(V)
    C = rng.normal(size=(1 + seed % 2, len(A)))
    G = rng.normal(size=(len(A), 1 + seed % 3))
    gaps = rng.uniform(0.3, 1.2, 3)
    proof = constants_from_proof(Plant(A, C, G=G), PeriodicSchedule(gaps), variant=variant)
    for first in range(3):
        assert margin(proof, np.roll(gaps, first)) > 1
        assert margin(proof, np.roll(gaps, first), start=0.5 * np.roll(gaps, first)[0]) > 1


@pytest.mark.long
def test_partial_outputs_are_valid_too():
    plant = Plant(sla.block_diag([[0.0, 1.0], [-1.0, 0.0]], [[0.1]]), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    masks = np.array([[True, False], [False, True], [True, True]])
    gaps = np.array([0.8, 0.7, 0.5])
    for variant in ("paper", "tightened"):
        proof = constants_from_proof(plant, PeriodicSchedule(gaps, outputs=masks), variant=variant)
        for first in range(3):
            assert margin(proof, np.roll(gaps, -first), masks=np.roll(masks, -first, axis=0)) > 1


def test_nothing_retained_needs_no_samples():
    plant = Plant([[-1.0, 3.0], [0.0, -2.0]], [[1.0, 0.0]], G=[[0.0], [1.0]])
    for variant in ("paper", "tightened"):
        proof = constants_from_proof(plant, PeriodicSchedule([50.0]), variant=variant)
        assert proof.lam == pytest.approx(1.0, abs=2e-3)
        assert margin(proof, [50.0]) > 1
        assert proof.certificate().verify().passed
        assert proof.detectability is None


def test_late_first_sample_enters_d_max_and_sigma():
    late = PeriodicSchedule([0.5, 0.5, 0.5, 0.5, 0.5, 0.5], first=3.0)
    proof = constants_from_proof(OSCILLATOR, late, window=4.0, variant="tightened")
    assert proof["d_max"].value == 3.0
    weights = (proof.P1, proof.P2, proof.Qw, proof.R, proof.Qv, proof.eta)
    gaps = [3.0] + [0.5] * 30
    assert riccati_margin(OSCILLATOR.A, OSCILLATOR.C, OSCILLATOR.G, gaps, *weights, periods=1) > 1
    with pytest.raises(CertificateError, match="do not all make every retained state observable"):
        constants_from_proof(OSCILLATOR, late, window=2.0)


def test_finite_schedule_is_measured_to_its_last_sample():
    schedule = Schedule([0.4, 1.0, 1.9, 2.5, 3.6, 4.1, 5.0, 6.0])
    proof = constants_from_proof(DOUBLE, schedule, variant="tightened")
    weights = (proof.P1, proof.P2, proof.Qw, proof.R, proof.Qv, proof.eta)
    gaps = np.diff(np.r_[0.0, schedule.times])
    for first in range(gaps.size):
        assert riccati_margin(DOUBLE.A, DOUBLE.C, DOUBLE.G, gaps[first:], *weights, periods=1) > 1


def test_given_detectability_replaces_the_sweep():
    given = certify_detectability(OSCILLATOR, eta=1.0)
    proof = constants_from_proof(OSCILLATOR, EACH_SECOND, variant="tightened", detectability=given)
    assert proof.eta == 1.0
    assert proof.horizon < 14.0
    assert margin(proof, [1.0]) > 1
    with pytest.raises(ArgumentError, match="must belong to the retained part"):
        constants_from_proof(DOUBLE, EACH_SECOND, detectability=given)
    with pytest.raises(ArgumentError, match="excludes `gain` and `Q`"):
        constants_from_proof(OSCILLATOR, EACH_SECOND, detectability=given, gain=[[1.0], [0.0]])


def test_given_gain_is_the_one_of_theorem_10():
    retained = split_modes(FOUR).retained
    gain = np.linalg.lstsq(retained.C, np.array([[1.0]]), rcond=None)[0] * 2
    found = detectability_from_proof(retained)
    proof = constants_from_proof(FOUR, EACH_SECOND, gain=found.gain)
    assert proof["c_2"].value == found.c_y
    assert gain.shape == found.gain.shape


def test_numbers_proven_elsewhere_are_taken():
    proof = constants_from_proof(DOUBLE, EACH_SECOND, window=2.0, sigma_bar=0.3, kappa=4)
    assert (proof["sigma_bar"].value, proof["kappa"].value) == (0.3, 4)
    assert margin(proof, [1.0]) > 1


def test_what_late_and_lost_samples_leave_of_sigma_bar_is_said():
    proof = constants_from_proof(DOUBLE, EACH_SECOND, window=3.0)
    left, own = proof.deviations, window_sigma(DOUBLE, EACH_SECOND, 3.0, start=0.0).deviations
    assert left == own
    assert 0 < left.late < proof["sigma_bar"].value
    assert "They are of exact times. If samples come up to 0.01 s early or late, sigma is at least" in proof.explain()
    assert left._rows()[-1] in proof._rows()
    assert proof.to_dict()["deviations"] == left.to_dict()
    given = constants_from_proof(DOUBLE, EACH_SECOND, window=3.0, sigma_bar=0.1).deviations
    assert given.late == given.late_wider == 0.1  # no more than what the proof takes
    again = constants_from_proof(DOUBLE, EACH_SECOND, window=3.0, sigma_bar=left.lost)  # with what a loss leaves
    assert again["mu_bar"].value > proof["mu_bar"].value
    stable = constants_from_proof(Plant([[-1.0]], [[1.0]]), EACH_SECOND)
    assert stable.deviations is None
    assert stable.to_dict()["deviations"] is None


def test_sampling_that_hides_an_oscillation_is_refused():
    with pytest.raises(CertificateError, match="Theorem 14 does not apply: windows up to") as caught:
        constants_from_proof(OSCILLATOR, PeriodicSchedule([np.pi]))
    assert caught.value.details["windows"]
    with pytest.raises(CertificateError, match="Theorem 14 does not apply: windows of 1 s"):
        constants_from_proof(DOUBLE, EACH_SECOND, window=1.0)


def test_unseen_unstable_mode_is_refused():
    plant = Plant(np.diag([0.5, 0.2]), [[1.0, 0.0]])
    with pytest.raises(NotDetectableError, match="Not detectable"):
        constants_from_proof(plant, EACH_SECOND, window=2.0, sigma_bar=1.0)


def test_stiff_plant_breaks_the_paper_chain_but_not_the_tightened_one():
    plant = Plant([[0.0, 300.0], [-300.0, 0.0]], [[1.0, 0.0]])
    schedule = PeriodicSchedule([0.7, 0.3141])
    with pytest.raises(CertificateError, match="beyond floating point: these constants say") as caught:
        constants_from_proof(plant, schedule)
    assert caught.value.details["exponent"] > 300
    proof = constants_from_proof(plant, schedule, variant="tightened", detectability=certify_detectability(plant, 0.5))
    assert margin(proof, schedule.gaps) > 1


def test_constants_beyond_floating_point_are_refused():
    with pytest.raises(CertificateError, match=r"of the proof is .* beyond floating point"):
        constants_from_proof(DOUBLE, EACH_SECOND, window=2.0, sigma_bar=1e-100)


def test_wrong_arguments_are_refused():
    with pytest.raises(ArgumentError, match='`variant` must be "paper" or "tightened"'):
        constants_from_proof(DOUBLE, EACH_SECOND, variant="improved")
    with pytest.raises(ArgumentError, match="`schedule` must have at least one sample"):
        constants_from_proof(DOUBLE, Schedule([]))
    with pytest.raises(ArgumentError, match="`window` must be positive"):
        constants_from_proof(DOUBLE, EACH_SECOND, window=0.0)
    with pytest.raises(ArgumentError, match="`name` must be one of q, lambda_max_P"):
        constants_from_proof(DOUBLE, EACH_SECOND, gain=[[2.0], [1.0]])["sigma"]


def test_failing_riccati_equation_ends_the_sweep(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError("no")

    monkeypatch.setattr(gain_sweep, "stationary_covariance", fails)
    with pytest.raises(SolverError, match="No observer gain of the sweep"):
        constants_from_proof(DOUBLE, EACH_SECOND)


def test_every_constant_has_a_formula_and_a_source_and_is_exported():
    proof = reference("four states", "paper")
    table, latex = proof.to_markdown(), proof.to_latex()
    for constant in proof.constants:
        assert constant.formula
        assert constant.source
        assert constant.name in table
        assert constant.formula in latex
    names = list(proof.constants.names())
    assert len(set(names)) == len(names)
    assert latex.count("\\\\") == len(names) + 1
    assert "horizon of more than" in proof.explain()
    assert proof.horizon in [c["value"] for c in proof.to_dict()["constants"]]
    assert "mu_bar" in str(proof)
    assert str(proof["mu_bar"]).startswith("mu_bar = ")
    assert "Theorems 5, 10, 14, 16" in proof.claim.theorem


def test_certificate_carries_the_weights_and_passes():
    certificate = certify_from_proof(OSCILLATOR, EACH_SECOND)
    proof = reference("oscillator", "paper")
    np.testing.assert_array_equal(certificate.P2, proof.P2)
    # the certificate adds its own resolution of lambda, a thousandth
    assert proof.horizon <= certificate.horizon("paper").minimum <= proof.horizon * (1 + 1e-3)
    assert certificate.verify().passed


def test_constants_over_an_interval_are_proven_maxima():
    from sampling_design.certificates.paper.observable_case import largest_flow

    rng = np.random.default_rng(5)
    for _ in range(10):
        n = rng.integers(1, 5)
        A, M, N = rng.normal(size=(n, n)) * 2, rng.normal(size=(2, n)), rng.normal(size=(n, 2))
        upper, lower, _ = largest_flow(M, A, N, 2.0)
        seen = largest_on_a_grid(M, A, N, 2.0, 801)
        assert seen <= upper <= 1.0011 * max(lower, seen)


def test_maximum_between_grid_points_is_not_missed():
    from sampling_design.certificates.paper.observable_case import largest_flow

    # |y| = |sin(40 s)| e^{-s}-like swing whose peak lies at 0.0389, off every dyadic grid point of the first levels
    A = np.array([[-1.0, 40.0], [-40.0, -1.0]])
    upper, _, at = largest_flow(np.array([[1.0, 0.0]]), A, np.array([[0.0], [1.0]]), 10.0)
    peak = np.arctan(40.0) / 40
    assert upper >= np.sin(40 * peak) * np.exp(-peak)
    assert at == pytest.approx(peak, abs=1e-2)


def test_exhausted_cells_leave_a_proven_bound(monkeypatch):
    from sampling_design.certificates.paper.observable_case import largest_flow

    monkeypatch.setattr("sampling_design.certificates.paper.observable_case.CELLS", 200)
    A = np.array([[-1e6, 1e6], [0.0, -0.1]])
    upper, _, _ = largest_flow(np.ones((1, 2)), A, np.eye(2), 10.0)
    assert 2.0 - 1e-5 <= upper < 10.0
    assert largest_flow(np.zeros((1, 0)), np.zeros((0, 0)), np.zeros((0, 1)), 1.0)[0] == 0.0


def test_a_plant_without_states_has_no_proof_and_its_horizons_say_so():
    empty, schedule = Plant(np.zeros((0, 0)), np.zeros((1, 0))), PeriodicSchedule([1.0])
    with pytest.raises(ArgumentError, match="`plant` must have at least one state: of none the paper's proof"):
        constants_from_proof(empty, schedule)
    assert "at least one state" in str(four_horizons(empty, schedule).rows[0].note)
