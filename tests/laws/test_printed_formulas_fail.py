"""Printed formulas that no other law evaluates: each is put in, and fails where the corrected one holds."""

import numpy as np
import pytest

from sampling_design import KalmanFilter, MovingHorizonEstimator, PeriodicSchedule, Plant, certify
from sampling_design.certificates.detectability.best_rate import detectability_from_proof
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SLOW = Plant([[-0.01]], [[1.0]])
SAMPLES = np.array([0.5, 1.7, 2.2, 4.0, 4.9, 6.3, 7.1, 9.0])


def since_last(t):
    """delta_t of the appendix."""
    return t - max(0.0, *SAMPLES[t >= SAMPLES], 0.0)


def window_length(t, M):
    """M_t as it is right: min(t, M + delta_t)."""
    return min(t, M + since_last(t))


def test_e2_with_the_maximum_windows_start_before_time_zero_and_then_never_move():
    M, times = 3.0, np.arange(0.5, 9.0, 0.125)
    printed = np.array([t - max(t, M + since_last(t)) for t in times])
    assert printed.min() < -2.0
    assert np.all(printed[times > M + 2.0] == 0.0)  # full information for ever
    right = np.array([t - window_length(t, M) for t in times])
    assert right.min() == 0.0
    assert right.max() > 3.0


def test_e7_with_the_exponent_as_argument_gamma_1_does_not_vanish_at_zero():
    c_w, r = detectability_from_proof(OSCILLATOR).c_w, 2.0
    printed, right = (lambda s: c_w * r**2), (lambda s: c_w * s**2)
    assert right(0.0) == 0.0
    assert printed(0.0) > 0.0  # no function of class K
    assert printed(100.0) < right(100.0)  # and too small where it matters


def test_e9_before_t_star_the_printed_bound_is_negative_for_a_disturbance_of_the_future():
    """x = 0 until t, w = 1 on (t, t*]: int_{t*}^t gamma_1 runs backwards and outweighs all that is added."""
    found = detectability_from_proof(SLOW, [[0.0]])
    P, c_w, eta = found.P[0, 0], found.c_w, found.eta
    t_star, t, L_f = 1.0, 0.2, 0.01
    after = np.linspace(t, t_star, 2001)
    step = after[1] - after[0]
    backwards = -c_w * np.sum(np.exp(-eta * (t - after))) * step
    gamma_v = P * (2 * t_star * np.exp(L_f * t_star)) ** 2  # of L_f rho(1) = 1
    future = gamma_v / t_star * np.exp(eta * t_star) * np.sum(np.exp(-eta * (t - after))) * step
    assert backwards + future < 0.0  # the printed right side ...
    x = 0.0
    assert P * x**2 == 0.0  # ... cannot bound the left one; with w truncated at t both are 0


def test_e12_a_rate_above_that_of_the_certificate_is_never_reached():
    """Printed: eta <= eta~. A certified error falls at eta~ < eta, and eta~ >= eta would contradict its own formula."""
    made = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
    for M in (5.0, 10.0, 100.0):
        printed_step = np.exp(-0.4 * M) >= np.exp(-made.horizon(length=M).eta_tilde * M)
        assert not printed_step
        assert np.exp(-0.4 * M) <= np.exp(-made.horizon(length=M).eta_tilde * M)


def test_e13_at_rate_zero_the_chain_of_windows_does_not_contract():
    made = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
    least = made.horizon("paper").minimum
    rate = made.eta - np.log(4 * made.horizon("paper").lam ** 2) / least
    assert rate == pytest.approx(0.0, abs=1e-12)  # admitted as printed
    assert np.exp(-rate * least) == pytest.approx(1.0)  # the factor per window: no contraction
    with pytest.raises(CertificateError, match="this theorem needs M >"):
        made.horizon("paper", length=least)


