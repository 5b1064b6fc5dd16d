"""What Section VI comes to over many runs, beside what the paper prints and what it leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import Tree
from sampling_design.nonlinear.mhe import SolverRun
from sampling_design.nonlinear.thyroid import SCALING
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.declarations import plain
from sampling_design.records.record import Record, counted, markdown_table, short

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
            f"With {counted(int(self.sampled.sum()), 'sample')} instead of {self.times.size} the scaled error after "
            f"the first instant is {sparse} instead of {standard} (root mean square)."
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


PAPER_RMSE = {"standard": 0.2244, "sample_based": 0.2275}  # printed in the paper's Section VI
PAPER_RATIO = PAPER_RMSE["sample_based"] / PAPER_RMSE["standard"]

OPEN_POINTS = (
    ("the model", "not printed; put together from public code, what is reconstructed is marked in `PARAMETERS`"),
    (
        "unit of time of w",
        "not said; none is preferred; per_day_slow also slows the thyroid's store of T4 (alpha_th = 3e-5 per l, "
        "beta_th likewise, same equilibrium), without which w per day moves nothing",
    ),
    ("length of a run", "not said; 20 days"),
    ("instants", "not said; gaps of 12 to 36 h, uniform on a 2 h grid, the first sample at t = 0"),
    ("distribution of the noise", "only bounds are printed; uniform, independent, w constant over 2 h"),
    ("sets", "a footnote names non-negativity; X and Y non-negative, W and V the printed bounds"),
    ("formula of the RMSE", "not said; root of the mean over the 2 h grid of the squared 6-vector error in z = T x"),
    ("weight of w", "printed with zeros; those columns have no noise and are left out of the model"),
    ("x(0)", "as printed, though its T4_th and the prior's look exchanged"),
)
"""What the paper does not say, and what is done instead; `ThyroidReport.open_points` adds the solver."""

_SPAN_WORDS = {"all": "t = 0 counted", "without_start": "without t = 0", "after_day_1": "after day 1"}


@dataclass(frozen=True, eq=False, repr=False)
class ThyroidReport(Record):
    """Errors and solver times of both estimators over many runs.

    Attributes
    ----------
    cases : tuple of str
        Readings of w.
    runs : int
        Realisations per case.
    days : float
    seed : int
    lines : tuple of mappings
        One per run, as `PatientRun.summary` gives them, case by case.
    degree : int
        Of the polynomials of the state.
    """

    cases: tuple[str, ...]
    runs: int
    days: float
    seed: int
    lines: tuple[Tree, ...]
    degree: int = 3

    _answers = (
        "errors of the paper's Section VI, with all samples and with few",
        "sampled: {runs} runs of {days} days for each interpretation of w",
        "{_good}",
        "`to_markdown()` names the command that repeats it",
    )

    def _good(self) -> str:
        return ", ".join(f"ratio {self.ratio(case):.3f} ({case})" for case in self.cases)

    @property
    def open_points(self) -> tuple[tuple[str, str], ...]:
        """What the paper does not say, and what is done instead."""
        solver = f"not said; Radau collocation of degree {self.degree}, pieces of 2 h, Newton's method and IPOPT"
        return (*OPEN_POINTS, ("solver", solver))

    def rmse(self, case: str, scheme: str, span: str = "all") -> np.ndarray:
        """Return the RMSE of every run of a case (NaN where a run is too short for the span)."""
        for key, value, known in (("case", case, self.cases), ("scheme", scheme, SCHEMES), ("span", span, SPANS)):
            checks.word(key, value, known)
        values = [line[scheme]["rmse"][span] for line in self.lines if line["case"] == case]
        return np.array(values, dtype=float)

    def ratio(self, case: str, span: str = "all") -> float:
        """Return mean RMSE sample-based over mean RMSE standard."""
        standard, sparse = (float(np.mean(self.rmse(case, scheme, span))) for scheme in SCHEMES)
        return sparse / standard if standard > 0 else float("nan")

    def seconds(self, case: str, scheme: str) -> np.ndarray:
        """Return the seconds of every window problem of a case."""
        self.rmse(case, scheme)  # refuses what is not known
        return np.array([s for line in self.lines if line["case"] == case for s in line[scheme]["seconds"]])

    @cached_property
    def failures(self) -> int:
        """Window problems that failed, over all runs and both schemes."""
        return sum(int(line[scheme]["failed"]) for line in self.lines for scheme in SCHEMES)

    def to_dict(self) -> Tree:
        """Plain data: means over the runs, per case, scheme and span."""
        return {
            "runs": self.runs,
            "days": self.days,
            "seed": self.seed,
            "paper": dict(PAPER_RMSE),
            "cases": {case: self._case(case) for case in self.cases},
            "failures": self.failures,
            "open_points": [list(pair) for pair in self.open_points],
        }

    def _case(self, case: str) -> Tree:
        data: Tree = {"ratio": {span: plain(self.ratio(case, span)) for span in SPANS}}
        for scheme in SCHEMES:
            seconds = self.seconds(case, scheme)
            values = {span: self.rmse(case, scheme, span) for span in SPANS}
            data[scheme] = {
                "rmse": {span: plain(np.mean(value)) for span, value in values.items()},
                "deviation": {span: plain(np.std(value)) for span, value in values.items()},
                "problems": int(seconds.size),
                "seconds_mean": float(seconds.mean()),
                "seconds_max": float(seconds.max()),
                "failed": sum(int(line[scheme]["failed"]) for line in self.lines if line["case"] == case),
            }
        return data

    def to_markdown(self) -> str:
        """Return the result as a page: figures beside the paper's, solver times, and what is open."""
        data = self.to_dict()["cases"]
        readings = " ".join(f"--reading {case}" for case in self.cases)
        degree = "" if self.degree == ThyroidReport.degree else f"--degree {self.degree} "
        asked = f"--runs {self.runs} --days {short(self.days)} --seed {self.seed} {degree}{readings}"
        parts = [
            "# The paper's Section VI: hormone concentrations from rare blood samples",
            f"Written by `sampling-design thyroid {asked} -o DIR`, as DIR/thyroid.md.",
            f"{self.runs} runs of {short(self.days)} days per interpretation of w, seed {self.seed}; "
            "RMSE in scaled states, mean over the runs and, in brackets, standard deviation between them.",
            markdown_table(
                ["w", "span", "standard", "sample-based", "ratio"],
                [
                    ["the paper", _SPAN_WORDS["all"], *map(str, PAPER_RMSE.values()), f"{PAPER_RATIO:.3f}"],
                    *(_error_row(case, span, data[case]) for case in self.cases for span in SPANS),
                ],
            ),
            markdown_table(
                ["w", "scheme", "problems", "mean time [s]", "longest [s]", "together [s]", "failed"],
                [_solver_row(case, scheme, data[case][scheme]) for case in self.cases for scheme in SCHEMES],
            ),
            self.explain(),
            "What cannot be known from the paper, and what is done instead:",
            "\n".join(f"- *{point}*: {choice}" for point, choice in self.open_points),
        ]
        return "\n\n".join(parts) + "\n"

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("failures", str(self.failures))]
        for case in self.cases:
            for span in SPANS:
                standard, sparse = (short(np.mean(self.rmse(case, scheme, span)), 4) for scheme in SCHEMES)
                value = f"standard {standard}, sample-based {sparse}, ratio {self.ratio(case, span):.3f}"
                rows.append((f"{case}, {_SPAN_WORDS[span]}", value))
        rows.append(("the paper", f"standard 0.2244, sample-based 0.2275, ratio {PAPER_RATIO:.3f}"))
        return rows

    def explain(self) -> str:
        """Say what the figures mean and what they do not."""
        return (
            "With t = 0 counted the error is almost wholly that of the first instant, where unmeasured states keep "
            "the prior's error; without it the two schemes differ. The model and several settings are not printed "
            "in the paper, so its figures can be approached, not verified."
        )


def _figure(value: float | None, deviation: float | None) -> str:
    return "-" if value is None else f"{value:.4f} ({deviation:.4f})"


def _error_row(case: str, span: str, data: Tree) -> list[str]:
    figures = [_figure(data[scheme]["rmse"][span], data[scheme]["deviation"][span]) for scheme in SCHEMES]
    ratio = data["ratio"][span]
    return [case, _SPAN_WORDS[span], *figures, "-" if ratio is None else f"{ratio:.3f}"]


def _solver_row(case: str, scheme: str, data: Tree) -> list[str]:
    times = [f"{data[key]:.3f}" for key in ("seconds_mean", "seconds_max")]
    times.append(f"{data['problems'] * data['seconds_mean']:.1f}")
    return [case, scheme.replace("_", "-"), str(data["problems"]), *times, str(data["failed"])]
