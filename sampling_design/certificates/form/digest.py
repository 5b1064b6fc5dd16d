"""What every certificate file holds, whatever it claims: format, plant, tool, solver, and a digest over all of it."""

from __future__ import annotations

from collections.abc import Mapping

from sampling_design import __version__
from sampling_design.checkers.parts import FORMAT, digest
from sampling_design.checkers.strict import Tree
from sampling_design.plants.plant import Plant
from sampling_design.records.declarations import plain
from sampling_design.records.evidence import SolverRecord

CLAIM = "assumption-7"
FAMILY_CLAIM = "family"
DETECTABILITY_CLAIM = "detectability"
INCLUSION_CLAIM = "inclusion"

RESOLUTION = 1e-3  # `lam` is the supremum to within this fraction: (1 - RESOLUTION) P2/lam is proven to stay below Pi
STATED_MARGIN = 1e-4
"""Margin that a certificate states, Pi >= (1 + this) P1; what is left of `RESOLUTION` is for the proof."""


def with_digest(plant: Plant, parts: Mapping[str, object], solver: SolverRecord | None) -> Tree:
    """Return the plain data of a certificate: what every claim's file holds around its own `parts`, digest included."""
    data: Tree = {
        "format": FORMAT,
        "plant": plant.to_dict(),
        **{key: plain(part) for key, part in parts.items()},
        "tool": {"name": "sampling_design", "version": __version__},
        "solver": None if solver is None else solver.to_dict(),
    }
    data["digest"] = digest(data)
    return data
