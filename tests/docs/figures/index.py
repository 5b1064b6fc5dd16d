"""docs/index.md: how many corrections of the paper there are."""

import tomllib
from pathlib import Path

from tests.docs.figures import Figure

ITEMS = Path(__file__).parents[3] / "docs" / "paper_items.toml"


def corrections():
    return (sum(item["kind"] == "erratum" for item in tomllib.loads(ITEMS.read_text())["item"]),)


FIGURES = (Figure("index.md", r"\[(\d+) corrections\]", corrections),)
