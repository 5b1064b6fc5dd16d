"""What a page prints is what the package says today: every figure in its text is recomputed.

Cells of pages are executed when they are built, and pages that a program makes say which and when. What is left are
figures in running text: `tests/docs/figures` says from what each comes, a module per page. What a reader gives (a
tolerance, a bound) is an input and stands in a code span or a formula, which are not counted.
"""

import re
from pathlib import Path

import pytest

from tests.docs.figures import Figure, all_figures

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "theory").glob("*.md"))]
FIGURES = all_figures()


def name_of(path):
    return path.name if path.parent == ROOT else str(path.relative_to(ROOT / "docs"))


def text_of(page):
    return (ROOT / page if page == "README.md" else ROOT / "docs" / page).read_text()


def decimals(text):
    return len(text.partition(".")[2])


def found_in(text, figure):
    """Where the page says it; a blank of the pattern is any white space."""
    return re.search(figure.pattern.replace(" ", r"\s+"), text)


def cases():
    return [pytest.param(f, id=f.page, marks=[pytest.mark.long] if f.slow else []) for f in FIGURES]


@pytest.mark.parametrize("figure", cases())
def test_figures_in_the_text_are_what_the_package_says(figure):
    said = found_in(text_of(figure.page), figure)
    for text, value in zip(said.groups(), figure.made(), strict=True):
        assert abs(float(text) - value) <= 0.5001 * 10.0 ** -decimals(text), f"{figure.page}: {text} is {value}"


def test_a_wrong_figure_is_found():
    wrong = Figure("numerics.md", r"\| (\d*\.?\d+) where (\d*\.?\d+) is true", lambda: (13.1, 30.0))
    with pytest.raises(AssertionError, match=r"31.2 is 30.0"):
        test_figures_in_the_text_are_what_the_package_says(wrong)


def running_text(page):
    """The page with blanks in place of code, formulas, links and headings."""
    for block in (r"\A---\n.*?\n---\n", r"```.*?```", r"\$\$.*?\$\$"):
        page = re.sub(block, blank, page, flags=re.DOTALL)
    for piece in (r"`[^`]*`", r"\$[^$]*\$", r"\[[^\]]*\]\([^)]*\)", r"(?m)^#.*$"):
        page = re.sub(piece, blank, page)
    return page


def blank(match):
    return " " * len(match[0])


def untied(name, page):
    """The figures of a page that no line of `FIGURES` recomputes."""
    text = list(running_text(page))
    for figure in (figure for figure in FIGURES if figure.page == name):
        said = found_in(page, figure)
        assert said, f"{name} says no more {figure.pattern}: mend its line of figures, or take it out"
        for first, last in said.regs[1:]:
            text[first:last] = " " * (last - first)
    return re.findall(r"(?<![\w.])\d*\.\d+(?![\d.]*\w)|\d %", "".join(text))


def test_every_figure_in_running_text_is_recomputed():
    pages = {name_of(path): path.read_text() for path in PAGES}
    written = {n: p for n, p in pages.items() if not re.search(r"^(Made|Written) by `", p, re.MULTILINE)}
    assert not {figure.page for figure in FIGURES if figure.page.endswith(".md")} - set(written)
    found = {name: left for name, page in written.items() if (left := untied(name, page))}
    assert found == {}, "figures with decimals or percents that no line of `tests/docs/figures` recomputes"


def test_a_figure_that_nothing_recomputes_is_found():
    page = "It takes 1.5 s, and $\\eta=.5$ or `--gap 0.3` 7 % more."
    assert untied("numerics.md", text_of("numerics.md") + page) == ["1.5", "7 %"]
