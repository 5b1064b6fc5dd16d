"""What the cells of a page define, and whether two estimates are the same."""

import re
from pathlib import Path
from typing import Any

import numpy as np

DOCS = Path(__file__).parents[2] / "docs"


def defined_on(page: str) -> dict[str, Any]:
    """The names that the cells of a page define, run one after the other."""
    names: dict[str, Any] = {}
    for cell in re.findall(r"```\{code-cell\} python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL):
        exec(cell, names)
    return names


def check_same(found: Any, wanted: Any) -> None:
    """The same time, state and radius, to twelve digits."""
    assert found.t == wanted.t
    np.testing.assert_allclose(found.x, wanted.x, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.radius, wanted.radius, rtol=1e-12)
