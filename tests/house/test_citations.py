"""Every source that a docstring cites stands in docs/references.bib, or is a numbered item of the paper."""

import ast
import re

import pytest

from tests.house.sources import ROOT, SOURCES, nodes

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

BIBLIOGRAPHY = (ROOT / "docs" / "references.bib").read_text()
PAPER_ITEMS = re.compile(r"(Definition|Assumption|Theorem|Lemma|Remark|equation|Section|Appendix|appendix)")


def citations():
    for path in SOURCES:
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
                doc = ast.get_docstring(node) or ""
                if "References\n---" in doc:
                    body = doc.split("References\n", 1)[1].split("\n", 1)[1]
                    yield f"{path.stem}.{getattr(node, 'name', '')}", re.split(r"\n\n", body)[0]


def test_every_citation_can_be_found():
    found = list(citations())
    assert len(found) > 40
    for place, part in [(place, part) for place, text in found for part in re.split(r";\s+", " ".join(text.split()))]:
        if part.lower().startswith(("the paper", "theorem", "theory", "section")):
            assert PAPER_ITEMS.search(part) or "theory" in part.lower(), f"{place}: which item of the paper? {part}"
            continue
        names = re.findall(r"\b[A-Z][A-Za-z]{3,}\b", part)
        known = [name for name in names if name.lower() in BIBLIOGRAPHY.lower()]
        assert known or re.search(r"\d{4}\.\d{5}|RFC \d+", part), f"{place} cites {part!r}, not in references.bib"


def test_the_bibliography_has_no_key_twice():
    keys = re.findall(r"@\w+\{(\w+),", BIBLIOGRAPHY)
    assert len(keys) == len(set(keys)) > 10


def test_every_entry_of_the_bibliography_is_cited_and_leads_to_its_code():
    """The page says for each method what it rests on; a theory page may say it, too, but no entry stands unused."""
    rows = [line for line in (ROOT / "docs" / "references.md").read_text().splitlines() if line.startswith("| ")][1:]
    cited = [key for row in rows for keys in re.findall(r"\{cite:\w+\}`([^`]+)`", row) for key in keys.split(",")]
    assert sorted(cited) == sorted(re.findall(r"@\w+\{(\w+),", BIBLIOGRAPHY))
    for row in rows:
        places = re.findall(r"`([^`]+)`", row.split("|")[3])
        assert places, row
        assert [place for place in places if not (ROOT / "sampling_design" / place).exists()] == []
