"""Few cases of a law by default, and all of them under `--long`; weights that no bound changes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from sampling_design import CostFunction, Plant


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


def scale_weights(plant: Plant, **more: Any) -> CostFunction:
    """The weights of the plant's scales, for laws that change bounds: without weights each bound is one."""
    R = 2 * np.diag(plant.outputs.scales**-2.0)
    P2, Qw = np.diag(plant.states.scales**-2.0), np.diag(plant.disturbances.scales**-2.0)
    return CostFunction(P2=P2, Qw=Qw, R=R, Qv=R, **more)
