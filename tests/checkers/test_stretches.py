"""Along a stretch of time and over a cell of window starts the bounds hold; where Y rises they cost nothing."""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Certificate, PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.checkers import claims, numbers, sampled
from sampling_design.checkers.frame import largest
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.numerics.balls import BallFlow, ball, fallen, floats, matrix, precision
from tests.cases import few

SEEDS = 12


def drawn(seed):
    """Windows of weights that nobody has proven, in the coordinates of their P2; every third plant is stiff."""
    rng = np.random.default_rng([seed, 5])
    n = int(rng.integers(1, 5))
    fast = 10.0 ** rng.uniform(2, 4) if seed % 3 == 0 else 0.0
    side = rng.standard_normal(n) / np.sqrt(n)
    A = rng.standard_normal((n, n)) - fast * np.outer(side, side)
    plant = Plant(A, rng.standard_normal((1, n)), G=rng.standard_normal((n, 2)))
    root = rng.standard_normal((n, n))
    P2, eta = root @ root.T + 0.1 * np.eye(n), float(rng.uniform(0.1, 2.0))
    weights = {"P1": P2 / 2, "P2": P2, "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]]}
    made = Certificate.from_matrices(plant, PeriodicSchedule([0.7, 1.1]), **weights, eta=eta, lam=2.0)
    file = claims.certificate(made.to_dict())
    problem = numbers.problem(file.plant, file.weights)
    return rng, sampled.Windows(problem, file.schedule, problem.P2, "Y <= I")


def later(frame, Y, s):
    """Y after s, by the exponential of Van Loan's block on a short step, doubled."""
    n, k = frame.n, max(0, int(np.ceil(np.log2(max(s * np.linalg.norm(frame.A), 1e-9)))))
    E = expm(np.block([[-frame.A, frame.S], [np.zeros((n, n)), frame.A.T]]) * s / 2**k)
    F = E[n:, n:].T
    W = F @ E[:n, n:]
    for _ in range(k):
        F, W = F @ F, W + F @ W @ F.T
    return F @ Y @ F.T + W


@pytest.mark.parametrize("seed", few(range(SEEDS), *range(5)))
def test_nothing_along_a_stretch_exceeds_its_bound(seed):
    rng, frame = drawn(seed)
    for step in 10.0 ** rng.uniform(-4, 0, 4):
        root = rng.standard_normal((frame.n, frame.n)) * 10.0 ** rng.uniform(-3, 0, frame.n)
        Y = root @ root.T
        end = frame.moved(Y[None], [step])
        bound = float(frame.covered(Y[None], end, np.array([step]), 0.0)[0])
        highest = max(np.linalg.eigvalsh(later(frame, Y, s))[-1] for s in np.linspace(0, step, 41))
        assert highest <= bound * (1 + 1e-9)
        assert highest <= frame.risen_to(largest(Y), step) * (1 + 1e-9)
        with precision():
            flow = BallFlow(matrix(frame.A), matrix(frame.S))
            N = floats(flow.carried(fallen(flow.slope(matrix(Y))), ball(step)))
        for s in np.linspace(0, step, 9):
            Ys = later(frame, Y, s)
            falling = -(frame.A @ Ys + Ys @ frame.A.T + frame.S)
            size = np.linalg.norm(frame.A) * np.linalg.norm(Ys) + np.linalg.norm(frame.S)
            assert np.linalg.eigvalsh(falling - N)[-1] <= 1e-10 * size


@pytest.mark.parametrize("seed", range(SEEDS))
def test_every_start_of_a_cell_lies_below_its_ends(seed):
    rng, frame = drawn(seed)
    low = np.sort(rng.uniform(0, 1.0, 5))
    high = low + 10.0 ** rng.uniform(-5, 0, 5)
    flows = frame.flow(np.concatenate([high, low]))
    Y, other = np.split(frame.along(frame.start, flows)[0], 2)
    one, two = frame.starts(Y, other, low, high, flows[np.arange(5, 10)])
    for k in range(5):
        for share in np.linspace(0, 1, 17):
            true = later(frame, frame.start, low[k] + share * (high[k] - low[k]))
            room = share * one[k] + (1 - share) * two[k] - true
            assert np.linalg.eigvalsh(room)[0] >= -1e-8 * np.linalg.norm(true)


def test_where_y_rises_the_end_covers_the_whole_stretch():
    """Every direction grows: one look at the end of a gap of e^20, and one cell of starts, are enough."""
    _, frame = drawn(1)
    frame.A, frame.S = np.eye(frame.n) * 2.0, np.eye(frame.n)
    frame.square, frame.bend = frame.A @ frame.A, 2 * frame.A @ frame.S
    Y, step = np.eye(frame.n)[None], np.array([5.0])
    end = np.exp(20.0) * Y + np.expm1(20.0) / 4 * np.eye(frame.n)
    bound = float(frame.covered(Y, end, step, 0.0)[0])
    assert bound == pytest.approx(float(largest(end)[0]), rel=1e-9)


def test_a_large_lambda_is_proven_with_little_work():
    """Turning, growing and a chain of integrators: a third of the work of chords alone, which rise with lambda."""
    A = np.zeros((5, 5))
    A[:2, :2], A[2:, 2:] = [[0.1, 1.3], [-1.3, 0.1]], np.eye(3, k=1)
    plant = Plant(A, [[1.0, 0.0, 1.0, 0.0, 0.0]])
    made = certify(plant, Schedule([1.8, 2.4, 3.8, 4.3, 5.1, 6.8]), eta=3.0, P2=np.eye(5))
    assert made.lam > 1e8
    assert verdict_of(made.to_dict(), WorkLimit(4e4)).passed


def test_a_norm_bounds_what_turns_and_is_not_driven_exactly():
    A = 0.1 * np.eye(2) + [[0.0, 7.0], [-7.0, 0.0]]
    made = {"P1": np.eye(2) / 2, "P2": np.eye(2), "Qw": np.eye(1), "R": [[2.0]], "Qv": [[2.0]], "eta": 0.4, "lam": 2.0}
    plant = Plant(A, [[1.0, 0.0]], G=np.zeros((2, 1)))
    file = claims.certificate(Certificate.from_matrices(plant, PeriodicSchedule([1.0]), **made).to_dict())
    frame = sampled.Windows(numbers.problem(file.plant, file.weights), file.schedule, np.eye(2), "Y <= I")
    assert frame.risen_to(np.array([0.3]), np.array([3.0]))[0] == pytest.approx(0.3 * np.exp(0.6 * 3.0), rel=1e-5)


def twelve_undamped(room):
    """Six oscillations nearly equal, gaps of up to three turns, and the P1 that a search found, times `room`."""
    A = np.kron(np.diag(np.linspace(1.0, 1.3, 6)), [[0.0, 1.0], [-1.0, 0.0]])
    plant = Plant(A, np.random.default_rng(12).normal(size=(1, 12)))
    schedule = PeriodicSchedule(np.arange(1.0, 21.0), 20.0)
    made = {"P1": 2.1e-4 * room * np.eye(12), "P2": 0.01 * np.eye(12), "Qw": np.eye(12), "R": [[2.0]], "Qv": [[2.0]]}
    return Certificate.from_matrices(plant, schedule, **made, eta=0.0186, lam=0.01 / (2.1e-4 * room))


def test_undamped_modes_are_proven_with_little_work(monkeypatch):
    """Where the norm shows what lies far below the target: a seventh of the work of steps shorter than a turn."""
    assert verdict_of(twelve_undamped(1.0).to_dict(), WorkLimit(3e5)).passed
    assert verdict_of(twelve_undamped(1.2).to_dict(), WorkLimit(3e5)).verdict == "refuted"
    monkeypatch.setattr(sampled, "LOW", 0.0)
    assert verdict_of(twelve_undamped(1.0).to_dict(), WorkLimit(3e5)).verdict == "undecided"


@pytest.mark.parametrize("rate", few([1e2, 1e5, 1e9], 1))
def test_stiff_plants_are_decided_with_little_work(rate):
    """Rates of 1e9 between two samples: thirty doublings, and no more steps than that."""
    plant = Plant(np.diag([-rate, -1.0, 0.1]), [[1.0, 1.0, 1.0]])
    made = certify(plant, PeriodicSchedule([1.0]), eta=0.15, P2=np.eye(3))
    assert verdict_of(made.to_dict(), WorkLimit(2e5)).passed
    short = {"P1": 1.01 * made.P1, "P2": made.P2, "Qw": made.Qw, "R": made.R, "Qv": made.Qv}
    false = Certificate.from_matrices(plant, PeriodicSchedule([1.0]), **short, eta=0.15, lam=made.lam)
    assert verdict_of(false.to_dict(), WorkLimit(2e5)).verdict == "refuted"


def stiff_chain(rate):
    """A fast mode beside a chain of slow ones, which has no basis of eigenvectors, in coordinates that mix both."""
    A = np.zeros((4, 4))
    A[0, 0], A[1:, 1:] = -rate, -1e-3 * np.eye(3) + np.eye(3, k=1)
    S = np.eye(4) + 0.4 * np.random.default_rng(3).standard_normal((4, 4))
    C = np.array([[1.0, 1.0, 0.3, 0.2]])
    return Plant(S @ A @ np.linalg.inv(S), C @ np.linalg.inv(S)), PeriodicSchedule([1.0, 0.6])


def test_what_is_fast_does_not_set_the_steps_of_a_slow_chain(monkeypatch):
    """Fast and slow are carried apart: a fraction of the work of bounds that know one speed for all states."""
    plant, schedule = stiff_chain(200.0)
    made = certify(plant, schedule, eta=0.3, P2=np.eye(4))
    assert verdict_of(made.to_dict(), WorkLimit(8e4)).passed
    monkeypatch.setattr(sampled.Windows, "split", None)
    assert not verdict_of(made.to_dict(), WorkLimit(8e4)).passed


@pytest.mark.parametrize("rate", [3.0, 30.0, 300.0])
def test_carried_apart_a_matrix_stays_above_the_flow(rate):
    """V D V' of both rooms lies above e^{As} N e^{A's} all along a step, and is far below one speed for all."""
    plant, schedule = stiff_chain(rate)
    weights = {"P1": np.eye(4) / 2, "P2": np.eye(4), "Qw": np.eye(4), "R": [[2.0]], "Qv": [[2.0]]}
    file = claims.certificate(Certificate.from_matrices(plant, schedule, **weights, eta=0.3, lam=2.0).to_dict())
    problem = numbers.problem(file.plant, file.weights)
    frame = sampled.Windows(problem, file.schedule, problem.P2, "Y <= I")
    rng = np.random.default_rng(5)
    for step in (0.01, 0.3, 1.0):
        root = rng.standard_normal((4, 2))
        N = root @ root.T
        with precision():
            flow = BallFlow(matrix(frame.A), matrix(frame.S))
            in_balls = flow.split.above(matrix(N)) * (2 * flow.split.rate * ball(step)).exp()
        above = frame.split.above(N) * np.exp(2 * frame.split.rate * step)
        for found in (above, floats(in_balls)):
            rooms = [found - expm(frame.A * s) @ N @ expm(frame.A.T * s) for s in np.linspace(0, step, 9)]
            assert min(np.linalg.eigvalsh(room)[0] for room in rooms) >= 0
            assert np.trace(found) < 2000 * np.trace(N)


def test_a_run_with_more_noise_that_is_lost_ends_no_check():
    """A mode that grows and that no output observes: no family closes, and still the window that fails is named."""
    plant = Plant(np.diag([1.5, -1.0]), [[0.0, 1.0]], G=np.diag([1e-3, 1.0]))
    weights = {"P1": 1e-9 * np.eye(2), "P2": np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]]}
    false = Certificate.from_matrices(plant, PeriodicSchedule([1.0]), **weights, eta=0.5, lam=1e9)
    found = verdict_of(false.to_dict())
    assert found.verdict == "refuted"
    assert found.time is not None


def test_a_window_that_rounding_hides_ends_the_search():
    """No finer cell of starts is without the worst window: where that one is tight, halving its cell is in vain."""
    still = Plant([[-0.25]], [[1.0]], G=[[0.0]])
    weights = {"P1": [[1.0]], "P2": [[1.0]], "Qw": [[1.0]], "R": [[2.0]], "Qv": [[2.0]]}
    tight = Certificate.from_matrices(still, PeriodicSchedule([1.0]), **weights, eta=0.5, lam=1.0)
    work = WorkLimit(1e6)
    found = verdict_of(tight.to_dict(), work)
    assert found.verdict == "undecided"
    assert found.reason.endswith("it is tight or nearly so, or rounding hides one window")
    assert work.left > 9e5
