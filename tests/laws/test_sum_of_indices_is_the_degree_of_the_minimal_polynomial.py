"""Clusters agree with exact rational arithmetic on integer matrices whose Jordan blocks are hidden.

The sum of the indices over the distinct eigenvalues is the degree of the minimal polynomial, and the
number of clusters is the number of distinct eigenvalues. Where rounding makes this undecidable the
clusters say so.
"""

import numpy as np
import pytest
from hypothesis import given, settings

from sampling_design.plants.clusters import eigenvalue_clusters
from tests import strategies
from tests.cases import few
from tests.oracles.plants import distinct_eigenvalue_count, minimal_polynomial_degree, planted


def agrees(A):
    clusters = eigenvalue_clusters(A)
    degree = sum(c.index for c in clusters)
    right = degree == minimal_polynomial_degree(A) and len(clusters) == distinct_eigenvalue_count(A)
    return right, all(c.sure for c in clusters), clusters


@pytest.mark.parametrize(
    ("steps", "longest", "largest"), few([(4, 2, 6), (8, 3, 8), (16, 3, 8), (24, 3, 8), (16, 4, 10), (40, 4, 10)], 0, 2)
)
def test_on_planted_matrices(steps, longest, largest):
    rng = np.random.default_rng(steps)
    for _ in range(25):
        A = planted(rng, largest, steps, longest)
        right, sure, clusters = agrees(A)
        assert right, (A, clusters)
        assert sure, (A, clusters)


@settings(max_examples=60)
@given(strategies.defective_plants())
def test_on_drawn_defective_plants(plant):
    right, _, clusters = agrees(plant.A)
    assert right, clusters


@pytest.mark.parametrize("n", [3, 5, 8])
def test_on_generic_integer_matrices(n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        assert agrees(rng.integers(-3, 4, (n, n)).astype(float))[0]


def test_doubt_is_admitted_where_the_similarity_hides_the_structure_from_double_precision():
    """|A| is 1e5 to 1e10 times the eigenvalues: an answer that is wrong must nearly always be unsure."""
    rng = np.random.default_rng(1)
    wrong = wrong_and_sure = 0
    for _ in range(40):
        right, sure, _ = agrees(planted(rng, 10, 120, 4))
        wrong += not right
        wrong_and_sure += sure and not right
    assert wrong > 0
    assert wrong_and_sure == 0