def test_e14_with_rate_zero_the_open_loop_predictor_would_be_exponentially_stable():
    """x' = w without any measurement used: |e(t)| <= |e(0)| + int |w| holds with lambda = 0, C = r = 1."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        w, h, e0 = rng.normal(size=2000), 0.01, rng.normal()
        e = e0 + h * np.cumsum(w)
        printed = abs(e0) + h * np.cumsum(np.abs(w))
        assert np.all(np.abs(e) <= printed + 1e-12)
    C, rate, t = 1e6, 0.01, 1e4
    assert abs(1.0) > C * np.exp(-rate * t)  # with any rate above 0 it fails for e(0) = 1, w = 0
    with pytest.raises(CertificateError, match="the eigenvalue 0 is observable from no sample"):
        certify(Plant([[0.0]], [[0.0]]), PeriodicSchedule([1.0]), eta=0.1)


def test_e15_bounding_gamma_3_leaves_gamma_bar_3_free():
    s = np.linspace(0.1, 50.0, 500)
    gamma_3, gamma_bar_3 = s**2, np.expm1(s)
    assert np.max(gamma_3 / s**2) <= 1.0  # the printed condition holds with C = 1, r = 2 ...
    assert np.max(gamma_bar_3 / s**2) > 1e15  # ... while the function it should bound outgrows every power


def test_e16_the_printed_index_charges_the_truth_for_samples_it_explains():
    """(15) with tau + t - M, t the present between samples, against tau + t_i - M: only the latter costs nothing."""
    M, x0 = 3.0, np.array([1.0, -0.4])
    t_i = SAMPLES[5]
    start = t_i - M

    def y(t):
        return float((OSCILLATOR.C @ OSCILLATOR.transition(t) @ x0)[0])

    def residuals(now):
        tau = SAMPLES[(start <= SAMPLES) & (t_i >= SAMPLES)] - now + M
        at = OSCILLATOR.transition(start) @ x0  # the truth as the window's first state
        return [float((OSCILLATOR.C @ OSCILLATOR.transition(s) @ at)[0]) - y(now - M + s) for s in tau], tau

    right, tau = residuals(t_i)
    assert np.max(np.abs(right)) < 1e-12
    assert np.all((tau >= 0) & (tau <= M))
    printed, tau = residuals(t_i + 0.75)
    assert np.max(np.abs(printed)) > 0.1
    assert tau.min() < 0.0  # it even asks for the trajectory before the window


def test_e17_the_printed_sum_evaluates_the_noise_off_the_samples():
    t, M = 8.0, 2.5
    length = window_length(t, M)
    start = t - length
    zeta = SAMPLES[start <= SAMPLES][0] - start
    assert zeta > 0
    inside = SAMPLES[(start + zeta <= SAMPLES) & (t >= SAMPLES)]
    printed, right = inside - (t - length + zeta), inside - (t - length)
    assert np.min(np.abs(SAMPLES[:, None] - (right + t - length)), axis=0).max() < 1e-12
    assert np.min(np.abs(SAMPLES[:, None] - (printed + t - length)), axis=0).min() > 0.05


def test_e18_the_printed_chain_of_windows_reaches_negative_times():
    M = 3.0
    negative = 0
    for t in np.arange(M, 9.0, 0.1):
        k, printed = t, t
        while k >= M:
            printed, k = k - M - since_last(k), k - window_length(k, M)
        assert 0.0 <= k < M
        negative += printed < 0.0
    assert negative > 5


def test_e27_no_multiple_of_the_integral_bounds_the_maximum_of_a_disturbance():
    """A max-form of the stable part's bound is not of the form (16): bumps of height 1 and vanishing width."""
    ratios = [1.0 / width for width in (1e-1, 1e-3, 1e-6)]  # max |w|^2 over int |w|^2
    assert ratios[-1] > 1e5
    plant, proof = Plant([[-1.0]], [[1.0]]), detectability_from_proof(Plant([[-1.0]], [[1.0]]))
    for width in (1e-1, 1e-3, 1e-6):
        x = 1.0 - float(plant.transition(width)[0, 0])  # the state a bump leaves behind
        assert proof.P[0, 0] * x**2 <= proof.c_w * width  # the integral form holds


def test_e29_the_printed_weight_of_section_six_is_singular():
    Qw = 1.39e-3 * np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    assert np.linalg.eigvalsh(Qw)[0] == 0.0
    A = np.diag(-0.1 * np.arange(1.0, 7.0))
    C = np.array([[0.0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0]])
    with pytest.raises(ArgumentError, match="`Qw`"):
        certify(Plant(A, C), PeriodicSchedule([1.0]), eta=0.1, P2=np.eye(6), Qw=Qw)
    repaired = Plant(A, C, G=np.eye(6)[:, [0, 5]])
    made = certify(repaired, PeriodicSchedule([1.0]), eta=0.1, P2=np.eye(6), Qw=Qw[np.ix_([0, 5], [0, 5])])
    assert made.verify().passed


