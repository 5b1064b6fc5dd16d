"""One noise realisation of Section VI: truth, samples, and what both estimators made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import Tree
from sampling_design.nonlinear.mhe import SolverRun
from sampling_design.nonlinear.thyroid import SCALING
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import Record, short

SCHEMES = ("standard", "sample_based")
SPANS = {"all": 0.0, "without_start": 1e-9, "after_day_1": 1.0}
"""From when on the grid counts [d]; the first instant alone carries most of the error."""


def rmse(errors: npt.ArrayLike) -> float:
    """Return the root of the mean over the rows of the squared 2-norm of a row."""
    square = np.sum(np.square(errors), axis=1)
    return float(np.sqrt(np.mean(square)))


@dataclass(frozen=True, eq=False, repr=False)
class PatientRun(Record):
    """Trajectories of one run on the 2 h grid.

    Attributes
    ----------
    case : str, run : int
    times : (N,) array [d]
    truth, standard, sample_based : (N, 6) arrays [mol/l, mU/l]
    outputs : (N, 3) array
        Noisy outputs; the standard estimator has them all, the sample-based one those where `sampled`.
    sampled : (N,) array of bool
    solves_standard, solves_sample_based : tuples of SolverRun
    """

    case: str
    run: int
    times: Array
    truth: Array
    outputs: Array
    sampled: Mask
    standard: Array
    sample_based: Array
    solves_standard: tuple[SolverRun, ...]
    solves_sample_based: tuple[SolverRun, ...]

    def errors(self, scheme: str) -> Array:
        """Return the scaled error z - zhat of a scheme, (N, 6)."""
        return np.asarray((self.truth - getattr(self, scheme)) * SCALING)

    def rmse(self, scheme: str, span: str = "all") -> float:
        """Return the RMSE of a scheme over one of `SPANS` (NaN if the run ends before)."""
        chosen = self.times >= SPANS[span]
        return rmse(self.errors(scheme)[chosen]) if chosen.any() else float("nan")

    def summary(self) -> Tree:
        """Plain data of what a report needs; None for a span that the run does not reach."""
        line: Tree = {"case": self.case, "run": self.run, "samples": int(self.sampled.sum())}
        for scheme in SCHEMES:
            solves: tuple[SolverRun, ...] = getattr(self, f"solves_{scheme}")
            values = {span: self.rmse(scheme, span) for span in SPANS}
            line[scheme] = {
                "rmse": {span: value if np.isfinite(value) else None for span, value in values.items()},
                "failed": sum(solve.status != "ok" for solve in solves),
                "repeated": sum(solve.attempts > 1 for solve in solves),
                "seconds": [round(solve.seconds, 5) for solve in solves],
            }
        return line

    def figure(self, number: Literal[1, 2, 3]) -> PatientFigure:
        """Return figure 1 (outputs and samples), 2 (measured states) or 3 (unmeasured states) of the paper."""
        return PatientFigure(self, number)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("case", self.case), ("run", str(self.run)), ("days", short(self.times[-1]))]
        rows.append(("samples", f"{int(self.sampled.sum())} of {self.times.size} instants"))
        for scheme in SCHEMES:
            values = ", ".join(f"{span.replace('_', ' ')} {short(self.rmse(scheme, span), 4)}" for span in SPANS)
            rows.append((f"RMSE {scheme.replace('_', '-')}", values))
        return rows

    def explain(self) -> str:
        """Say how the two schemes compare in this run."""
        standard, sparse = (short(self.rmse(scheme, "without_start"), 3) for scheme in SCHEMES)
        return (
            f"With {int(self.sampled.sum())} samples instead of {self.times.size} the scaled error after the first "
            f"instant is {sparse} instead of {standard} (root mean square)."
        )


@dataclass(frozen=True, eq=False, repr=False)
class PatientFigure(Record):
    """One of the paper's figures of a run."""

    of: PatientRun
    number: Literal[1, 2, 3]

    def _rows(self) -> list[tuple[str, str]]:
        return [("figure", str(self.number)), *self.of._rows()]

    def explain(self) -> str:
        """Say what the figure shows."""
        titles = {1: "The noisy outputs and the samples", 2: "The measured states", 3: "The unmeasured states"}
        found = "" if self.number == 1 else f" {self.of.explain()}"
        return f"{titles[self.number]} of run {self.of.run} ({self.of.case.replace('_', ' ')}).{found}"
