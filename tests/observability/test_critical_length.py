import numpy as np
import pytest

from sampling_design import ArgumentError, Plant
from sampling_design.errors import NotObservableError
from sampling_design.observability.count.zero_count import _compound, critical_length
from tests.cases import few
from tests.oracles import zero_count as oracle

PAIR = [1j, -1j]

TABLE = [
    (PAIR, np.pi),
    ([0, *PAIR], 2 * np.pi),
    ([0, 0, *PAIR], 2 * np.pi),
    ([0, 0, 0, *PAIR], 8.98681891581813),  # tan(h/2) = h/2
    ([1j, -1j, 2j, -2j], np.pi),
    ([1j, -1j, 3j, -3j], np.pi),
    ([0, 1j, -1j, 3j, -3j], np.pi),
    ([-1, -2, 0.1 + 1j, 0.1 - 1j], 4.337015),
]


@pytest.mark.parametrize(("eigenvalues", "expected"), TABLE)
def test_table_of_theory_section_9(eigenvalues, expected):
    A, C = oracle.companion(eigenvalues)
    order = 4 if eigenvalues == [1j, -1j, 3j, -3j] else 2
    for found in (critical_length(eigenvalues), critical_length(Plant(A, C))):
        # a zero of order m is known to eps^(1/m) only; the error must fall to the safe side
        assert expected * (1 - 3 * np.finfo(float).eps ** (1 / order)) - 1e-6 <= found <= expected * (1 + 1e-6)


def test_real_spectrum_has_no_critical_length():
    assert critical_length([-1.0, 0.0, 0.0, 3.0]) == np.inf
    assert critical_length([2.0]) == np.inf
    assert critical_length([]) == np.inf


@pytest.mark.parametrize(("eigenvalues", "expected"), few(TABLE[1:], 0))
def test_minors_in_fifty_digits_agree(eigenvalues, expected):
    """Nothing vanishes before, and the same minor is found on a grid around the value."""
    assert oracle.minor_zero(eigenvalues, expected * 0.05, expected * 0.99, 40) is None
    near = oracle.minor_zero(eigenvalues, expected * 0.99, expected * 1.01, 120)
    assert near == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize(
    "eigenvalues", few([[0, *PAIR], [0, 0, 0, *PAIR], [1j, -1j, 3j, -3j], [-1, -2, 0.1 + 1j, 0.1 - 1j]], 0)
)
def test_below_it_any_n_times_do(eigenvalues):
    A, C = oracle.companion(eigenvalues)
    h, n = critical_length(eigenvalues), len(eigenvalues)
    rng = np.random.default_rng(7)
    signs = set()
    for _ in range(40):
        # some clustered, all inside a window a little shorter than h
        times = np.sort(rng.uniform(0.0, 0.999 * h, n) ** rng.choice([1.0, 0.3, 3.0]))
        times = np.sort(times / max(times[-1] - times[0], 1e-9) * rng.uniform(0.5, 0.999) * h)
        signs.add(int(oracle.mp.sign(oracle.determinant(A, C, times - times[0]))))
    assert len(signs) == 1  # one sign throughout: the determinant never vanishes on the ordered times
    assert 0 not in signs


@pytest.mark.parametrize(
    "eigenvalues", few([[0, *PAIR], [0, 0, 0, *PAIR], [-1, -2, 0.1 + 1j, 0.1 - 1j], [-1, 0.2 + 2j, 0.2 - 2j]], 0)
)
def test_just_above_it_some_n_times_fail(eigenvalues):
    """n-k times near 0 and k near h: for some k the determinant has both signs, so it vanishes in between."""
    A, C = oracle.companion(eigenvalues)
    h, n = critical_length(eigenvalues), len(eigenvalues)
    signs = set()
    rng = np.random.default_rng(11)
    for reach in (0.9, 1.0 + 1e-2):
        for k in range(1, n):
            for _ in range(12):
                left, right = np.sort(rng.uniform(0, 2e-2 * h, n - k)), np.sort(rng.uniform(0, 2e-2 * h, k))
                left[0], right[0] = 0.0, 0.0
                times = np.concatenate([left, np.sort(reach * h - right)])
                signs.add((reach, int(oracle.mp.sign(oracle.determinant(A, C, times)))))
    below, above = ({s for r, s in signs if (r > 1) == over} for over in (False, True))
    assert len(below) == 1
    assert above >= {1, -1}


@pytest.mark.long
def test_stiff_spectra_keep_accuracy():
    """Minors of e^{A_c t} itself lose all digits where real parts differ by 30/t; the compound does not."""
    for eigenvalues in ([-10, 0.1 + 1j, 0.1 - 1j], [10, 0.1 + 1j, 0.1 - 1j], [-30, -3, 0.1 + 1j, 0.1 - 1j]):
        h = critical_length(eigenvalues)
        assert oracle.minor_zero(eigenvalues, 1.0, 0.9999 * h, 40) is None
        assert oracle.minor_zero(eigenvalues, 0.9999 * h, 1.0001 * h, 20) == pytest.approx(h, rel=1e-4)


def test_time_scales_with_the_spectrum():
    base = np.array([0, 0.3 + 1j, 0.3 - 1j, 2j, -2j])
    one = critical_length(base)
    for factor in (1e-5, 7.3, 1e4):
        assert critical_length(base * factor) * factor == pytest.approx(one, rel=1e-6)


@pytest.mark.long
def test_it_lies_between_its_two_bounds():
    rng = np.random.default_rng(2)
    for _ in range(25):
        pairs = rng.standard_normal(2) + 1j * rng.uniform(0.3, 3.0, 2)
        values = [*pairs, *pairs.conj(), *rng.standard_normal(rng.integers(0, 3))]
        omega, n = np.max(np.abs(np.imag(values))), len(values)
        assert np.pi / omega * (1 - 1e-12) <= critical_length(values) <= (n - 1) * np.pi / omega * (1 + 1e-12)


def test_the_compound_of_a_matrix_generates_its_minors():
    from itertools import combinations

    from scipy.linalg import expm

    A = np.random.default_rng(4).standard_normal((4, 4))
    for k in (1, 2, 3, 4):
        sets = list(combinations(range(4), k))
        minors = np.array([[np.linalg.det(expm(A)[np.ix_(r, c)]) for c in sets] for r in sets])
        np.testing.assert_allclose(expm(_compound(A, k).toarray()), minors, rtol=1e-9, atol=1e-11)


def test_bad_input():
    with pytest.raises(ArgumentError, match="eigenvalues must be closed under conjugation"):
        critical_length([1j])
    with pytest.raises(ArgumentError, match="must have one output for its critical length, got"):
        critical_length(Plant(np.zeros((2, 2)), np.eye(2)))
    with pytest.raises(ArgumentError, match="must have at most 12 states for its critical length, got 14"):
        critical_length([s * k * 1j for k in range(1, 8) for s in (1, -1)])
    with pytest.raises(ArgumentError, match="`plant` is too stiff for its critical length"):
        critical_length([-1e5, -3, 0.1 + 1j, 0.1 - 1j])
    with pytest.raises(NotObservableError, match="the critical length needs every mode to be observable"):
        critical_length(Plant(np.diag([1.0, 2.0]), [[1.0, 0.0]]))
