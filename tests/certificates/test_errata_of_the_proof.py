"""The printed formulas of the paper, evaluated: each is shown wrong by numbers where ours holds (theory section 2)."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg as sla

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.paper.proof_constants import constants_from_proof
from sampling_design.certificates.paper.restarts import output_predictor, restart_times
from sampling_design.errors import ArgumentError, CertificateError, NotDetectableError
from tests.oracles.proof_constants import partition_exists, riccati_margin, worst_28

DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
EACH_SECOND = PeriodicSchedule([1.0])


@cache
def paper_proof():
    return constants_from_proof(OSCILLATOR, EACH_SECOND)


def free_output(plant, chi, times):
    return np.array([(plant.C @ sla.expm(plant.A * s) @ chi)[0] for s in times])


def output_energy(plant, chi, start, stop, power=2):
    grid = np.linspace(start, stop, 4001)
    y = np.abs(free_output(plant, chi, grid)) ** power
    return float(np.sum((y[1:] + y[:-1]) / 2) * (grid[1] - grid[0]))


def test_e1_printed_19_has_no_discount_and_holds_for_an_undetectable_plant():
    plant, P, chi = Plant([[0.0]], [[0.0]]), 1.0, 2.0
    for t in (0.0, 1.0, 100.0):
        x_t, y, w = chi, 0.0, 0.0
        printed = P * chi**2 + t * (w**2 + y**2)
        assert P * x_t**2 <= printed  # the printed (19) is satisfied ...
    eta, alpha_x = 0.1, 1e3
    assert P * chi**2 > alpha_x * chi**2 * np.exp(-eta * 100)  # ... Definition 1 is not, whatever alpha_x and eta > 0
    with pytest.raises(NotDetectableError, match="Not detectable"):
        certify_detectability(plant)


@pytest.mark.parametrize("seed", range(20))
def test_e1_with_the_discount_the_constants_of_the_proof_hold(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    plant = Plant(rng.normal(size=(n, n)), rng.normal(size=(1, n)))
    found = detectability_from_proof(plant)
    assert found.eta > 0
    assert found.verify().passed


def test_e3_printed_4_fails_for_a_bump_of_noise_between_samples():
    """With chi = 0, w = 0 the printed left side holds noise, the right side only noise at samples."""
    proof = paper_proof()
    t_star, t = proof["t_star"].value, 6.0
    grid = np.linspace(0.0, t, 60_001)
    v = np.where(np.abs(grid - 3.5) < 0.4, np.cos(np.pi * (grid - 3.5) / 0.8) ** 2, 0.0)
    y = v  # x = 0 throughout
    inside = grid >= t_star
    printed_left = np.sum((proof["c_2"].value * y**2 + v**2)[inside]) * (grid[1] - grid[0])
    at_samples = v[np.isclose(grid % 1.0, 0.0, atol=1e-9) | np.isclose(grid % 1.0, 1.0, atol=1e-9)]
    printed_right = np.sum(1e30 * at_samples**2)  # any alpha_y, alpha_v: their argument is 0 at every sample
    assert at_samples.size == 7
    assert printed_left > 1.0 > printed_right
    noise_free_left = np.sum((proof["c_2"].value * (y - v) ** 2)[inside])
    assert noise_free_left <= printed_right  # the repaired left side holds the noise-free output
    assert proof.R[0, 0] == proof.Qv[0, 0] == 2 * proof["R0"].value  # and noise enters where samples do


def test_e3_noise_weights_return_the_noise_free_weight():
    proof = constants_from_proof(OSCILLATOR, EACH_SECOND, variant="tightened")
    both = np.linalg.inv(np.linalg.inv(proof.R) + np.linalg.inv(proof.Qv))
    assert both[0, 0] == pytest.approx(proof["R0"].value)


@pytest.mark.parametrize("count", [1, 5, 20, 50])
def test_e4_printed_partition_does_not_exist_however_large_t_star_is(count):
    t_star = count + 0.5
    t = 3 * t_star + 0.1  # t - t* = 2 t* + 0.1
    samples = np.arange(1.0, t + 1)
    assert not partition_exists(samples, t, t_star, last_may_be_short=False)
    assert partition_exists(samples, t, t_star, last_may_be_short=True)
    points = restart_times(EACH_SECOND, t, t_star)
    assert np.all(np.diff(points)[:-1] >= t_star - 1e-9)
    assert np.all(np.diff(points) <= 2 * t_star + 1e-9)


def test_e4_printed_partition_fails_for_a_fifth_of_all_times():
    for t_star in (1.5, 10.5, 50.5):
        ends = np.linspace(t_star, 6 * t_star, 400)[1:]
        samples = np.arange(1.0, 7 * t_star)
        fails = np.mean([not partition_exists(samples, t, t_star, last_may_be_short=False) for t in ends])
        assert 0.15 < fails < 0.35


@pytest.mark.parametrize("seed", range(60))
def test_e4_repaired_partition_exists_on_random_schedules(seed):
    rng = np.random.default_rng(seed)
    gaps = rng.uniform(0.05, 2.0, 60)
    schedule = Schedule(np.cumsum(gaps))
    t_star = float(gaps.max()) * rng.uniform(1.0, 3.0)
    for t in rng.uniform(t_star * 1.001, schedule.times[-1], 20):
        points = restart_times(schedule, t, t_star)
        lengths = np.diff(points)
        assert points[0] == t_star
        assert points[-1] == t
        assert np.all(lengths[:-1] >= t_star * (1 - 1e-12))
        assert np.all((lengths > 0) & (lengths <= 2 * t_star * (1 + 1e-12)))
        for point in points[1:-1]:
            assert np.min(np.abs(schedule.times - (point - t_star))) < 1e-9


def test_e5_closed_windows_count_a_sample_three_times_half_open_ones_twice():
    t_star, points = 2.0, restart_times(EACH_SECOND, 9.5, 2.0)
    np.testing.assert_array_equal(points, [2.0, 4.0, 6.0, 9.5])
    starts, ends = points[:-1] - t_star, points[1:]
    closed = [(s, sum(a <= s <= b for a, b in zip(starts, ends, strict=True))) for s in np.arange(0.0, 10.0)]
    half_open = [sum(a < s <= b for a, b in zip(starts, ends, strict=True)) for s in np.arange(0.0, 10.0, 0.125)]
    assert max(count for _, count in closed) == 3  # the printed factor 2 is short for the sample at 4
    assert max(half_open) == 2


def test_e6_t_star_must_reach_the_longest_gap():
    schedule = Schedule([0.5, 1.0, 1.5, 2.0, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0])
    with pytest.raises(CertificateError, match="must be at least the longest gap"):
        restart_times(schedule, 7.9, 1.0)  # t* = T = 1 as printed
    assert restart_times(schedule, 7.9, 3.0)[-1] == 7.9
    with pytest.raises(ArgumentError, match="must be later than `t_star`"):
        restart_times(schedule, 1.0, 3.0)


def test_e8_dividing_p1_by_two_is_not_needed():
    proof = constants_from_proof(DOUBLE, EACH_SECOND)
    P = proof.detectability.P
    np.testing.assert_allclose(proof.P1, P / 2)
    weights = (P, proof.P2, proof.Qw, proof.R, proof.Qv, proof.eta)
    assert riccati_margin(DOUBLE.A, DOUBLE.C, DOUBLE.G, [1.0], *weights) > 1


def test_e10_printed_linear_alpha_fails_at_large_amplitude():
    proof = paper_proof()
    T, kappa, mu_bar, c_2 = (proof[key].value for key in ("T", "kappa", "mu_bar", "c_2"))
    samples, t = np.arange(1.0, 7.0), 6.0
    for amplitude, printed_holds in ((1.0, True), (1000.0, False)):
        chi = amplitude * np.array([1.0, 0.0])
        left = c_2 * output_energy(OSCILLATOR, chi, T, t)
        y = np.abs(free_output(OSCILLATOR, chi, samples))
        printed = np.sum(4 * T * mu_bar**2 * kappa * y)
        assert (left <= printed) == printed_holds
        assert left <= np.sum(proof["alpha_y"].value * y**2)


def test_e10_printed_alpha_without_c_2_fails_for_a_scaled_certificate():
    """(P, c_w, c_y) times 100 certifies as well; the printed alpha_y does not notice."""
    small = detectability_from_proof(OSCILLATOR)
    large = DetectabilityCertificate(OSCILLATOR, 100 * small.P, small.eta, 100 * small.c_w, 100 * small.c_y)
    assert large.verify().passed
    proof = constants_from_proof(OSCILLATOR, EACH_SECOND, detectability=large)
    T, kappa, mu_bar, c_2 = (proof[key].value for key in ("T", "kappa", "mu_bar", "c_2"))
    k_w = proof["k_w"].value
    samples, A, C, G = np.arange(0.5, 6.0), OSCILLATOR.A, OSCILLATOR.C, OSCILLATOR.G
    printed_w, printed_y = 4 * T**2 * c_2 * (mu_bar * kappa + 1) ** 2 * k_w**2, 4 * T * mu_bar**2 * kappa
    assert worst_28(A, C, G, T, 6.0, samples, printed_w, printed_y, c_2) > 1
    assert worst_28(A, C, G, T, 6.0, samples, proof["alpha_w"].value, proof["alpha_y"].value, c_2) < 0.1


def test_e11_fubini_and_h_as_a_whole_are_several_times_tighter_and_still_hold():
    paper = constants_from_proof(OSCILLATOR, EACH_SECOND, gain=[[1.0], [1.0]])
    T, kappa, mu_bar, c_2, k_w = (paper[key].value for key in ("T", "kappa", "mu_bar", "c_2", "k_w"))
    tight_w = 2 * T**2 * c_2 * (mu_bar * np.sqrt(kappa) + 1) ** 2 * k_w**2
    tight_y = 2 * T * c_2 * mu_bar**2
    assert paper["alpha_y"].value / tight_y == pytest.approx(2 * kappa)
    assert 3 < paper["alpha_w"].value / tight_w < 10
    plant, samples = OSCILLATOR, np.arange(0.5, 6.0)
    assert worst_28(plant.A, plant.C, plant.G, T, 6.0, samples, tight_w, tight_y, c_2) <= 1


def test_e28_quadratic_form_is_no_function_of_the_norm():
    found = DetectabilityCertificate(Plant(-np.eye(2), np.eye(2)), np.diag([1.0, 9.0]), 0.5, 100.0, 1.0)
    values = [x @ found.P @ x for x in np.eye(2)]
    assert values == [1.0, 9.0]  # the printed alpha(|x|) = x'Px would have to be one number on the unit sphere
    assert found.verify().passed
    assert found.overshoot == 9.0  # the constants use lambda_min and lambda_max instead


def test_lemma_12_gives_the_output_at_the_end_of_the_window():
    plant = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.5], [0.0, 1.0]])
    schedule = Schedule([0.3, 0.9, 1.4, 2.0], [[1, 0], [1, 1], [0, 1], [1, 0]])
    x = np.array([0.4, -1.3])  # state at the window's start 0.2
    rows = [
        (plant.C @ plant.transition(s - 0.2) @ x)[mask]
        for s, mask in zip(schedule.times, schedule.outputs, strict=True)
        if s <= 1.7
    ]
    H = output_predictor(plant, schedule, t=1.7, window=1.5)
    np.testing.assert_allclose(H @ np.concatenate(rows), plant.C @ plant.transition(1.5) @ x, atol=1e-12)
    with pytest.raises(CertificateError, match="do not determine the state"):
        output_predictor(OSCILLATOR, PeriodicSchedule([np.pi]), t=10.0, window=9.0)
