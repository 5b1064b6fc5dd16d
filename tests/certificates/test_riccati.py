"""The information recursion against least squares, its supremum against a dense scan."""

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.exact import riccati
from sampling_design.certificates.exact.riccati import periodic_riccati_solution, refine, supremum, sweep
from sampling_design.certificates.exact.riccati_peak import at_peak, located
from sampling_design.certificates.exact.window_problem import noise_input, window_problem
from sampling_design.certificates.families.certify_family import certify_family
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.numerics.filtering import joint_update, measurement_update, propagate
from sampling_design.plants.plant import Signals
from tests.cases import few
from tests.oracles import riccati as oracle


def random_case(seed, n=3, p=2, q=2):
    rng = np.random.default_rng(seed)
    plant = Plant(rng.normal(size=(n, n)) / 2, rng.normal(size=(p, n)), G=rng.normal(size=(n, q)))
    square = [rng.normal(size=(k, k)) for k in (n, q, p, p)]
    P2, Qw, R, Qv = (M @ M.T + np.eye(len(M)) for M in square)
    return plant, P2, Qw, R, Qv, rng


def information(problem, times, t):
    """Pi(t) of the window from 0, in the plant's coordinates."""
    Y, now = np.eye(problem.size), 0.0
    for k, tau in enumerate(times):
        F, W = problem.flow([tau - now])
        Y, now = measurement_update(propagate(Y, F[0], W[0]), problem.rows[k]), tau
    F, W = problem.flow([t - now])
    return problem.root @ np.linalg.inv(propagate(Y, F[0], W[0])) @ problem.root.T


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ends_with_sample", [False, True])
def test_information_is_the_least_squares_value(seed, ends_with_sample):
    plant, P2, Qw, R, Qv, rng = random_case(seed)
    times = np.sort(rng.uniform(0.2, 1.5, 3))
    t = times[-1] if ends_with_sample else 1.8
    eta = 0.4
    found = information(window_problem(plant, Schedule(times), P2, Qw, R, Qv, eta), times, t)
    args = (plant.A, [plant.C] * 3, times, plant.G, P2, Qw, R, Qv, eta, t)
    one, two = (oracle.brute_force_information(*args, steps) for steps in (24, 48))
    richardson = (4 * two - one) / 3
    assert np.linalg.norm(two - found) < 0.3 * np.linalg.norm(one - found)  # order two
    assert np.linalg.norm(richardson - found) < 1e-6 * np.linalg.norm(found)
    assert np.linalg.eigvalsh(two - found)[0] > -1e-9  # piecewise-constant noise can only cost more


def test_partial_outputs_use_the_measured_block_of_the_covariance():
    plant, P2, Qw, R, Qv, _ = random_case(7)
    mask = [[1, 0], [0, 1], [1, 1]]
    times = np.array([0.3, 0.9, 1.4])
    problem = window_problem(plant, Schedule(times, mask), P2, Qw, R, Qv, 0.3)
    V = np.linalg.inv(R) + np.linalg.inv(Qv)
    for row, seen in zip(problem.rows, mask, strict=True):
        k = np.flatnonzero(seen)
        J = plant.C[k].T @ np.linalg.solve(V[np.ix_(k, k)], plant.C[k])
        physical = problem.root @ row.T @ row @ problem.root.T
        assert np.allclose(physical, J, atol=1e-12)


@pytest.mark.parametrize("first", few([None, 0.0, 2.3], 2))
def test_supremum_is_that_of_a_dense_scan(first):
    A = np.array([[-0.5, -1.1], [1.5, 0.6]])
    plant, schedule = Plant(A, [[0.5, -0.4]]), PeriodicSchedule([1.2, 0.7, 0.6], first)
    made = certify(plant, schedule, eta=0.3, P2=[[0.3, -0.3], [-0.3, 2.1]])
    data = made.to_dict()
    dense, _, _ = oracle.worst_ratio(data, made.P2, fine=32)
    assert dense <= made.lam * (1 + 1e-3)
    assert made.lam == pytest.approx(dense, rel=2e-3)
    assert oracle.worst_ratio(data, made.P2, samples=True, fine=64)[0] == pytest.approx(made.lam_samples, rel=1e-3)
    assert oracle.witness_ratio(data) == pytest.approx(made.witness.ratio, rel=1e-9)


def test_worst_start_may_lie_inside_a_gap():
    plant = Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4]])
    made = certify(plant, PeriodicSchedule([1.2]), eta=0.3, P2=[[0.3, -0.3], [-0.3, 2.1]])
    assert made.lam_samples == pytest.approx(34.28, abs=0.01)
    assert made.lam > 39.18
    faster = Plant([[0.0, 3.0], [-3.0, 0.0]], [[1.0, 0.0]])
    other = certify(faster, PeriodicSchedule([1.0]), eta=0.5, P2=np.diag([0.1, 1.0]), Qw=100 * np.eye(2))
    assert other.lam_samples == pytest.approx(13.1, abs=0.05)
    assert other.witness.ratio == pytest.approx(31.206, abs=0.01)
    assert other.witness.start == pytest.approx(0.409, abs=0.01)


