"""Few cases of a law by default, and all of them under `--long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def few(cases: Iterable[Any], *kept: int) -> list[Any]:
    """The cases, of which all but those at the places `kept` are marked as long; a tuple is several arguments."""
    listed = list(cases)
    assert 0 < len(set(kept)) < len(listed), "keep some of the cases, and leave out some"
    assert all(0 <= place < len(listed) for place in kept), "there is no case at that place"
    return [case if place in kept else _long(case) for place, case in enumerate(listed)]


def _long(case: Any) -> Any:
    values, marks, name = (case,) if not isinstance(case, tuple) else case, [], None
    if hasattr(case, "marks"):
        values, marks, name = case.values, list(case.marks), case.id
    return pytest.param(*values, marks=[*marks, pytest.mark.long], id=name)
