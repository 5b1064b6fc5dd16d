"""The door to the conic solvers: statuses are words, multipliers are checked by their own equation."""

import sys

import numpy as np
import pytest
from scipy import sparse

from sampling_design.errors import MissingExtraError
from sampling_design.estimators.constraints import qp
from sampling_design.estimators.constraints.constrained_signals import LeastDistance
from sampling_design.numerics import conic_programs
from sampling_design.numerics.conic_programs import ConeSolver
from tests.oracles.estimators import least_slacks

RNG = np.random.default_rng(7)


def random_symmetric(n, count):
    M = RNG.normal(size=(count, n, n))
    return M + np.swapaxes(M, 1, 2)


def test_svec_keeps_the_trace_product_and_comes_back():
    X, Y = random_symmetric(5, 2)
    assert np.isclose(conic_programs.svec(X) @ conic_programs.svec(Y), np.trace(X @ Y), rtol=1e-14)
    assert np.allclose(conic_programs.smat(conic_programs.svec(X)), X, rtol=1e-15)


def test_a_cone_program_finds_the_least_eigenvalue_and_its_multiplier():
    S = random_symmetric(4, 1)[0]
    block = ("psd", conic_programs.svec(np.eye(4))[:, None], conic_programs.svec(S))  # S - x I >= 0
    solution = conic_programs.solve_cone_program(np.array([-1.0]), [block])
    values, vectors = np.linalg.eigh(S)
    assert solution.record.status == "solved"
    assert np.isclose(solution.x[0], values[0], atol=1e-7)
    assert np.allclose(solution.z[0], np.outer(vectors[:, 0], vectors[:, 0]), atol=1e-5)


def test_linear_cones_and_an_infeasible_program():
    rows = np.array([[1.0], [-1.0]])
    good = [("nonnegative", rows, np.array([3.0, -1.0]))]  # 1 <= x <= 3
    assert np.isclose(conic_programs.solve_cone_program(np.array([1.0]), good).x[0], 1.0, atol=1e-7)
    bad = [("nonnegative", rows, np.array([1.0, -3.0]))]
    assert conic_programs.solve_cone_program(np.array([1.0]), bad).record.status == "infeasible"
    fixed = [("zero", np.array([[2.0]]), np.array([5.0]))]
    assert np.isclose(conic_programs.solve_cone_program(np.array([1.0]), fixed).x[0], 2.5, atol=1e-7)


def test_unrefined_steps_find_the_same_point_and_what_they_do_not_solve_is_solved_again(monkeypatch):
    S, cl, asked = random_symmetric(4, 1)[0], conic_programs.clarabel(), []
    block = ("psd", conic_programs.svec(np.eye(4))[:, None], conic_programs.svec(S))  # S - x I >= 0
    refined = conic_programs.solve_cone_program(np.array([-1.0]), [block])
    solver = cl.DefaultSolver

    class Unsolved:
        status, solve = "InsufficientProgress", lambda self: self

    def made(*parts):
        asked.append(parts[-1].iterative_refinement_enable)
        return Unsolved() if poor and not asked[-1] else solver(*parts)

    monkeypatch.setattr(cl, "DefaultSolver", made)
    for attempts in ([False], [False, True]):
        poor = len(attempts) > 1
        asked.clear()
        found = conic_programs.solve_cone_program(np.array([-1.0]), [block], refined=False, budget=60.0)
        assert found.record.status == "solved"
        assert found.x == pytest.approx(refined.x, abs=1e-8)
        assert asked == attempts


def test_the_modelling_library_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(MissingExtraError, match="modelling"):
        qp.cvxpy()


def test_a_second_order_cone_beside_others():
    """The point of a disc of radius 2 about (1, 0) that is furthest along (3, 4)."""
    disc = np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]), np.array([2.0, -1.0, 0.0])
    line = np.array([[1.0, 0.0]]), np.array([10.0])
    found = conic_programs.solve_cone_program(np.array([-3.0, -4.0]), [("nonnegative", *line), ("second order", *disc)])
    assert found.x == pytest.approx([1 + 2 * 0.6, 2 * 0.8], abs=1e-6)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_obstacle_is_what_the_modelling_library_finds(size):
    rng, named = np.random.default_rng(4), set()
    for _ in range(6):
        A = rng.normal(size=(7, 2))
        A /= np.linalg.norm(A, axis=1)[:, None]
        centres = size * A @ rng.normal(size=2) + size * rng.normal(size=7)
        upper, lower = centres + 0.1 * size, np.where(rng.uniform(size=7) < 0.3, -np.inf, centres)
        cones = [(rng.normal(size=(2, 2)), size * rng.normal(size=2), 0.3 * size) for _ in range(2)]
        problem = LeastDistance(2, A, lower, upper, cones, np.full(7, 2.0), [], [])
        rows, balls = least_slacks(A, lower, upper, cones)
        labels = "row_label", "cone_label"
        with pytest.MonkeyPatch.context() as patch:
            for label in labels:
                patch.setattr(LeastDistance, label, lambda _, index, *__, label=label: f"{label} {index}")
            text = qp.find_obstacle(problem)
        amounts = [*2 * rows, *balls]
        worst = int(np.argmax(amounts))
        assert text.startswith(f"row_label {worst} " if worst < 7 else f"cone_label {worst - 7} ")
        assert float(text.split("(needs ")[1].split()[0]) == pytest.approx(amounts[worst], rel=6e-3)
        named.add(worst)
    assert len(named) > 2
    wide = LeastDistance(2, A, -np.full(7, np.inf), np.full(7, 1e3 * size), [], np.ones(7), [], [])
    assert qp.find_obstacle(wide) == ""