def test_e30_five_days_are_enough_for_hardly_any_certificate():
    eta, M = 0.35, 5.0
    assert np.exp(eta * M / 2) / 2 == pytest.approx(1.1994, abs=1e-4)  # the largest lambda that Theorem 9 admits
    assert 2 * np.log(2 * 1.0) / eta == pytest.approx(3.96, abs=1e-2)  # and its least horizon, lambda = 1
    made = certify(Plant([[-0.2]], [[1.0]]), PeriodicSchedule([1.0]), eta=eta, P2=[[1.0]])
    assert made.horizon("paper").lam > 1.1994  # one stable state, measured daily
    with pytest.raises(CertificateError, match="this theorem needs M >"):
        made.horizon("paper", length=M)


def test_e31_a_prior_updated_by_the_sample_at_zero_uses_it_twice():
    """d_1 = 0: sensitivity of xhat to y(0) with the given prior and with xhat(0) after its own update."""
    weights = {"eta": 0.4, "P2": np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]]}
    times = [0.0, 1.0, 2.0]

    def estimate(y0, prior):
        mhe = MovingHorizonEstimator(OSCILLATOR, horizon=5.0, prior=prior, cost=CostFunction(**weights))
        return [mhe.update(t, [y0 if t == 0 else 0.0]).x for t in times]

    once = np.array(estimate(1.0, [0.0, 0.0])[-1])
    updated = estimate(1.0, [0.0, 0.0])[0]
    twice = np.array(estimate(1.0, updated)[-1])  # as printed, x(0) after its update is the prior of the window at 0
    filtered = KalmanFilter(OSCILLATOR, prior=[0.0, 0.0], cost=CostFunction(**weights))
    exact = np.array([filtered.update(t, [1.0 if t == 0 else 0.0]).x for t in times][-1])
    np.testing.assert_allclose(once, exact, atol=1e-10)
    assert np.linalg.norm(twice) > 1.2 * np.linalg.norm(exact)


def test_e32_the_sample_at_the_windows_start_is_used_twice_by_the_closed_window():
    """Both costs keep (17); they differ by exactly that sample, and only the half-open window counts it once."""
    made = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2))
    M = 20.0
    bound = made.horizon("paper", length=M)
    for cost in ("paper", "certificate"):
        last = []
        for at in (-1.0, 3.0, 4.0):  # no noise, or a unit of it at the window's start, or just inside
            mhe = MovingHorizonEstimator(OSCILLATOR, made, horizon=M, cost=CostFunction(form=cost), prior=[0.0, 0.0])
            for t in range(1, 24):
                estimate = mhe.update(float(t), [1.0 if t == at else 0.0])
            last.append(estimate.x)
            noise = np.sqrt(2 * np.exp(-bound.eta_tilde * (23.0 - at))) if at > 0 else 0.0
            ratio = last[-1] @ made.P1 @ last[-1]
            assert ratio <= 4 * bound.lam * noise**2 * made.Qv[0, 0] + 1e-12
    schedule = PeriodicSchedule([1.0])
    assert len(schedule.between(3.0, 23.0).times) == 21
    assert len(schedule.between(3.0, 23.0, closed="right").times) == 20


def test_e33_a_window_shorter_than_the_gaps_satisfies_17():
    """Stable scalar plant, gaps 4, M = 1.5: printed out of reach (M >= d_max), and yet the bound holds."""
    plant, schedule = Plant([[-1.0]], [[1.0]]), PeriodicSchedule([4.0])
    made = certify(plant, schedule, eta=1.5, P2=[[0.01]])
    lam, M = made.lam_samples_proven, 1.5
    assert made.d_max == 4.0 > M
    assert 4 * lam**2 * np.exp(-made.eta * M) < 1.0
    rate = made.eta - np.log(4 * lam**2) / M
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(20):
        mhe = MovingHorizonEstimator(plant, made, horizon=M, cost=CostFunction(form="paper"), prior=[0.0])
        x = rng.normal()
        bound = x**2 * made.P2[0, 0]
        for k in range(1, 10):
            v = rng.normal()
            x, bound = x * np.exp(-4.0), bound * np.exp(-4.0 * rate) + 2 * v**2 * made.Qv[0, 0]
            estimate = mhe.update(4.0 * k, [x + v])
            worst = max(worst, made.P1[0, 0] * (x - estimate.x[0]) ** 2 / (4 * lam * bound))
    assert 0.0 < worst <= 1.0
