"""Plants with thousands of states: the retained modes are all that there are right of the line."""

import numpy as np
import pytest
from scipy import sparse

from sampling_design import PeriodicSchedule, certify, window_sigma
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.plants import library
from sampling_design.plants import sparse as room
from sampling_design.plants.modes import split_modes
from sampling_design.plants.sparse import SparsePlant, split_sparse
from tests.cases import few


def random_pair(rng, n, units=0):
    """A symmetric A with a crowded spectrum and masses, in units of time 10^units."""
    where, weights = tuple(rng.integers(n, size=(2, 4 * n))), rng.uniform(0.1, 1, 4 * n)
    W = sparse.coo_array((weights, where), shape=(n, n)).tocsr()
    A = (W + W.T) * 10.0**units
    A = A - sparse.diags_array(np.asarray(A.sum(axis=1)).ravel() * rng.uniform(0.5, 1.5, n))
    return SparsePlant(A, np.eye(2, n), mass=rng.uniform(0.1, 10.0, n))


def truth(plant):
    root = np.sqrt(plant.mass)
    return np.linalg.eigvalsh(plant.A.toarray() / np.outer(root, root))[::-1]


@pytest.mark.parametrize("seed", few(range(6), 0, 2, 5))
def test_as_many_modes_as_dense_eigenvalues(seed):
    rng = np.random.default_rng(seed)
    units = int(rng.integers(-9, 10))
    plant = random_pair(rng, 260, units)
    values = truth(plant)
    for count in (0, 1, 3, 8):
        high = values[count - 1] if count else values[0] + 10.0**units
        if high + values[count] >= 0:
            continue  # a line right of zero cannot be asked for
        split = split_sparse(plant, decay_rate=-(high + values[count]))
        assert split.eigenvalues.size == count
        assert split.proof == "inertia"
        np.testing.assert_allclose(split.eigenvalues, values[:count], rtol=0, atol=1e-12 * abs(values[-1]))
        assert np.all(values[count:] < split.line)
        assert split.perturbation <= split.clearance
        np.testing.assert_allclose(split.left @ split.basis, np.eye(count), atol=1e-12)


def test_a_plate_keeps_the_double_modes_that_theory_gives():
    side = 40
    plant = library.heat_plate(side)
    one = -4 * 60e-4 * side**2 * np.sin(np.pi * np.arange(side) / (2 * side)) ** 2
    theory = np.sort((one[:, None] + one).ravel())[::-1]
    split = split_sparse(plant, decay_rate=0.6)
    kept = theory[theory >= -0.3]
    assert kept.size == 8  # 0, and j^2 + k^2 = 1 (twice), 2, 4 (twice), 5 (twice) times -.0592
    np.testing.assert_allclose(split.eigenvalues, kept, atol=1e-10)
    assert "8 of 1600 modes" in str(split)
    assert "pivots" in split.explain()


def test_the_retained_part_is_what_the_whole_plant_shows_once_the_rest_has_faded():
    plant = library.droop_network(120, meters=3, seed=4)
    split = split_sparse(plant, decay_rate=0.3)
    rng = np.random.default_rng(0)
    x = rng.standard_normal(120)
    values, vectors = np.linalg.eig(plant.A.toarray() / plant.mass[:, None])
    t = 60.0
    whole = plant.C @ (vectors @ (np.exp(values * t) * np.linalg.solve(vectors, x))).real
    z = np.exp(split.eigenvalues * t) * (split.left @ x)
    np.testing.assert_allclose(split.retained.C @ z, whole, atol=20 * np.exp(split.line * t))
    assert split.retained.outputs.names == plant.outputs.names


@pytest.mark.long
def test_design_words_work_on_the_retained_part():
    retained = split_sparse(library.heat_plate(30), decay_rate=0.25).retained
    assert retained.n_states == 4
    schedule = PeriodicSchedule([3.0, 5.0], time_unit="min")
    assert window_sigma(retained, schedule, 16.0).lower > 0
    certificate = certify(retained, schedule, eta=0.01)
    assert certificate.verify()


def test_an_eigenvalue_on_the_line_is_retained():
    n = 300
    A = sparse.diags_array(-np.arange(n, dtype=float))
    split = split_sparse(SparsePlant(A, np.ones((1, n))), decay_rate=4.0)
    assert split.eigenvalues.size == 3  # 0, -1 and -2, which lies on the line
    assert split.line < -2


