"""Every page of the documentation, whole, at the width of a desk and of a phone, many on one picture: to be looked at.

`python -m tests.browser.contact_sheets docs/_build/html sheets [PART OF A NAME ...]`
"""

from __future__ import annotations

import io
import math
import sys
from pathlib import Path

from PIL import Image, ImageDraw

from tests.browser.conftest import FLAGS

WIDTHS = {"desk": (1280, 800), "phone": (390, 844)}
SHOWN = {"desk": 760, "phone": 390}
"""Pixels that a page is wide on a sheet."""
SHEET = (1560, 1560)
GAP = 14
LISTS = ("genindex.html", "py-modindex.html", "search.html")
"""Pages that nobody reads from top to bottom, left out unless they are named."""
TALLEST = 30_000
"""Pixels of a page beyond which the rest is cut off; a word on the sheet says so."""


def whole_page(page, path: Path) -> tuple[Image.Image, bool]:
    """Return the picture of a page from top to bottom, and whether its end is missing."""
    page.goto(path.as_uri(), wait_until="load")
    if page.evaluate("typeof MathJax !== 'undefined'"):
        page.evaluate("MathJax.startup.promise")
    tall = page.evaluate("document.documentElement.scrollHeight")
    size = page.viewport_size
    clip = {"x": 0, "y": 0, "width": size["width"], "height": min(tall, TALLEST)}
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True, clip=clip))).convert("RGB")
    return picture, tall > TALLEST


def strips(picture: Image.Image, width: int) -> list[Image.Image]:
    """Return a page in pieces that fit on a sheet, one after the other."""
    scaled = picture.resize((width, max(1, round(picture.height * width / picture.width))), Image.Resampling.LANCZOS)
    tall = SHEET[1] - 24
    return [
        scaled.crop((0, k * tall, width, min((k + 1) * tall, scaled.height)))
        for k in range(math.ceil(scaled.height / tall))
    ]


def sheets(pieces: list[tuple[str, Image.Image]]) -> list[Image.Image]:
    """Lay pieces in columns, short ones below each other."""
    made, column, top = [], SHEET[0], SHEET[1]
    for name, piece in pieces:
        if top + piece.height + 24 > SHEET[1]:
            column, top = column + (piece.width + GAP if made else 0), 0
        if not made or column + piece.width > SHEET[0]:
            made.append(Image.new("RGB", SHEET, (200, 205, 235)))
            column, top = 0, 0
        ImageDraw.Draw(made[-1]).text((column + 4, top + 4), name, fill=(0, 0, 0))
        made[-1].paste(piece, (column, top + 20))
        top += piece.height + 24
    return made


def main() -> None:
    """Write the sheets of all pages, or of those whose name holds one of the words."""
    from playwright.sync_api import sync_playwright

    html, out, words = Path(sys.argv[1]).resolve(), Path(sys.argv[2]), sys.argv[3:]
    out.mkdir(parents=True, exist_ok=True)
    names = sorted(str(p.relative_to(html)) for p in html.rglob("*.html") if "_static" not in p.parts)
    names = [name for name in names if (any(word in name for word in words) if words else name not in LISTS)]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=list(FLAGS))
        for kind, (width, height) in WIDTHS.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            pieces = []
            for name in names:
                picture, cut = whole_page(page, html / name)
                parts = strips(picture, SHOWN[kind])
                told = [f"{name}{f', {k + 1} of {len(parts)}' * (len(parts) > 1)}" for k in range(len(parts))]
                told[-1] += " (its end is cut off)" * cut
                pieces += list(zip(told, parts, strict=True))
            for k, sheet in enumerate(sheets(pieces), 1):
                sheet.save(out / f"{kind}-{k:02d}.png")
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
