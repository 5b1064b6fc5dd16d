"""Every page of the documentation from a disk, without network: no raw TeX, no request away, pictures with words."""

import functools
import http.server
import os
import re
import threading
from pathlib import Path

import pytest

HTML = Path(os.environ.get("DOCS_HTML", Path(__file__).parents[2] / "docs" / "_build" / "html"))
PAGES = sorted(str(p.relative_to(HTML)) for p in HTML.rglob("*.html") if "_static" not in p.parts)
PHONE = {"width": 390, "height": 844}
MADE_IN_PASSING = re.compile(r" at 0x[0-9a-f]{6}|^Text\(")  # what a line that draws returns, and no reader asked for

# text that a reader sees, without code and without what is read aloud only
READ = """() => {
  const copy = document.querySelector('article, [role=main]').cloneNode(true);
  copy.querySelectorAll('pre, code, script, style, mjx-container').forEach((node) => node.remove());
  return copy.textContent;
}"""
WIDE = """() => [...document.querySelectorAll('article *')].filter((node) => {
  if (node.closest('.table-wrapper, pre, .math, mjx-container, details:not([open]), svg')) return false;
  return node.getBoundingClientRect().right > window.innerWidth + 1;
}).map((node) => node.tagName + ' ' + node.textContent.slice(0, 60))"""

# formulas that a phone cuts off: they reach beyond the screen, and nothing around them scrolls
CUT = """() => [...document.querySelectorAll('article mjx-container')].filter((node) => {
  if (node.closest('details:not([open])')) return false;
  if (node.getBoundingClientRect().right <= window.innerWidth + 1) return false;
  for (let around = node.parentElement; around.tagName !== 'ARTICLE'; around = around.parentElement) {
    const style = getComputedStyle(around);
    if (style.display !== 'inline' && ['auto', 'scroll'].includes(style.overflowX)) return false;
  }
  return true;
}).map((node) => node.closest('p, li, td, dd, div').textContent.slice(0, 60))"""


def settle(page, name, address=None):
    page.goto(address or (HTML / name).as_uri(), wait_until="load")
    if page.evaluate("typeof MathJax !== 'undefined'"):
        page.evaluate("MathJax.startup.promise")


def test_there_are_pages():
    assert len(PAGES) > 40
    assert "index.html" in PAGES


@pytest.mark.parametrize("name", PAGES)
def test_a_page_shows_its_mathematics_and_asks_nobody(name, page, shot):
    settle(page, name)
    text = page.evaluate(READ)
    for raw in (r"\(", r"\[", "\\begin{", "\\frac", "\\sigma", "$$"):
        assert raw not in text, text[max(text.find(raw) - 80, 0) :][:200]
    assert not re.search(r"(?<!\S)[\u2013\u2014][a-z]", text)  # an option whose two hyphens became a dash
    formulas = page.locator("article .math").count()
    assert page.locator("article .math mjx-container").count() >= formulas
    assert page.locator("mjx-merror, [data-mml-node=merror]").count() == 0
    assert page.away == []
    assert page.broken == []
    pictures = page.locator("article img:not(.toggler)").all()
    assert [p.get_attribute("src") for p in pictures if len(p.get_attribute("alt") or "") < 15] == []
    assert [text for text in page.locator("article pre").all_inner_texts() if MADE_IN_PASSING.search(text)] == []
    assert page.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    shot(page, name.replace("/", "-").removesuffix(".html"))
    page.set_viewport_size(PHONE)
    assert page.evaluate(WIDE) == []
    assert page.evaluate(CUT) == []
    shot(page, "phone-" + name.replace("/", "-").removesuffix(".html"))


def test_the_home_page_answers_within_one_screen(page):
    settle(page, "index.html")
    for what in ("article p", "article img", "article pre"):
        box = page.locator(what).first.bounding_box()
        assert box["y"] + box["height"] <= 800, f"{what} ends at {box['y'] + box['height']}"


def test_a_solution_is_folded_until_it_is_asked_for(page):
    settle(page, "exercises.html")
    first = page.locator("details.solution").first
    inside = first.locator("p, pre").first
    assert not inside.is_visible()
    first.locator("summary").click()
    assert inside.is_visible()


@pytest.mark.parametrize("words", ["sigma", "discounted information", "oscillator"])
def test_what_the_search_shows_has_no_raw_tex(words, page, shot):
    handler = functools.partial(QuietHandler, directory=str(HTML))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/search.html?q={words.replace(' ', '+')}"
        page.goto(address)
        page.wait_for_selector("#search-results li p.context")
        page.wait_for_function("document.querySelector('#search-results .search-summary, #search-results p')")
        page.wait_for_timeout(400)
        text = page.locator("#search-results").inner_text()
        server.shutdown()
    assert len(text) > 200
    assert "\\" not in text
    assert "$" not in text
    assert page.away == []
    shot(page, f"search-{words.split()[0]}")


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves the built pages without a word."""

    def log_message(self, *_):
        """Say nothing."""