def test_a_plant_that_stands_still_is_retained_whole():
    split = split_sparse(SparsePlant(sparse.csr_array((50, 50)), np.eye(2, 50)))
    assert split.eigenvalues.size == 50
    assert split.proof == "inertia"


def test_dominance_proves_that_nothing_is_retained():
    n = 3000
    drift = sparse.diags_array([1.5, -2.0, 0.5], offsets=[-1, 0, 1], shape=(n, n))  # convection: not symmetric
    plant = SparsePlant(drift - 0.01 * sparse.eye_array(n), np.eye(1, n))
    split = split_sparse(plant)
    assert split.proof == "dominance"
    assert split.retained.n_states == 0
    assert "dominance" in split.explain()
    with pytest.raises(ArgumentError, match="not symmetric"):
        split_sparse(plant, decay_rate=0.5)


def test_many_small_asymmetries_are_one_large():
    """Each entry of the hub's row is symmetric to rounding in units of |A|; their sum moves eigenvalues."""
    n = 10_000
    star = sparse.diags_array(-np.append(n - 1.0, np.ones(n - 1))).tolil()
    star[0, 1:] = star[1:, 0] = 1.0
    assert split_sparse(SparsePlant(star, np.eye(1, n)), decay_rate=0.1).eigenvalues.size == 1
    star[0, 1:] = 1.0 + 1e-12
    with pytest.raises(ArgumentError, match="not symmetric"):
        split_sparse(SparsePlant(star, np.eye(1, n)), decay_rate=0.1)


def test_small_splits_agree_with_the_dense_verb():
    plant = library.droop_network(60, meters=2, seed=2)
    dense = library.double_integrator().__class__(plant.A.toarray() / plant.mass[:, None], plant.C.toarray())
    for rate in (0.0, 0.1, 1.0):
        split = split_modes(dense, decay_rate=rate)
        assert split.retained.n_states == split_sparse(plant, rate).eigenvalues.size


def test_crowds_and_breakdowns_are_said(monkeypatch):
    n = 400
    plant = SparsePlant(sparse.diags_array(np.linspace(-1, 0, n)), np.ones((1, n)))
    with pytest.raises(ArgumentError, match="more than 100"):
        split_sparse(plant, decay_rate=1.9)
    monkeypatch.setattr(room, "_above", lambda *_: (0, np.inf))
    with pytest.raises(SolverError, match="told apart"):
        split_sparse(plant)
    monkeypatch.undo()

    def stops(*_, **__):
        raise room.ArpackError(-1, {-1: "no convergence"})

    monkeypatch.setattr(room, "eigsh", stops)
    with pytest.raises(SolverError, match="eigenvalue solver stopped"):
        split_sparse(plant, decay_rate=0.1)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"A": np.zeros((2, 3)), "C": np.zeros((1, 3))}, "`A` must be square"),
        ({"A": np.zeros((0, 0)), "C": np.zeros((1, 0))}, "`A` must be square"),
        ({"A": np.eye(2), "C": np.zeros((1, 3))}, "`C` must have 2 columns"),
        ({"A": np.eye(2), "C": np.zeros((1, 2)), "B": np.zeros((3, 1))}, "`B` must have 2 rows"),
        ({"A": np.eye(2), "C": np.zeros((1, 2)), "mass": [1.0, 0.0]}, "`mass` must be positive"),
        ({"A": np.eye(2) * np.nan, "C": np.zeros((1, 2))}, "must hold finite numbers only"),
        ({"A": np.eye(2) * 1j, "C": np.zeros((1, 2))}, "`A` must be real"),
        ({"A": np.zeros((2, 2, 2)), "C": np.zeros((1, 2))}, "`A` must be a real matrix, got 3"),
        ({"A": sparse.eye_array(2) * 1j, "C": np.zeros((1, 2))}, "`A` must be a real matrix"),
        ({"A": "nonsense", "C": np.zeros((1, 2))}, "`A` must hold real numbers"),
        ({"A": sparse.eye_array(300_000), "C": sparse.eye_array(1, 300_000)}, "at most 200000 states"),
    ],
)
def test_bad_matrices_are_refused_in_one_sentence(arguments, says):
    with pytest.raises(ArgumentError, match=says):
        SparsePlant(**arguments)


def test_records_are_plain():
    plant = library.heat_plate(6)
    assert plant.to_dict()["states"] == 36
    assert "split_sparse" in plant.explain()
    assert set(split_sparse(plant).to_dict()) >= {"eigenvalues", "line", "proof", "clearance"}
