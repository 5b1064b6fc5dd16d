"""What was promised beside what was observed: checks of claims, and the report that collects them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import (
    ListRecord,
    Plain,
    PlainRecord,
    Strength,
    YesOrNo,
    below,
    markdown_table,
    short,
)

ROUNDING = 1e-8  # a promise counts as kept while it is exceeded by no more than this share: the rounding of a long run


@dataclass(frozen=True, eq=False, repr=False)
class ClaimCheck(YesOrNo):
    """One promise and what became of it: true if it held, false if it was broken, neither where it was not checked.

    Attributes
    ----------
    claim : str
        In words.
    scenario : str
        Under what.
    predicted, observed : float
        The observed value must be at most the predicted one, or at least where `sense` is "at least".
    sense : "at most" or "at least"
    source : str
        Theorem behind the prediction.
    strength : str
        "attained" where the observed value is the worst case itself, "sampled" where trials were drawn.
    note : str
        What else was observed.
    checked : bool
        False where the promise could not be judged, as where what was observed is beyond all numbers; then it did not
        hold, and the note says why.
    """

    claim: str
    scenario: str
    predicted: float
    observed: float
    sense: str = "at most"
    source: str = ""
    strength: Strength = "sampled"
    note: str = ""
    checked: bool = True

    _table = {
        "claim": "{claim}",
        "scenario": "{scenario}",
        "predicted": "{sense} {predicted}",
        "observed": "{observed}",
        "margin": "{margin:3}",
        "passed": "{passed}",
        "note": "{note:or }",
    }

    def __post_init__(self) -> None:
        for key in ("predicted", "observed"):
            value = checks.floats(key, getattr(self, key))  # infinite, or no number, where they left doubles
            if value.ndim:
                raise ArgumentError(f"`{key}` must be one number, got shape {value.shape}.")
            self._hold(**{key: float(value)})
        if self.checked and np.isnan(self.observed):
            note = f"What was observed is beyond all numbers. {self.note}".rstrip()
            self.__dict__.update(checked=False, note=note)

    @property
    def margin(self) -> float:
        """Share of the prediction that is left (negative where it is broken)."""
        away = self.predicted - self.observed if self.sense == "at most" else self.observed - self.predicted
        return away / abs(self.predicted) if self.predicted else away

    @property
    def passed(self) -> bool:
        """Whether the promise was judged and held, up to rounding."""
        return self.checked and bool(self.margin >= -ROUNDING)

    _asked: ClassVar[str] = "verdict"

    def _answer(self) -> bool | None:
        return self.passed if self.checked else None

    @property
    def verdict(self) -> str:
        """One of "held", "BROKEN" and "NOT CHECKED"."""
        return "NOT CHECKED" if not self.checked else "held" if self.passed else "BROKEN"

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        unknown = {} if self.checked else {"observed": None, "margin": None}
        return {**vars(self), "margin": self.margin, **unknown, "passed": self.passed}

    def explain(self) -> str:
        """Say whether the promise held."""
        if not self.checked:
            return f"The promise '{self.claim}' was not checked. {self.note}".rstrip()
        verdict = "held" if self.passed else "was broken"
        return (
            f"The promise '{self.claim}' {verdict} under {self.scenario}: "
            f"{self.sense} {short(self.predicted)} was predicted, {short(self.observed)} observed."
        )


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Errors of one scenario over time: the largest and the median of its runs, in the report's norm."""

    name: str
    largest: Array
    median: Array


@dataclass(frozen=True, eq=False)
class ExampleRun:
    """One run of the real estimator: errors and radii (R, n) at some times (R,)."""

    times: Array
    errors: Array
    radii: Array


