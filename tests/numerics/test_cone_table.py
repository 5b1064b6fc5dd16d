"""Rows of a window's program are what the program says, and its optimum is that of the same program written out."""

import numpy as np
import pytest
from scipy.optimize import linprog

from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.conic_programs import ConeSolver

rng = np.random.default_rng(0)
F, B, H = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 5)), rng.normal(size=(3, 1, 2))
WIDTHS, READ = [2, 3], np.array([0.1, -0.2, 0.3])


def posed(round_: bool) -> ConeTable:
    """Two gaps, a reading within 1 at each of three times, w in a box or, entry by entry, in balls."""
    table = ConeTable(6 + 5)
    table.flow(F, B, WIDTHS, 0, 6)
    table.end("zero")
    for k in () if round_ else range(3):
        table.box(2 * k, H[k], np.ones(1), READ[k])
    if not round_:
        table.unit_box(6, 5)
    table.end("nonnegative")
    for k in range(3) if round_ else ():
        table.ball(2 * k, H[k], READ[k])
    if round_:
        table.unit_balls(6, 1, 5)
    return table


@pytest.mark.parametrize("round_", [False, True])
def test_the_optimum_is_that_of_the_program_written_out(round_):
    table, cost = posed(round_), np.zeros(11)
    cost[4:6] = -1.0, 0.5
    x, y, _ = ConeSolver(table.matrix(), table.cones).solve(cost, table.b())
    flow = np.zeros((4, 11))
    flow[:2, :2], flow[:2, 2:4], flow[:2, 6:8] = -F[0], np.eye(2), -B[:, :2]
    flow[2:, 2:4], flow[2:, 4:6], flow[2:, 8:] = -F[1], np.eye(2), -B[:, 2:]
    seen = np.hstack([np.kron(np.eye(3), np.ones((1, 2))) * H.ravel(), np.zeros((3, 5))])
    found = linprog(
        cost, np.vstack([seen, -seen]), np.concatenate([1 + READ, 1 - READ]), flow, np.zeros(4),
        bounds=[(None, None)] * 6 + [(-1, 1)] * 5,
    )  # fmt: skip
    assert cost @ x == pytest.approx(found.fun, rel=1e-7)
    assert -y @ table.b() == pytest.approx(found.fun, rel=1e-7)


def test_a_window_without_gaps_disturbance_or_rows_has_none():
    table = ConeTable(2)
    table.flow(np.zeros((0, 2, 2)), np.zeros((2, 0)), [], 0, 2)
    table.unit_balls(2, 0, 0)
    table.end("zero")
    assert (table.rows, table.cones) == (0, [])
