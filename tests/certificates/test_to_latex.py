"""A certificate as an appendix in LaTeX: what is printed is what the record holds, and no name ends the document."""

import re

import numpy as np
import pytest

from sampling_design import Certificate, GapRange, PeriodicSchedule, Plant, certify
from sampling_design.certificates import certify_detectability
from sampling_design.records.declarations import in_latex, latex_matrix, latex_number

ROUGH = "50 % & #1_x^2 {~} \\end{document} $<|>$"
OSCILLATOR = Plant(
    [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="s", name=ROUGH, states=["a_b", "{c\\"], outputs=["%"]
)
EVERY = PeriodicSchedule([1.0, 2.0], time_unit="s")
SMALL = 1e-7 * np.array([[2.0, 0.5], [0.5, 1.0]])
MADE = {
    "one schedule": lambda: certify(OSCILLATOR, EVERY, eta=0.4, P2=SMALL),
    "a family": lambda: certify(OSCILLATOR, GapRange(0.8, 1.2), eta=0.3, P2=np.eye(2)),
    "the plant alone": lambda: certify_detectability(OSCILLATOR),
}


def number(text):
    return float(text.replace(r" \cdot 10^{", "e").replace("}", "").replace(r"\infty", "inf"))


def matrices(text):
    found = re.findall(
        r"^  (\w+) &= \\left\[\\begin\{(?:array\}\{r+|smallmatrix)\} (.*) \\end\{(?:array|smallmatrix)\}",
        text,
        re.MULTILINE,
    )
    return {
        name.replace("_", ""): np.array([[number(v) for v in row.split(" & ")] for row in rows.split(r" \\ ")])
        for name, rows in found
    }


def balanced(text):
    """Whether braces, dollars and environments close in the order in which they open."""
    bare, depth, stack = re.sub(r"\\[\\{}$%&#_]", "", text), 0, []
    for sign in bare:
        depth += (sign == "{") - (sign == "}")
        assert depth >= 0
    for what, name in re.findall(r"\\(begin|end)\{(\w+\*?)\}", text):
        if what == "begin":
            stack.append(name)
        else:
            assert stack.pop() == name
    return depth == 0 and not stack and all(line.count("$") % 2 == 0 for line in bare.splitlines())


@pytest.mark.parametrize("what", MADE)
def test_what_is_printed_is_what_the_record_holds(what):
    made = MADE[what]()
    text = made.to_latex()
    shown = matrices(text)
    assert set(shown) == {*made._weights, "A", "C", "G"}
    for name, matrix in shown.items():
        held = getattr(made if name in made._weights else made.plant, name)
        assert np.allclose(matrix, held, rtol=1e-5, atol=0), name
    values = [number(v) for v in re.findall(r"^  \$[^$]*\$ & \$([^$]*)\$ &", text, re.MULTILINE)]
    assert np.allclose(values, [each.value for each in made._numbers()], rtol=1e-5)
    assert made.eta in np.round(values, 12) or np.isclose(values, made.eta, rtol=1e-5).any()
    assert str(made.to_dict()["digest"]) in text
    assert r"\textbf{Verdict.} proven." in text


@pytest.mark.parametrize("what", MADE)
def test_no_name_is_read_as_a_command(what):
    text = MADE[what]().to_latex()
    assert balanced(text)
    assert r"\end{document}" not in text
    line = next(line for line in text.splitlines() if "Plant." in line)
    assert r"50 \% \& \#1\_x\textasciicircum{}2" in line
    assert r"states a\_b, \{c\textbackslash{}; time in s" in line
    assert not balanced(text + "{")
    assert not balanced(text + r"\begin{array}")


def test_the_family_is_named_once():
    lines = dict(re.findall(r"textbf\{(.*?)\.\} (.*?)\.\\par", MADE["a family"]().to_latex()))
    assert lines["Assumptions"] == "linear plant"
    assert lines["Sample times"] == "Every schedule whose gaps lie between 0.8 and 1.2"


def test_what_does_not_hold_is_printed_as_refuted():
    weights = {"P1": 2 * np.eye(2), "P2": np.eye(2), "Qw": np.eye(2), "R": [[1.0]], "Qv": [[1.0]]}
    assert r"\textbf{Verdict.} refuted." in Certificate.from_matrices(OSCILLATOR, EVERY, **weights, eta=0.4).to_latex()


def test_a_matrix_that_no_page_holds_is_left_to_the_file():
    size = 40
    many = Plant(-np.eye(size), np.ones((1, size)), time_unit="s")
    text = certify(many, EVERY, eta=0.1, P2=np.eye(size), R=[[1.0]], Qw=np.eye(size), Qv=[[1.0]]).to_latex()
    assert set(matrices(text)) == {"R", "Qv"}


def test_long_rows_are_set_in_small_type():
    short_rows, long_rows = np.full((2, 4), 0.25), np.full((2, 4), -1.23456e-7)
    assert "{array}{rrrr}" in latex_matrix(short_rows)
    assert "{smallmatrix}" in latex_matrix(long_rows)
    assert np.allclose(matrices(f"  M &= {latex_matrix(long_rows)}")["M"], long_rows, rtol=1e-5)
    assert latex_matrix(np.full((2, 8), -1.23456e-7)) == ""


def test_greek_letters_are_mathematics():
    assert in_latex("Σ of α") == r"$\Sigma$ of $\alpha$"


@pytest.mark.parametrize(
    ("value", "text"), [(0.4, "0.4"), (1.5e-9, r"1.5 \cdot 10^{-9}"), (-2e12, r"-2 \cdot 10^{12}"), (np.inf, r"\infty")]
)
def test_numbers_are_powers_of_ten(value, text):
    assert latex_number(value) == text
    assert number(text) == value


def test_every_sign_of_a_keyboard_is_text():
    keys = "".join(map(chr, range(33, 127)))
    assert balanced(in_latex(keys))
    assert not re.search(r"(?<!\\)[&%#_]", in_latex(keys))