@dataclass(frozen=True, eq=False, repr=False)
class ValidationReport(YesOrNo, ListRecord[ClaimCheck], PlainRecord):
    """What a plant's schedule and certificate promised, and whether it came true.

    True if every promise held, false if one was broken; neither where none was, and not all were checked.

    Attributes
    ----------
    plant : Plant
    checks : tuple of ClaimCheck
    times : (R,) array
        Where errors were looked at; a sample's time stands twice, before and after it.
    bound : (R,) array or None
        What the a-priori theorem promises for the largest noise, in the report's norm.
    norm : str
        Norm of the errors in words: the certificate's |.|_P1, or states over their scales.
    error_curves : tuple of ErrorCurve
    example : ExampleRun or None
    settings : dict
        Runs, duration, horizon, bounds, seed and versions.
    skipped : tuple of str
        What could not be checked, and why.
    """

    plant: Plant
    checks: tuple[ClaimCheck, ...]
    times: Array
    bound: Array | None
    norm: str
    error_curves: tuple[ErrorCurve, ...] = ()
    example: ExampleRun | None = None
    settings: Mapping[str, object] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()

    _plain = (
        "format:_format plant:plant.name passed checks skipped settings norm times bound "
        "error_curves{name largest median}"
    )
    _format = "sampling-design/validation/1"
    _frame = "checks{claim scenario verdict predicted observed margin source strength}"

    def _entries(self) -> tuple[ClaimCheck, ...]:
        return self.checks

    @property
    def passed(self) -> bool:
        """Whether every promise was checked and held, of one at least."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    @property
    def broken(self) -> tuple[ClaimCheck, ...]:
        """The promises that did not hold."""
        return tuple(check for check in self.checks if check.checked and not check.passed)

    _asked: ClassVar[str] = "checks"

    def _answer(self) -> bool | None:
        return self.passed if self.broken or self.passed else None

    def cells(self) -> list[list[str]]:
        """Rows of the table of checks: claim, scenario, predicted, observed, margin, verdict."""
        signs = {"at most": "<=", "at least": ">="}
        return [
            [
                f.claim,
                f.scenario,
                f"{signs[f.sense]} {short(f.predicted, 5)}",
                short(f.observed, 5),
                below(f.margin, 3),
                f.verdict,
            ]
            for f in self.checks
        ]

    def to_markdown(self) -> str:
        """Return the report as a page: verdict, checks, notes, settings."""
        heads = ["claim", "scenario", "predicted", "observed", "margin", "verdict"]
        lines = [f"# Validation of {self.plant.name or 'a plant'}", "", self.explain(), ""]
        lines.append(markdown_table(heads, self.cells()))
        notes = [f"- {f.claim} ({f.scenario}): {f.note}" for f in self.checks if f.note]
        lines += ["", "## Notes", "", *notes] if notes else []
        lines += ["", "## Not checked", "", *(f"- {text}" for text in self.skipped)] if self.skipped else []
        lines += ["", "## Settings", ""]
        lines += [f"- {key}: {value}" for key, value in self.settings.items()]
        return "\n".join(lines) + "\n"

    _answers = (
        "{checks.__len__} promises of a plant, its schedule and its certificate, against simulations",
        "sampled: what held in every run may fail in another; what was broken is refuted",
        "{_held} of {checks.__len__} held",
        "the same call with another `rng`",
    )

    def _held(self) -> int:
        return sum(check.passed for check in self.checks)

    def _rows(self) -> list[tuple[str, str]]:
        bounded = [f for f in self.checks if f.sense == "at most" and f.checked]
        worst = min(bounded, key=lambda f: f.margin, default=None)
        return [
            ("least margin", "-" if worst is None else f"{below(worst.margin, 3)} ({worst.claim}, {worst.scenario})"),
            ("runs", str(self.settings.get("runs", "-"))),
            ("duration", f"{short(self.settings.get('duration', np.nan))} {self.plant.time_unit}"),
            ("seed", str(self.settings.get("seed", "-"))),
        ]

    def explain(self) -> str:
        """Say the verdict in words."""
        if not self.checks:
            return f"No promise was judged. {' '.join(self.skipped)}".rstrip()
        missing = [f for f in self.checks if not f.checked]
        broken = self.broken
        if not broken and not missing:
            return f"All {len(self.checks)} promises held."
        if not broken:
            return f"{len(self.checks) - len(missing)} of {len(self.checks)} promises held. {missing[0].explain()}"
        count = f"{len(broken)} of {len(self.checks)} promises {'was' if len(broken) == 1 else 'were'} broken"
        return f"{count}: {broken[0].explain()}"
