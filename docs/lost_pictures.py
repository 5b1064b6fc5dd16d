"""Which pages draw or print something when they are executed, and show less than that."""

import html
import json
import re

DRAWS = re.compile(
    r"^(?!\s|plt\.(?:close|rcParams|style))[^\n]*?(?:\.plot\(|\bplt\.|\bdraw\(|\.figure\(\d|\bsubplots\()", re.MULTILINE
)
"""Statements of a cell that draw; what a function would draw, or a backend that is chosen, shows nothing yet."""


def drawing_cells(source):
    """Count the executed cells of a page (a notebook, or markdown with code cells) that draw something."""
    if source.suffix == ".ipynb":
        cells = ["".join(c["source"]) for c in json.loads(source.read_text())["cells"] if c["cell_type"] == "code"]
    else:
        cells = re.findall(r"^```\{code-cell\}(.*?)^```", source.read_text(), flags=re.DOTALL | re.MULTILINE)
    return sum(bool(DRAWS.search(cell)) for cell in cells)


def silent_cells(page):
    """Return the cells of a built page that print, and show nothing."""
    silent = []
    for cell in page.split('<div class="cell ')[1:]:
        typed = re.search(r"<pre>(.*?)</pre>", cell, flags=re.DOTALL)
        text = html.unescape(re.sub("<[^>]+>", "", typed.group(1))) if typed else ""
        silent += [text] if re.search(r"\bprint\(", text) and "cell_output" not in cell else []
    return silent


def doubled_pictures(page):
    """Return the pictures that a built page shows more than once: a figure that ends its cell is shown again."""
    shown = re.findall(r'<img\b[^>]*\bsrc="([^"]+)"', page)
    return sorted({each for each in shown if shown.count(each) > 1})


def lost_pictures(sources, folder):
    """Say which pages draw and have fewer pictures than cells that draw: {page: (wanted, found)}."""
    lost = {}
    for page, source in sources.items():
        wanted, built = drawing_cells(source), folder / f"{page}.html"
        main = re.search(r"<article.*?</article>", built.read_text(), flags=re.DOTALL) if built.exists() else None
        found = len(re.findall(r"<img\b", main.group())) if main else 0
        if found < wanted:
            lost[page] = (wanted, found)
    return lost
