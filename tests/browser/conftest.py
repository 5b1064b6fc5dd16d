"""A headless Chromium in which every request that would leave the machine is an error."""

import os
from pathlib import Path
from urllib.parse import urlsplit

import pytest

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
NEAR = ("file", "data", "blob", "about")


@pytest.fixture(scope="session")
def chromium():
    """Debian's browser, driven by playwright."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture
def page(chromium):
    """A page at desktop width whose `away` collects what it asked of other machines, and `broken` its errors."""
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    opened = context.new_page()
    opened.away, opened.broken = [], []

    def judge(route):
        parts = urlsplit(route.request.url)
        if parts.scheme in NEAR or parts.hostname in ("127.0.0.1", "localhost"):
            route.continue_()
        else:
            opened.away.append(route.request.url)
            route.abort()

    context.route("**/*", judge)
    opened.on("pageerror", lambda error: opened.broken.append(str(error)))
    yield opened
    context.close()


@pytest.fixture
def shot():
    """Keep a picture of a page, where `SHOTS` names a folder."""

    def keep(page, name):
        if os.environ.get("SHOTS"):
            page.screenshot(path=Path(os.environ["SHOTS"]) / f"{name}.png", full_page=False)

    return keep