def test_periodic_riccati_solution_is_a_fixed_point_and_windows_tend_to_it():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    problem = window_problem(
        plant, PeriodicSchedule([0.8, 1.1]), np.eye(2), np.eye(2), 2 * np.eye(1), 2 * np.eye(1), 0.4
    )
    solution = periodic_riccati_solution(problem)
    F, W = problem.flow(problem.gaps)
    assert np.allclose(measurement_update(propagate(solution[0], F[1], W[1]), problem.rows[1]), solution[1], rtol=1e-8)
    assert np.allclose(measurement_update(propagate(solution[1], F[0], W[0]), problem.rows[0]), solution[0], rtol=1e-8)


def test_a_large_prior_is_bound_by_the_periodic_riccati_solution():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    made = certify(plant, PeriodicSchedule([1.0]), eta=0.4, P2=1e4 * np.eye(2))
    dense, _, _ = oracle.worst_ratio(made.to_dict(), made.P2, fine=16, periods=40)
    assert made.lam == pytest.approx(dense, rel=1e-3)
    assert made.witness.ratio == pytest.approx(made.lam, rel=1e-3)


def test_an_unseen_growing_mode_never_settles():
    plant = Plant([[0.1, 0.0], [0.0, 0.2]], [[1.0, 0.0]])
    problem = window_problem(plant, PeriodicSchedule([1.0]), np.eye(2), np.eye(2), np.eye(1), np.eye(1), 0.4)
    with pytest.raises(SolverError, match="the information did not settle over 2"):
        periodic_riccati_solution(problem)


def test_located_finds_the_window_again():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    problem = window_problem(plant, PeriodicSchedule([0.5, 1.0, 0.7]), np.eye(2), np.eye(2), np.eye(1), np.eye(1), 0.4)
    peak, _ = supremum(problem)
    _, t, start = at_peak(problem, peak)
    again = located(problem, start, t)
    assert (again.index, again.step) == (peak.index, peak.step)
    assert again.remaining == pytest.approx(peak.remaining)
    assert again.fraction == pytest.approx(peak.fraction)
    assert again.value == pytest.approx(peak.value)


def lingering():
    """A slow chain that is hardly measured or driven: windows rise for a hundred samples, and settle below."""
    plant = Plant([[-0.01, 0.05], [0.0, -0.01]], [[1e-3, 0.0]], G=1e-4 * np.eye(2))
    return window_problem(plant, PeriodicSchedule([1.0]), np.eye(2), np.eye(2), np.eye(1), np.eye(1), 1e-3)


def test_a_window_that_is_located_after_many_samples_has_its_value():
    """No finer look is taken there: without a value the proof would be tried again with the same lambda."""
    problem = lingering()
    far = located(problem, 0.0, 300.0)
    assert far.step > riccati.LONGEST_REFINED
    assert (
        refine(problem, far, 0.0).value == far.value == pytest.approx(np.linalg.eigvalsh(at_peak(problem, far)[0])[-1])
    )


def test_where_the_work_ends_before_the_peak_the_highest_window_is_followed_further():
    problem = lingering()
    whole, short = supremum(problem), supremum(problem, work=(work := WorkLimit(1e4)))
    assert work.over
    assert 100 > whole[0].step > 80
    values = [peak.value for peak in whole]
    assert [peak.value for peak in short] == pytest.approx(values, rel=riccati.ATTAINED_RTOL)


def test_a_finite_schedule_ends_its_windows():
    plant = Plant([[0.3]], [[1.0]])
    problem = window_problem(plant, Schedule([1.0, 2.0]), np.eye(1), np.eye(1), np.eye(1), np.eye(1), 0.4)
    found = sweep(problem, np.array([0, 1]), np.array([1.0, 1.0]))
    assert [peak.step <= 0 for peak in found] == [True, True]


@pytest.mark.parametrize("tiny", [1e-13, 1e-6, 1.0, 1e9])
@pytest.mark.parametrize("weight", [1e-30, 1.0, 1e30])
def test_no_direction_of_the_disturbance_is_dropped(tiny, weight):
    """A disturbance that enters by 1e-13 with weight 1e-30 is one that enters by 100 with weight one."""
    H = noise_input(np.diag([1.0, tiny]), np.diag([1.0, weight]))
    assert np.allclose(H @ H.T, np.diag([1.0, tiny**2 / weight]), rtol=1e-14, atol=0)
    rng = np.random.default_rng(4)
    G, root, units = rng.standard_normal((3, 4)), rng.standard_normal((4, 4)), 10.0 ** np.array([9, -12, 3, 0])
    H = noise_input(G * units, root @ root.T * np.outer(units, units))
    assert np.allclose(H @ H.T, G @ np.linalg.solve(root @ root.T, G.T), rtol=1e-9)


