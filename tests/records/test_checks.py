"""Arguments: every check accepts what it should, and refuses with one sentence that names the argument."""

import numpy as np
import pytest

from sampling_design import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import freeze


def test_freeze_owns_and_locks():
    mine = np.ones(3)
    frozen = freeze(mine)
    mine[0] = 7.0
    assert frozen[0] == 1.0
    assert not frozen.flags.writeable
    assert frozen.dtype == np.float64


def test_real_array_accepts_numbers_of_any_real_kind():
    for value in ([1, 2], (1.5, 2), np.array([True, False]), np.float32([1, 2])):
        assert checks.real_array("x", value, 1).dtype == np.float64


def test_whole_numbers_of_more_than_64_bits_are_numbers_as_far_as_a_double_holds_them():
    assert checks.real_array("x", [1, 10**20], 1).tolist() == [1.0, 1e20]
    assert checks.whole("k", 10**20) == 10**20
    for value in ([10**400], [10**20, "a"], [10**20, None]):
        with pytest.raises(ArgumentError, match="`x` must hold real numbers, got list"):
            checks.real_array("x", value, 1)


REFUSED = [
    (checks.word, ("x", "c", ("a", "b")), '`x` must be "a" or "b", got \'c\''),
    (checks.word, ("x", "d", ("a", "b", "c")), "`x` must be one of a, b, c, got 'd'"),
    (checks.word, ("x", np.ones(2), {"a": 1, "b": 2}), "got ndarray"),
    (checks.word, ("x", {"a": 1}, ("a", "b")), "got dict"),
    (checks.real_array, ("x", [[1, 2], [3]], 2), "`x` .*must be a rectangular array of numbers"),
    (checks.real_array, ("x", None, 1), "`x` must hold real numbers, got None"),
    (checks.real_array, ("x", ["a"], 1), "`x` must hold real numbers, got list"),
    (checks.real_array, ("x", [{}], 1), "`x` must hold real numbers"),
    (checks.real_array, ("x", [1j], 1), "`x` .*must be real, got complex entries"),
    (checks.real_array, ("x", [1.0], 2), r"`x` must have 2 dimensions, got shape \(1,\)"),
    (checks.real_array, ("x", [[1.0]], 1), r"`x` must have 1 dimension, got shape \(1, 1\)"),
    (checks.real_array, ("x", [0.0, np.nan], 1), r"`x` must be finite, got x\[1\] = nan"),
    (checks.real_array, ("x", [[0.0, -np.inf]], 2), r"`x` must be finite, got x\[0, 1\] = -inf"),
    (
        checks.matrix,
        ("M", [[1.0, 2.0]], 2, 1),
        r"`M` must have shape \(2, 1\), got \(1, 2\)\. Did you",
    ),
    (checks.matrix, ("M", [[1.0, 2.0]], 3), r"`M` must have shape \(3, 2\), got \(1, 2\)\.$"),
    (checks.vector, ("v", [1.0, 2.0], 1), "`v` must have 1 entry, got 2"),
    (checks.vector, ("v", [1.0], 2), "`v` must have 2 entries, got 1"),
    (checks.number, ("a", "3"), "`a` must be a number, got str '3'"),
    (checks.number, ("a", True), "`a` must be a number, got bool True"),
    (checks.number, ("a", [1.0]), "`a` must be a number, got list"),
    (checks.number, ("a", np.nan), "`a` must be finite"),
    (checks.number, ("a", None), "`a` must be a number, got None"),
    (checks.positive, ("a", 0.0), r"`a` must be positive, got 0\.0"),
    (checks.nonnegative, ("a", -1e-300), r"`a` must not be negative, got -1e-300"),
    (checks.whole, ("k", 1.5), r"`k` must be a whole number of at least 0, got 1\.5"),
    (checks.whole, ("k", 1, 2), "`k` must be a whole number of at least 2, got 1"),
    (checks.increasing, ("t", [-1.0, 2.0]), r"`t` must not be negative, got t\[0\] = -1\.0"),
    (
        checks.increasing,
        ("t", [1.0, 1.0]),
        r"`t` must increase strictly, got t\[1\] = 1\.0 which repeats t\[0\]",
    ),
    (checks.increasing, ("t", [1.0, 0.5], "Gaps?"), r"t\[1\] = 0\.5 which comes after t\[0\] = 1\.0\. Gaps\?"),
    (
        checks.symmetric,
        ("P", [[1.0, 2.0], [0.0, 1.0]], 2),
        "`P` .*must be symmetric, got entries that differ",
    ),
    (
        checks.definite,
        ("P", [[1.0, 0.0], [0.0, 0.0]], 2),
        r"`P` must be positive definite, got P\[1, 1\] = 0.0 on its diagonal.",
    ),
    (checks.definite, ("P", [[1.0, 1.0], [1.0, 1.0]], 2), "got least eigenvalue 0 once its diagonal is one."),
    (checks.definite, ("P", [[1e-300, 1e300], [1e300, 1.0]], 2), "got least eigenvalue -"),
    (checks.names, ("states", "ab", 2, "x"), "`states` must be a list of strings, got str 'ab'"),
    (checks.names, ("states", [1, 2], 2, "x"), "`states` must be a list of strings, got list"),
    (checks.names, ("states", ["a"], 2, "x"), "`states` must have 2 entries, got 1"),
    (checks.names, ("states", ["a", "a"], 2, "x"), "`states` must be distinct, got 'a' twice"),
    (checks.names, ("states", ["a", " "], 2, "x"), "`states` must not be blank, got ' '"),
    (checks.line, ("name", "a\u2028b"), r"`name` must be one line without control characters, got 'a.u2028b'"),
    (
        checks.known_keys,
        ("[x]", ["windw"], ["window", "period"]),
        r"unknown key 'windw' in \[x\]\. Did you mean 'win",
    ),
    (checks.known_keys, ("x", ["a"], ["A", "C"]), "unknown key 'a' in x. Did you mean 'A'"),
    (checks.known_keys, ("x", ["price"], ["available", "cost"]), "'price' in x. Known: 'available', 'cost'[.]$"),
    (checks.known_keys, ("x", ["dt"], ["A", "D"]), "unknown key 'dt' in x. Known: 'A', 'D'[.]$"),
    (checks.known_keys, ("x", ["raster"], ["format"]), "unknown key 'raster' in x. Known: 'format'[.]$"),
    (checks.known_keys, ("x", ["seconds"], ["sensors"]), "unknown key 'seconds' in x. Known: 'sensors'[.]$"),
    (checks.known_keys, ("x", ["noise"], ["noise_bound"]), "unknown key 'noise' in x. Did you mean 'noise_bound'"),
    (checks.known_keys, ("x", ["hours"], ["price", "calendar"]), "unknown key 'hours' in x. Did you mean 'calendar'"),
    (checks.known_keys, ("x", ["no"], [f"y{i}" for i in range(20)]), "Known: 'y0', .*, 'y11' and 8 more[.]$"),
    (
        checks.output_mask,
        ("outputs", [1, 0], 2),
        r"`outputs` must have shape .*, number of outputs",
    ),
    (checks.output_mask, ("outputs", [[1, 2]], 1), "`outputs` .*must hold True/False or 1/0 only"),
    (
        checks.output_mask,
        ("outputs", [[1], [0]], 2),
        "`outputs` .*must measure at least one output at each sample",
    ),
]


