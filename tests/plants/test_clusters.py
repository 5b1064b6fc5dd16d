"""Eigenvalue clusters: what belongs together, the index, and when a doubt is admitted."""

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.linalg import block_diag, companion

from sampling_design import ArgumentError
from sampling_design.plants.clusters import eigenvalue_clusters, format_eigenvalue
from tests import strategies


def jordan(value, size):
    return value * np.eye(size) + np.eye(size, k=1)


def hidden(A, seed=0):
    """The same matrix in a random orthogonal basis, so that rounding scatters what is defective."""
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal(np.shape(A)))[0]
    return Q @ A @ Q.T


def shape(A, **options):
    """(multiplicity, index) of each cluster, sorted."""
    return sorted((c.multiplicity, c.index) for c in eigenvalue_clusters(A, **options))


ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])


@pytest.mark.parametrize(
    ("A", "expected"),
    [
        (jordan(0, 3), [(3, 3)]),
        (jordan(1, 6), [(6, 6)]),
        (jordan(-1, 8), [(8, 8)]),
        (block_diag(jordan(0, 4), jordan(0, 4)), [(8, 4)]),
        (block_diag(jordan(0, 3), jordan(0, 1)), [(4, 3)]),
        (np.zeros((5, 5)), [(5, 1)]),
        (np.kron(np.eye(3), ROTATION), [(3, 1), (3, 1)]),
        (block_diag(np.kron(jordan(0, 2), np.eye(2)) + np.kron(np.eye(2), ROTATION)), [(2, 2), (2, 2)]),
        (companion([1.0, 3.0, 3.0, 1.0, 0.0, 0.0]), [(2, 2), (3, 3)]),
        (companion(np.poly([1j, -1j] * 3).real), [(3, 3), (3, 3)]),
        (companion(np.poly(np.arange(1, 6)).real), [(1, 1)] * 5),
    ],
)
@pytest.mark.parametrize("seed", [None, 0, 1])
def test_known_structures_are_found_in_any_orthogonal_basis(A, expected, seed):
    clusters = eigenvalue_clusters(A if seed is None else hidden(A, seed))
    assert sorted((c.multiplicity, c.index) for c in clusters) == expected
    assert all(c.sure for c in clusters)


def test_two_equal_masses_on_springs_have_four_simple_eigenvalues():
    K = np.array([[2.0, -1.0], [-1.0, 2.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, np.zeros((2, 2))]])
    values = [c.value for c in eigenvalue_clusters(A)]
    np.testing.assert_allclose(sorted(v.imag for v in values), [-np.sqrt(3), -1, 1, np.sqrt(3)], atol=1e-14)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 1e-12])
def test_well_conditioned_eigenvalues_stay_apart_however_close(gap):
    A = hidden(np.diag([1.0, 1.0 + gap, 2.0]))
    assert shape(A) == [(1, 1)] * 3


def test_a_slow_mode_beside_a_double_zero_is_not_taken_into_it():
    A = hidden(block_diag(jordan(0, 2), [[-1e-4]]))
    assert shape(A) == [(1, 1), (2, 2)]


@pytest.mark.parametrize("coupling", [1.0, 1e-3, 1e-6, 1e-14, 1e-30, 1e30])
def test_a_weak_coupling_still_makes_an_index_of_two(coupling):
    assert shape([[0.0, coupling, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) == [(1, 1), (2, 2)]


def test_a_coupling_below_the_given_rounding_is_no_coupling():
    # in coordinates that hide it: beside an exact zero, units of the states give a coupling any size
    A = hidden([[1.0, 1e-9], [0.0, 1.0]])
    assert shape(A) == [(2, 2)]
    assert shape(A, rounding=1e-8) == [(2, 1)]
    assert shape([[1.0, 1e-9], [0.0, 1.0]], rounding=1e-8) == [(2, 2)]


def test_doubt_is_admitted_where_a_coupling_is_of_the_size_of_rounding():
    (cluster,) = eigenvalue_clusters(hidden([[1.0, 1e-14], [0.0, 1.0]]))
    assert not cluster.sure
    assert "doubt" in cluster.explain()


def test_a_small_cap_forbids_wide_groups():
    A = hidden(jordan(0, 6))
    assert shape(A) == [(6, 6)]
    assert len(eigenvalue_clusters(A, cap=1e-6)) > 1


def test_units_do_not_matter():
    A = hidden(block_diag(jordan(0, 2), ROTATION))
    d = 2.0 ** np.array([0, 20, -15, 7])
    assert shape(A * d / d[:, None]) == shape(A)
    assert shape(1e-3 * A) == shape(A) == shape(1e6 * A)


@settings(max_examples=40)
@given(strategies.plants())
def test_multiplicities_add_up_and_conjugates_are_grouped_alike(plant):
    clusters = eigenvalue_clusters(plant.A)
    assert sum(c.multiplicity for c in clusters) == plant.n_states
    assert all(1 <= c.index <= c.multiplicity for c in clusters)
    key = sorted((round(c.value.real, 9), round(c.value.imag, 9), c.multiplicity) for c in clusters)
    mirror = sorted((round(c.value.real, 9), round(-c.value.imag, 9) + 0.0, c.multiplicity) for c in clusters)
    np.testing.assert_allclose(key, mirror, atol=1e-8)


def test_order_is_by_real_part_then_frequency():
    A = block_diag(-1.0, 2 * ROTATION, ROTATION, 3.0)
    assert [c.label() for c in eigenvalue_clusters(A)] == ["3", "0+1i", "0-1i", "0+2i", "0-2i", "-1"]


def test_a_matrix_without_rows_has_no_clusters():
    assert eigenvalue_clusters(np.zeros((0, 0))) == ()


def test_words():
    assert format_eigenvalue(1 + 0j) == "1"
    assert format_eigenvalue(0.5 - 2j) == "0.5-2i"
    assert format_eigenvalue(1e-20 + 1j, grain=1e-15) == "0+1i"
    (cluster,) = eigenvalue_clusters(jordan(0, 2))
    assert repr(cluster) == "EigenvalueCluster(value=0, multiplicity=2, index=2, sure=yes)"
    assert cluster.explain() == "Eigenvalue 0, 2-fold, largest Jordan block of size 2."


def test_bad_input_is_refused():
    with pytest.raises(ArgumentError, match=r"`A` must have shape \(2, 2\), got \(2, 3\)"):
        eigenvalue_clusters(np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="`rounding` must be positive"):
        eigenvalue_clusters(np.eye(2), rounding=0.0)
    with pytest.raises(ArgumentError, match="`cap` must be positive"):
        eigenvalue_clusters(np.eye(2), cap=-1.0)
