"""A plant with entries from 1e-9 to 1e8 and two modes near the axis, on which others lost states.

The matrix is the one reported in ControlSystems.jl issue 835 and MatrixPencils.jl issue 12.
"""

import mpmath
import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.modes import split_modes

a, b, c, d, e = 6.537773175952662, 9.892378564622923e-9, 2.0163803998106024e8, 1.551620418759878e8, 0.002358202548321148
f, g, h, i = 2.824060629317756e8, 2.0198389074625736e8, 1.5542817673286995e8, 0.7305736722226711
A = np.array(
    [
        [-a, 0.0, 0.0, 0.0, -b, 0.0],
        [0.0, -a, 0.0, 0.0, 0.0, -b],
        [c, c, -0.006223894167415392, -d, e, e],
        [0.0, 0.0, 5.063545034365582e-9, -0.4479539754649166, 0.0, 0.0],
        [-f, g, -0.006234569427701143, -h, -i, 0.0023622473513548576],
        [g, -f, -0.006234569427701143, -h, 0.0023622473513548576, -i],
    ]
)


@pytest.fixture(scope="module")
def exact():
    """Eigenvalues in 60-digit arithmetic, largest real part first."""
    with mpmath.workdps(60):
        values = mpmath.eig(mpmath.matrix(A.tolist()), left=False, right=False)
        return sorted((complex(v) for v in values), key=lambda v: (-v.real, v.imag))


def test_eigenvalues_keep_their_digits(exact):
    found = sorted((m for k in eigenvalue_clusters(A) for m in k.members), key=lambda v: (-v.real, v.imag))
    norm = split_modes(Plant(A, np.ones((1, 6)))).offset / 1e-8
    assert norm < 1e2  # balanced, where |A| itself is 7e8
    uncertainty = sorted(eigenvalue_clusters(A), key=lambda k: -k.uncertainty)[0].uncertainty
    np.testing.assert_allclose(found, exact, atol=max(10 * uncertainty, 1e-12))


@pytest.mark.parametrize("decay_rate", [0.0, 0.01, 0.8, 2.0, 20.0])
def test_the_split_agrees_with_exact_arithmetic_on_both_sides(exact, decay_rate):
    split = split_modes(Plant(A, np.ones((1, 6))), decay_rate)
    right = [v for v in exact if v.real >= -decay_rate / 2]
    sure = [v for v in exact if abs(v.real + decay_rate / 2) > 2 * split.offset + 1e-12]
    assert len(sure) + split.near_line.size >= 6
    if len(sure) == 6:
        assert split.retained.n_states == len(right)
    assert split.retained.n_states >= len(right)


def test_four_dynamic_and_two_algebraic_states_are_found(exact):
    """The physics: four differential equations and two algebraic ones, whose modes stand still."""
    split = split_modes(Plant(A, np.ones((1, 6))))
    assert sum(abs(v) < 1e-15 for v in exact) == 2
    assert split.retained.n_states == 2
    assert split.near_line.size == 2
    (still,) = split.retained_clusters
    assert (still.multiplicity, still.index, still.sure) == (2, 1, True)
    assert split.condition < 10


def test_units_do_not_change_the_split():
    scale = 2.0 ** np.array([0, 3, -25, 10, 22, -6])
    other = split_modes(Plant(A * scale / scale[:, None], np.ones((1, 6))), 0.8)
    assert other.retained.n_states == split_modes(Plant(A, np.ones((1, 6))), 0.8).retained.n_states
