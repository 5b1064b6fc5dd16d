"""What stands behind a number: a claim with its theorem, and a record of the solver that found it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

from sampling_design import __version__
from sampling_design.checkers.parts import FORMAT, digest
from sampling_design.checkers.strict import Tree
from sampling_design.records.declarations import plain
from sampling_design.records.record import Plain

Strength = Literal["proven", "attained", "sampled"]


@dataclass(frozen=True)
class Claim:
    """A statement with its source and its strength.

    `strength` is "proven" (a theorem and a computed bound), "attained" (a witness reaches it) or
    "sampled" (only looked at in places; evidence, not proof).
    """

    statement: str
    theorem: str = ""
    assumptions: tuple[str, ...] = ()
    strength: Strength = "proven"
    citation: str = ""

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; tuples become lists."""
        data = asdict(self)
        data["assumptions"] = list(self.assumptions)
        return data

    @property
    def evidence(self) -> str:
        """How strong it is, and by which theorem."""
        return f"{self.strength}: {self.theorem}" if self.theorem else self.strength

    def __str__(self) -> str:
        source = f" [{self.theorem}]" if self.theorem else ""
        given = f" given {'; '.join(self.assumptions)}" if self.assumptions else ""
        return f"{self.strength}: {self.statement}{source}{given}"


@dataclass(frozen=True)
class SolverRecord:
    """Which solver ran and how it ended. Never evidence, only provenance.

    `seconds` is what files of before say; how long it took is not written any more, so that the same call gives the
    same file.
    """

    name: str
    version: str = ""
    status: str = ""
    iterations: int = 0
    details: Mapping[str, Plain] = field(default_factory=dict)
    seconds: float | None = None

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {key: value for key, value in asdict(self).items() if value is not None}


def with_digest(plant: object, parts: Mapping[str, object], **after: object) -> Tree:
    """Return the plain data of a certificate: what every claim's file holds around its own `parts`, digest included."""
    data: Tree = {
        "format": FORMAT,
        "plant": plain(plant),
        **{key: plain(part) for key, part in parts.items()},
        "tool": {"name": "sampling_design", "version": __version__},
        **{key: plain(part) for key, part in after.items()},
    }
    data["digest"] = digest(data)
    return data
