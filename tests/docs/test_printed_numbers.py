"""What a page prints is what the package says today: figures in its text are recomputed, and their number is known.

Cells of pages are executed when they are built, and pages that a program makes say which and when. What is left are
figures in running text: `FIGURES` says from what each comes, and those that nothing recomputes only grow fewer.
"""

import contextlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.observability.count.loss_tolerance import loss_tolerance

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "theory").glob("*.md"))]
UNTIED = 491
"""Figures with decimals or percents in running text that nothing recomputes: lower this where there are fewer."""
SPIRAL = sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
QUARTER = np.pi / 2


@dataclass(frozen=True)
class Figure:
    """Numbers in the text of a page: each group of the pattern is one, and `made` returns them."""

    page: str
    pattern: str
    made: Callable[[], tuple[float, ...]]


def critical_length(*eigenvalues):
    A = np.vstack([np.eye(len(eigenvalues))[1:], -np.real(np.poly(eigenvalues))[:0:-1]])
    return lambda: (sd.zero_count_bound(sd.Plant(A, np.eye(1, len(A))), 1.0).critical_length,)


def borne(*gaps):
    return lambda: (loss_tolerance(SPIRAL, sd.PeriodicSchedule(gaps)).lower,)


def inside_a_gap():
    plant = sd.Plant([[0.0, 3.0], [-3.0, 0.0]], [[1.0, 0.0]])
    made = sd.certify(plant, sd.PeriodicSchedule([1.0]), eta=0.5, P2=np.diag([0.1, 1.0]), Qw=100 * np.eye(2))
    return made.lam_samples, made.witness.ratio, made.witness.start


TABLE = r"\| {} \| (\d*\.?\d+) \|"
FIGURES = (
    Figure("theory/counting.md", TABLE.format(r"\$\\pm i\$"), critical_length(1j, -1j)),
    Figure("theory/counting.md", TABLE.format(r"\$0,\\pm i\$; \$0,0,\\pm i\$"), critical_length(0, 1j, -1j)),
    Figure("theory/counting.md", r"\$0,0,\\pm i\$ \| (\d*\.?\d+) \|", critical_length(0, 0, 1j, -1j)),
    Figure("theory/counting.md", TABLE.format(r"\$0,0,0,\\pm i\$"), critical_length(0, 0, 0, 1j, -1j)),
    Figure("theory/counting.md", r"\$\\pm i,\\pm2i\$.* \| (\d*\.?\d+) \|", critical_length(1j, -1j, 2j, -2j)),
    Figure("theory/counting.md", r"\\pm i,\\pm3i\$; .* \| (\d*\.?\d+) \|", critical_length(1j, -1j, 3j, -3j)),
    Figure("theory/counting.md", r"\$0,\\pm i,\\pm3i\$ \| (\d*\.?\d+) \|", critical_length(0, 1j, -1j, 3j, -3j)),
    Figure("theory/counting.md", TABLE.format(r"\$-1,-2,0.1\\pm i\$"), critical_length(-1, -2, 0.1 + 1j, 0.1 - 1j)),
    Figure("theory/counting.md", r"evenly spaced samples bear (\d*\.?\d+)", borne(*[QUARTER] * 4)),
    Figure(
        "theory/counting.md",
        r"uneven ones to a period (\d*\.?\d+), no schedule as dense (\d*\.?\d+)",
        lambda: (*borne(*QUARTER * np.array([0.6, 1.1, 0.8, 1.5]))(), np.exp(-0.1 * np.pi)),
    ),
    Figure("theory/certificate.md", r"has (\d*\.?\d+) there and (\d*\.?\d+) at (\d*\.?\d+) into", inside_a_gap),
    Figure("numerics.md", r"\| (\d*\.?\d+) where (\d*\.?\d+) is true", lambda: inside_a_gap()[:2]),
)


def text_of(page):
    return (ROOT / page if page == "README.md" else ROOT / "docs" / page).read_text()


def decimals(text):
    return len(text.partition(".")[2])


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.page)
def test_figures_in_the_text_are_what_the_package_says(figure):
    said = re.search(figure.pattern, text_of(figure.page))
    assert said, f"{figure.page} says no more {figure.pattern}: take its line out of FIGURES, or mend it"
    for text, value in zip(said.groups(), figure.made(), strict=True):
        assert abs(float(text) - value) <= 0.5001 * 10.0 ** -decimals(text), f"{figure.page}: {text} is {value}"


def test_a_wrong_figure_is_found():
    wrong = Figure("numerics.md", r"\| (\d*\.?\d+) where (\d*\.?\d+) is true", lambda: (13.1, 30.0))
    with pytest.raises(AssertionError, match=r"31.2 is 30.0"):
        test_figures_in_the_text_are_what_the_package_says(wrong)


@pytest.mark.long
def test_a_researchers_journey_prints_what_its_table_says(tmp_path, monkeypatch):
    """Every figure of its table but the seconds stands in what its code prints, more digits there or none."""
    part = text_of("journeys.md").split("## A researcher", 1)[1].split("## A lecturer", 1)[0]
    code, table = re.search(r"```python\n(.*?)```", part, re.DOTALL)[1], part.split("| step |", 1)[1]
    said = " ".join(row.split("|")[2] for row in table.splitlines()[2:] if row.count("|") == 4)
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "journeys.md", "exec"), {})
    numbers = [float(text) for text in re.findall(r"\d+\.?\d*(?:e-?\d+)?", printed.getvalue())]
    figures = re.findall(r"(?<![\d.])\d+(?:\.\d+)?", said)
    assert len(figures) > 10
    lost = [
        text for text in figures if not any(abs(float(text) - n) <= 0.5001 * 10.0 ** -decimals(text) for n in numbers)
    ]
    assert lost == [], printed.getvalue()


def running_text(page):
    """The page without code, formulas, links and headings."""
    for block in (r"\A---\n.*?\n---\n", r"```.*?```", r"\$\$.*?\$\$"):
        page = re.sub(block, "", page, flags=re.DOTALL)
    for piece in (r"`[^`]*`", r"\$[^$]*\$", r"\[[^\]]*\]\([^)]*\)", r"(?m)^#.*$"):
        page = re.sub(piece, "", page)
    return page


def test_figures_that_nothing_recomputes_grow_fewer():
    found = {}
    for path in PAGES:
        page = path.read_text()
        name = path.name if path.parent == ROOT else str(path.relative_to(ROOT / "docs"))
        if name != "changelog.md" and not re.search(r"^(Made|Written) by `", page, re.MULTILINE):
            figures = re.findall(r"(?<![\w.])\d*\.\d+(?![\d.]*\w)|\d %", running_text(page))
            tied = sum(re.compile(figure.pattern).groups for figure in FIGURES if figure.page == name)
            found[name] = len(figures) - tied
    assert sum(found.values()) <= UNTIED, found