@pytest.mark.parametrize(("check", "arguments", "message"), REFUSED)
def test_refused(check, arguments, message):
    with pytest.raises(ArgumentError, match=message):
        check(*arguments)


def test_accepted_at_the_edge():
    assert checks.positive("a", 5e-324) == 5e-324
    assert checks.nonnegative("a", 0) == 0.0
    assert checks.whole("k", 2.0, 2) == 2
    assert checks.number("a", np.float32(1.5)) == 1.5
    assert checks.increasing("t", []).size == 0
    assert checks.increasing("t", [0.0, np.nextafter(0.0, 1.0)]).size == 2
    assert checks.matrix("M", np.zeros((0, 3)), 0, 3).shape == (0, 3)
    assert checks.names("states", None, 2, "x") == ("x1", "x2")
    assert checks.known_keys("[x]", ["window"], ["window"]) is None
    assert checks.definite("P", np.zeros((0, 0)), 0).shape == (0, 0)
    assert checks.output_mask("outputs", None, 3) is None
    np.testing.assert_array_equal(checks.output_mask("outputs", [[1, 0], [0, 1]], 2), np.eye(2, dtype=bool))


def test_rounding_of_a_symmetric_matrix_is_removed():
    P = np.array([[1.0, 0.5], [0.5 * (1 + 1e-15), 1.0]])
    result = checks.symmetric("P", P, 2)
    assert result[0, 1] == result[1, 0]
    with pytest.raises(ArgumentError, match="`P` must be symmetric"):
        checks.symmetric("P", P + np.array([[0.0, 1e-11], [0.0, 0.0]]), 2)


def test_symmetric_matrices_may_hold_the_largest_doubles():
    """The sum of an entry and its mirror is no double then."""
    P = np.diag([1.7e308, 1e-308])
    np.testing.assert_array_equal(checks.definite("P", P, 2), P)
    with pytest.raises(ArgumentError, match="`P` must be symmetric, got entries that differ from their mirror by inf"):
        checks.symmetric("P", [[1.0, 1e308], [-1e308, 1.0]], 2)


def test_a_refused_argument_is_not_changed():
    mine = np.array([2.0, 1.0])
    with pytest.raises(ArgumentError, match="`t` must increase strictly"):
        checks.increasing("t", mine)
    np.testing.assert_array_equal(mine, [2.0, 1.0])
    assert mine.flags.writeable


def test_lists_are_read_as_what_they_hold():
    assert checks.texts(["a", "b"]) == ("a", "b")
    assert checks.texts("ab") is checks.texts(["a", 1]) is checks.texts(None) is None
    assert [checks.holds(each, int) for each in ([1, 2], [1, "2"], 1)] == [True, False, False]
    assert checks.entries("pair", (1, 2), (2, 3), "pairs") == (1, 2)
    for wrong in ([1], "ab", 2.0):
        with pytest.raises(ArgumentError, match="`pair` must hold pairs, got"):
            checks.entries("pair", wrong, (2, 3), "pairs")
