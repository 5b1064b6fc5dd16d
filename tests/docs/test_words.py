"""Pages use the standard terms: none of the words that the table of conventions replaces."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
REPLACED = re.compile(
    r"\b(push\w*|rasters?|motions?|go(?:es)? round|shadows?|bears|readings? of w|seal(?:s|ed)?|tall(?:y|ies)|"
    r"largest box|noise budgets?|sharp(?:er)? (?:horizons?|theorems?)|prototyp\w+|"
    r"unseen|blind|wild|flown|flights?|atoms?|told)\b",
    re.IGNORECASE,
)
PAGES = [
    ROOT / "README.md",
    *(p for p in (ROOT / "docs").rglob("*.md") if not {"_build", "made"} & set(p.parts)),
    *(ROOT / "sampling_design").rglob("README.md"),
    *(ROOT / "examples").rglob("*.md"),
    *(ROOT / "examples").rglob("*.ipynb"),
]


def text_of(page: Path) -> str:
    """What a page says: of a notebook its text without the code."""
    if page.suffix != ".ipynb":
        return page.read_text()
    cells = json.loads(page.read_text())["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def replaced_words(text: str) -> list[str]:
    """What running text says of them; code, links, anchors and the table of words itself are left out."""
    text = re.sub(r"^\| not \| but \|$.*?^$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"```.*?```|`[^`\n]*`|\]\([^)]*\)|^\([\w-]+\)=$", " ", text, flags=re.MULTILINE | re.DOTALL)
    return [found[0] for found in REPLACED.finditer(text)]


def test_no_page_uses_a_word_that_was_replaced():
    found = {str(p.relative_to(ROOT)): words for p in PAGES if (words := replaced_words(text_of(p)))}
    assert found == {}
    assert len(PAGES) > 80


def test_no_source_of_the_rooms_that_are_clean_uses_one():
    """Names, comments, docstrings and messages of seven rooms; of all rooms those words of which none is left."""
    package = ROOT / "sampling_design"
    clean = ("validation", "observability", "estimators", "accuracy", "planning", "nonlinear", "uncertain")
    for rooms, words in (
        (("validation", "estimators"), r"seen"),
        (clean, r"blind|unseen|told|atoms?|flown|tally|motions?|(?<!bound_)push\w*|flights?"),
        (("",), r"wild|(?<!step )rasters?|prototyp\w+"),  # after "step": the table of what people may type for `grid`
    ):
        replaced = re.compile(rf"(?<![a-z])(?:{words})(?![a-z])", re.IGNORECASE)
        files = [path for room in rooms for path in (package / room).rglob("*.py")]
        found = {str(p.relative_to(package)): replaced.findall(p.read_text()) for p in files}
        assert {name: said for name, said in found.items() if said} == {}
        assert len(files) > 40
    assert replaced.findall("wilder than wild_rasters") == ["wild", "rasters"]


def test_such_a_word_is_found():
    assert replaced_words("A motion that `push` hides\nbears the [sharper theorem](#x).\n") == [
        "motion", "bears", "sharper theorem",
    ]  # fmt: skip
    assert replaced_words("| not | but |\n|---|---|\n| raster | time grid |\n\nA raster.\n") == ["raster"]


INSIDE = re.compile(r"^(?!\$\$).*\S.*\n\$\$(?!\$)", re.MULTILINE)
"""A display that begins in the line after text is none: what follows is typeset as a formula, the formula as text."""


def test_no_display_begins_within_a_paragraph():
    inside = "so that\n$$x^2$$\nfor all $x$"
    assert INSIDE.search(inside)
    assert not INSIDE.search("so that\n\n$$x^2$$\n$$y^2$$\n\nfor all $x$")
    assert [
        p.name
        for p in PAGES
        if p.suffix == ".md" and INSIDE.search(re.sub(r"\$\$.+?\$\$", "$$", text_of(p), flags=re.DOTALL))
    ] == []