@pytest.mark.parametrize("weight", [0.0, -1.0])
def test_a_direction_without_weight_is_refused_in_one_sentence(weight):
    plant, schedule = Plant(np.diag([0.1, 0.1]), np.eye(2), G=np.diag([1.0, 1e-13])), PeriodicSchedule([1.0])
    words = rf"`Qw` must be positive definite, got Qw\[1, 1\] = {weight} on its diagonal. A direction without weight"
    with pytest.raises(ArgumentError, match=words):
        certify(plant, schedule, eta=0.2, P2=np.eye(2), Qw=np.diag([1.0, weight]))
    with pytest.raises(ArgumentError, match=words):
        certify_family(plant, GapRange(0.5, 1.0), eta=0.2, P2=np.eye(2), Qw=np.diag([1.0, weight]))
    with pytest.raises(ArgumentError, match=r"got least eigenvalue .* once its diagonal is one. A direction without"):
        certify(plant, schedule, eta=0.2, P2=np.eye(2), Qw=[[1e-20, 1.0], [1.0, 1e20]])


@pytest.mark.parametrize("weight", [1e-30, 1e-26, 1.0])
def test_a_tiny_disturbance_without_trust_counts_in_full(weight):
    """lam is that of the plant in which this disturbance is written in its own unit."""
    A, C, one = np.diag([0.1, 0.1]), np.eye(2), np.eye(2)

    def lam(G, Qw):
        problem = window_problem(Plant(A, C, G=np.diag(G)), PeriodicSchedule([1.0]), one, np.diag(Qw), one, one, 0.2)
        return supremum(problem)[0].value

    found = lam([1.0, 1e-13], [1.0, weight])
    assert found == pytest.approx(lam([1.0, 1e-13 / np.sqrt(weight)], [1.0, 1.0]), rel=1e-9)
    assert found > 12000 or weight > 1e-30


@pytest.mark.parametrize("scale", [(2.0**10, 2.0**-10), (2.0**20, 2.0**-10), (2.0**30, 2.0**-20)])
def test_units_of_the_states_change_nothing(scale):
    # G Qw^-1 G' has eigenvalues whose ratio is below eps there: none of them may be lost
    D, A, C = np.diag(scale), np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]])
    there = Plant(D @ A @ np.linalg.inv(D), C @ np.linalg.inv(D), G=D, states=Signals(["x", "v"], scales=scale))
    schedule = PeriodicSchedule([1.0, 0.7])
    here = certify(Plant(A, C), schedule, eta=0.4, P2=np.eye(2), Qw=np.eye(2))
    moved = certify(there, schedule, eta=0.4, P2=np.linalg.inv(D @ D), Qw=np.eye(2))
    assert moved.lam == pytest.approx(here.lam, rel=1e-12)


def test_outputs_that_are_nearly_exact_settle_where_the_recursion_does():
    """The noise is 1e-14 of what the disturbance does in a gap: composed periods count it against that."""
    A = np.array([[-0.3, 1.0, 0.0], [-1.0, -0.3, 0.5], [0.0, 0.2, -0.7]])
    plant = Plant(A, 1e14 * np.array([[1.0, 0.4, 0.2], [0.3, -1.0, 0.5]]), G=np.diag([1.0, 1e-3, 1e-6]))
    problem = window_problem(plant, PeriodicSchedule([1.0, 0.6]), np.eye(3), np.eye(3), np.eye(2), np.eye(2), 0.3)
    flows = problem.flow(problem.gaps)
    Y = np.eye(3)
    for _ in range(400):
        for i in range(2):
            Y = measurement_update(propagate(Y, flows[0][i], flows[1][i]), problem.rows[i])
    size = np.sqrt(np.diag(Y))
    assert np.all(np.abs(periodic_riccati_solution(problem)[-1] - Y) <= 1e-6 * size * size[:, None])


def test_the_closed_loop_of_a_sample_is_carried_along():
    """I - K C with the best gain of all outputs together, from one row after the other."""
    rng = np.random.default_rng(5)
    rows, half, Phi = rng.normal(size=(2, 4)), rng.normal(size=(3, 4, 4)), rng.normal(size=(3, 4, 4))
    Y = half @ np.swapaxes(half, 1, 2)
    K = np.swapaxes(np.linalg.solve(rows @ Y @ rows.T + np.eye(2), rows @ Y), 1, 2)
    after, carried = joint_update(Y, np.broadcast_to(rows, (3, 2, 4)), Phi)
    assert carried == pytest.approx((np.eye(4) - K @ rows) @ Phi, rel=1e-9, abs=1e-9)
    assert after == pytest.approx((np.eye(4) - K @ rows) @ Y, rel=1e-9, abs=1e-9)
    assert joint_update(Y, np.broadcast_to(rows, (3, 2, 4)), None)[1] is None