def test_a_budget_that_ran_out_is_a_status():
    S = random_symmetric(6, 1)[0]
    block = ("psd", conic_programs.svec(np.eye(6))[:, None], conic_programs.svec(S))
    assert conic_programs.solve_cone_program(np.array([-1.0]), [block], iterations=1).record.status == "budget"


@pytest.mark.parametrize("spread", [0.0, 3.0])
def test_a_scaled_program_ends_where_the_careful_one_does(spread):
    rng = np.random.default_rng(0)
    sizes = 10 ** rng.uniform(-spread, spread, 6)
    A, point = rng.normal(size=(18, 6)) / sizes, rng.normal(size=6) * sizes
    b, cost = A @ point + rng.uniform(0.1, 1.0, 18), -A.T @ rng.uniform(0.0, 1.0, 18)
    cones = [("nonnegative", 18)]
    careful = ConeSolver(sparse.csc_matrix(A), cones).solve(cost, b)
    quick = ConeSolver(sparse.csc_matrix(A), cones, scaled=True).solve(cost, b)
    assert careful[2] == quick[2] == "solved"
    assert cost @ quick[0] == pytest.approx(cost @ careful[0], rel=1e-7)


def test_what_a_scaled_program_does_not_solve_is_solved_with_care():
    contradicting = sparse.csc_matrix([[1.0], [-1.0]])
    solver = ConeSolver(contradicting, [("nonnegative", 2)], scaled=True)
    assert solver.solve(np.ones(1), np.array([1.0, 1.0]))[2] == "solved"
    assert solver._careful is None
    assert solver.solve(np.ones(1), np.array([-1.0, -1.0]))[2] == "infeasible"
    assert solver._careful is not None


def test_of_a_large_program_few_digits_are_enough_if_its_caller_says_so(monkeypatch):
    rng = np.random.default_rng(2)
    A, point = rng.normal(size=(60, 12)), rng.normal(size=12)
    b, cost = A @ point + rng.uniform(0.1, 1.0, 60), -A.T @ rng.uniform(0.0, 1.0, 60)
    cones, found = [("second order", 30), ("nonnegative", 30)], []
    b[0] += np.linalg.norm(A[1:30] @ point - b[1:30])
    for large, rough in ((719, 1e-4), (720, 1e-4), (719, None)):
        monkeypatch.setattr(conic_programs, "LARGE", large)
        found.append(ConeSolver(sparse.csc_matrix(A), cones, rough=rough).solve(cost, b))
    assert [status for _, _, status in found] == ["solved"] * 3
    few, small, unasked = (cost @ x for x, _, _ in found)
    assert small == unasked != few
    assert few == pytest.approx(small, rel=2e-4)
    monkeypatch.setattr(conic_programs, "LARGE", 0)
    contradicting = ConeSolver(sparse.csc_matrix([[1.0], [-1.0]]), [("nonnegative", 2)], rough=1e-4)
    assert contradicting.solve(np.ones(1), np.array([-1.0, -1.0]))[2] == "infeasible"
    assert contradicting._careful is not None


def test_every_problem_is_solved_in_one_thread(monkeypatch):
    """Threads of a solver that wait busily for each other would take the time of other workers."""
    cl, made = conic_programs.clarabel(), []
    solver = cl.DefaultSolver
    monkeypatch.setattr(cl, "DefaultSolver", lambda *parts: made.append(parts[-1].max_threads) or solver(*parts))
    rows, b = np.array([[1.0], [-1.0]]), np.array([3.0, -1.0])  # 1 <= x <= 3
    assert conic_programs.solve_cone_program(np.ones(1), [("nonnegative", rows, b)]).x[0] == pytest.approx(1.0)
    assert ConeSolver(sparse.csc_matrix(rows), [("nonnegative", 2)]).solve(np.ones(1), b)[0] == pytest.approx(1.0)
    nearest = qp.conic(LeastDistance(1, rows[:1], np.ones(1), np.array([np.inf]), [], np.ones(1), [], []))
    assert nearest.z == pytest.approx(1.0)
    assert made == [1, 1, 1]
