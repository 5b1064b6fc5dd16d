"""What the pages have beyond their text: boxes, links to the theory, words for pictures, and nothing from elsewhere."""

import hashlib
import importlib.util
import re
from collections import Counter
from pathlib import Path

import pytest
from docutils import nodes

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def house():
    spec = importlib.util.spec_from_file_location("house_pages", DOCS / "house_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def paragraph(lead, rest="", kind=nodes.strong, line=0):
    found = nodes.paragraph("", "", kind("", lead), nodes.Text(rest))
    found.line = line
    return found


def test_a_statement_and_its_formula_stand_in_one_box_and_the_proof_in_another(house):
    formula, plain = nodes.math_block("", "x"), nodes.paragraph("", "Something else.")
    section = nodes.section("", nodes.title("", "8.1 Along one schedule"))
    section += [paragraph("Statement.", " It holds"), formula, paragraph("Proof.", kind=nodes.emphasis), plain]
    plain.line, source = 3, ["proof", "", "Something else."]
    house._box_section(section, "8.1", source)
    boxes = [c for c in section.children if isinstance(c, nodes.container)]
    assert [b["classes"][1] for b in boxes] == ["statement", "proof"]
    assert boxes[0].astext().startswith("Statement 8.1.")
    assert formula in boxes[0].children
    assert plain in section.children


def test_corrections_are_boxes_of_their_own_colour(house):
    assert house._kind(paragraph("E14 · Definition 6 allows it.")) == "wrong"
    assert house._kind(paragraph("Theorem 9.")) == "statement"
    assert house._kind(paragraph("Method.")) == ""
    assert house._kind(nodes.paragraph("", "Theorem 9 is cited here.")) == ""


def test_a_solution_is_folded_up_to_the_next_exercise(house):
    section = nodes.section("", nodes.title("", "Counting"))
    code, second = nodes.literal_block("", "1 + 1"), paragraph("2.", " And now?")
    section += [paragraph("1.", " Why?"), paragraph("Solution.", " So."), code, second]
    document = nodes.section("", section)
    house.solutions(None, document)
    (folded,) = document.findall(house.details)
    assert folded.astext().split() == ["So.", "1", "+", "1"]
    assert section.children[-1] is second


def test_what_a_docstring_cites_leads_to_the_theory(house):
    labels = house.section_labels(DOCS / "theory")
    assert labels["8.1"] == "window-sigma"
    assert labels["E19"] == "errata-e19"
    line = house.linked("as printed (theory 3.1), see theory E19, E99.", labels)
    assert line.count(":ref:`") == 2
    assert house.linked("E19 without the word stays", labels) == "E19 without the word stays"


def test_every_section_of_the_theory_has_a_number_of_its_own():
    headings = [h for p in (DOCS / "theory").glob("*.md") for h in re.findall(r"^#+ (\d[\d.]*) ", p.read_text(), re.M)]
    assert [h for h, count in Counter(headings).items() if count > 1] == []
    order = (DOCS / "theory" / "index.md").read_text().split("```{toctree}\n")[1].split("```")[0].split()
    first = [int((DOCS / "theory" / f"{name}.md").read_text().split("# ", 1)[1].split()[0]) for name in order]
    assert first == sorted(first)


def test_pictures_are_described_by_what_their_axes_say(house):
    code = "fig, ax = plt.subplots()\nax.set(xlabel='time [s]', title='red: blind')\nax.set_ylabel('sigma')"
    assert set(house.words_of(code).split("; ")) == {"red: blind", "time [s]", "sigma"}
    assert house.words_of("design.plot()") == "drawn by design.plot()"
    assert house.words_of("%matplotlib inline") == ""


def test_the_mathematics_is_drawn_by_the_file_that_its_page_names():
    folder = DOCS / "_static" / "mathjax"
    conf = (DOCS / "conf.py").read_text()
    stated = re.search(r"^    ([0-9a-f]{64})$", (folder / "README.md").read_text(), re.MULTILINE)[1]
    assert hashlib.sha256((folder / "tex-svg-full.js").read_bytes()).hexdigest() == stated
    assert 'mathjax_path = "mathjax/tex-svg-full.js"' in conf
    assert "http" not in re.sub(r'""".*?"""', "", conf, flags=re.DOTALL)
    assert "Apache License" in (folder / "LICENSE").read_text()


def test_no_heading_holds_tex():
    pages = [p for p in DOCS.rglob("*.md") if not {"_build", "made", "_static"} & set(p.relative_to(DOCS).parts)]
    found = [line for p in pages for line in re.findall(r"^#+ .*\$.*$", p.read_text(), re.MULTILINE)]
    assert found == []


def test_what_is_printed_in_columns_scrolls(house):
    cell = '<div class="output {} notranslate"><div class="highlight"><pre><span></span>{}</pre></div></div>'
    table, prose = "Plan\n  what   a plan\n  <b>cost</b>   3\n", "One sentence.  And\nanother: it goes on below.\n"
    for kind in ("stream highlight-myst-ansi", "text_plain"):
        assert '<pre class="columns">' in house.kept_columns(cell.format(kind, table))
        assert house.kept_columns(cell.format(kind, prose)) == cell.format(kind, prose)
    typed = cell.format("cell_input", table)
    assert house.kept_columns(typed) == typed


def test_a_command_breaks_between_its_words_only(house):
    space, head = '<span class="w"> </span>', '<div class="highlight-sh notranslate"><div class="highlight"><pre>'
    day = '<span class="m">7</span>-22'
    body = f"<p>--open</p>{head}new{space}--open{space}{day}\n{'x' * 100}\n</pre></div></div>"
    shown = house.whole_words(body)
    words = [f'<span class="word">{word}</span>' for word in ("new", "--open", day)]
    assert shown == f"<p>--open</p>{head}{space.join(words)}\n{'x' * 100}\n</pre></div></div>"
    python = body.replace("highlight-sh", "highlight-python")
    assert house.whole_words(python) == python
    context = {"body": body}
    house.lines_as_they_are_read(None, "index", "page.html", context, None)
    assert context == {"body": shown}
    house.lines_as_they_are_read(None, "search", "search.html", empty := {}, None)
    assert empty == {}
