"""What is kept by content is what would be worked out anew."""

import numpy as np
import pytest

from sampling_design.numerics.linalg import balance, discounted_flow, expm_batch, exponential_terms
from sampling_design.plants.clusters import balanced_schur
from sampling_design.records.kept import ENTRIES, LARGE, kept


def counted():
    asked = []

    @kept
    def total(matrix, factor=1.0):
        asked.append(matrix)
        if factor < 0:
            raise ArithmeticError("negative")
        return matrix * factor

    return total, asked


def test_the_same_content_is_asked_once_and_another_again():
    total, asked = counted()
    given = np.arange(4.0).reshape(2, 2)
    first = total(given, 2.0)
    assert total(given.copy(), 2.0) is first
    assert len(asked) == 1
    given[0, 0] = 5.0  # the same object says something else now
    for changed, factor in ((given, 2.0), (given, 3.0), (given.ravel(), 2.0), (given + 0j, 2.0), (given.T, 2.0)):
        np.testing.assert_array_equal(total(changed, factor), changed * factor)
    assert len(asked) == 6
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1.0


def test_large_arrays_keywords_and_failures_are_worked_out_anew():
    total, asked = counted()
    for _ in range(2):
        total(np.zeros(LARGE[1] + 1))
        total(np.zeros(2), factor=2.0)
        with pytest.raises(ArithmeticError, match="negative"):
            total(np.zeros(2), -1.0)
    assert len(asked) == 6


def test_of_larger_arrays_the_last_few_answers_are_kept():
    total, asked = counted()
    for k in [*range(LARGE[0] + 1), LARGE[0], 0]:
        total(np.full(ENTRIES + 1, float(k)))
    assert len(asked) == LARGE[0] + 2  # the last one is known still, the first one no more


@pytest.mark.parametrize("A", [np.array([[0.0, 1.0], [-1.0, 0.0]]), np.diag([1e-9, 1e9]) + 1.0])
def test_answers_that_all_share_are_read_only(A):
    for found in (exponential_terms(A, 2.0, 5), balance(A).d, balanced_schur(A).T, balanced_schur(A).eigenvalues):
        assert not found.flags.writeable
    np.testing.assert_array_equal(exponential_terms(A, 2.0, 5), exponential_terms.__wrapped__(A, 2.0, 5))


def test_exponentials_belong_to_who_asked_and_overflow_warns_each_time():
    A, noise = np.array([[0.0, 1.0], [-1.0, 0.3]]), np.eye(2)
    for ask in (lambda: expm_batch(A, [0.3, 2.0]), lambda: np.concatenate(discounted_flow(A, noise, [0.3, 2.0], 0.1))):
        first = ask()
        again = ask()
        np.testing.assert_array_equal(first, again)
        again[0] = 0.0
        np.testing.assert_array_equal(first, ask())
    with np.errstate(over="ignore", invalid="ignore"):
        assert not np.isfinite(expm_batch(A, [1e4])).all()
    with np.errstate(over="raise", invalid="raise"), pytest.raises(FloatingPointError, match=r"overflow|invalid"):
        expm_batch(A, [1e4])
