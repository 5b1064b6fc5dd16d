"""The paper's Section VI: one patient, sample-based against standard estimation, many noise realisations."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from sampling_design.checkers.strict import Tree
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear import thyroid as model
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator, SolverRun
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.report import PatientRun, ThyroidReport
from sampling_design.nonlinear.simulation import Integrator, simulate
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.file_io import from_json, read_text, write_text
from sampling_design.records.signatures import checked
from sampling_design.records.workers import Workers, check_workers, numbered

FORMAT = "sampling-design/thyroid-runs/1"
STEP = 2 / 24
"""Grid of the truth, of w and of the standard estimator [d]: the paper's 2 hours."""
GAPS = (6, 18)  # shortest and longest time between two samples, in steps: 12 to 36 hours, 24 on average
HORIZON = 5.0
DEGREE = 3
SLOW_STORE = 3e-5
"""alpha_th at which w read per day moves the state visibly; beta_th is scaled with it, so that the rest stays."""

ETA = 0.35  # discount rate of the cost [1/d], as the paper has it
P2 = np.diag([1.0, 5.0, 1.0, 1.0, 1.0, 1.0])
QW = 1.39e-3 * np.diag([1.0, 0.1])
QV = np.diag([100.0, 100.0, 10.0])
R = np.diag([200.0, 150.0, 100.0])

CASES: dict[str, Tree] = {
    "per_second": {"w_reading": "per_second"},
    "per_day": {"w_reading": "per_day"},
    "per_day_slow": {
        "w_reading": "per_day",
        "alpha_th": SLOW_STORE,
        "beta_th": model.PARAMETERS["beta_th"].value * SLOW_STORE / model.PARAMETERS["alpha_th"].value,
    },
}
"""Readings of the paper's w; the last one with a slow store of T4 in the thyroid, where w per day matters."""


def paper_weights() -> CostFunction:
    """Return the paper's weights and rate, physical, as printed for z = T x; Qw acts on the noisy w1 and w6 alone."""
    y, w = model.SCALING[[1, 2, 4]], model.SCALING[[0, 5]]
    scaled = {"P2": (P2, model.SCALING), "Qw": (QW, w), "Qv": (QV, y), "R": (R, y)}
    own = {key: weight * scale * scale[:, None] for key, (weight, scale) in scaled.items()}
    return CostFunction(own["P2"], own["Qw"], own["R"], own["Qv"], ETA)


@lru_cache(maxsize=8)
def _tools(case: str, degree: int = DEGREE) -> tuple[NonlinearPlant, NonlinearMovingHorizonEstimator, Integrator]:
    """The plant of a case, one estimator for both schemes, and its open loop between samples; built once a process."""
    plant = model.thyroid(**CASES[case])
    scheme = NonlinearMovingHorizonEstimator(
        plant,
        horizon=HORIZON,
        prior=model.PRIOR_START,
        collocation=Collocation(STEP, degree, round(HORIZON / STEP), accuracy=None),
        cost=paper_weights(),
    )
    return plant, scheme, Integrator(plant, points=GAPS[1])


def patient_run(
    case: str = "per_second", run: int = 0, *, days: float = 20.0, seed: int = 0, degree: int = DEGREE
) -> PatientRun:
    """Return one noise realisation with the estimates of both schemes on the 2 h grid.

    Raises ArgumentError if the case is unknown, or run, days or degree is out of range.

    Parameters
    ----------
    run : int
        Number of the realisation; the same number has the same noise in every case.
    degree : int
        Of the polynomials of the state on pieces of 2 h.
    """
    checks.word("case", case, CASES)
    steps = _grid_steps(days)
    plant, scheme, loop = _tools(case, checks.whole("degree", degree, 1))
    rng = np.random.default_rng([checks.whole("seed", seed), checks.whole("run", run)])
    times = freeze(STEP * np.arange(steps + 1))
    w = rng.uniform(-1.0, 1.0, (times.size, 2)) * model.PROCESS_BOUND
    v = rng.uniform(-1.0, 1.0, (times.size, 3)) * model.NOISE_BOUND
    sampled = np.zeros(times.size, dtype=bool)
    at = 0
    while at < times.size:
        sampled[at] = True
        at += int(rng.integers(GAPS[0], GAPS[1] + 1))
    truth = simulate(plant, model.TRUE_START, times, w=w)
    y = truth[:, [1, 2, 4]] + v
    found = [_estimates(scheme, loop, times, y, chosen) for chosen in (np.ones(times.size, dtype=bool), sampled)]
    (standard, dense), (sparse, rare) = found
    return PatientRun(
        case=case,
        run=run,
        times=times,
        truth=truth,
        outputs=y,
        sampled=sampled,
        standard=standard,
        sample_based=sparse,
        solves_standard=dense,
        solves_sample_based=rare,
    )


def _estimates(
    scheme: NonlinearMovingHorizonEstimator, loop: Integrator, times: Array, y: Array, chosen: Mask
) -> tuple[Array, tuple[SolverRun, ...]]:
    """Run one scheme over the chosen samples and return its estimate at every time, and its solves."""
    scheme.start(model.PRIOR_START)
    nothing, still = np.zeros(scheme.plant.n_inputs), np.zeros(scheme.plant.n_disturbances)
    estimates, at = np.empty((times.size, scheme.plant.n_states)), [*np.flatnonzero(chosen).tolist(), times.size]
    for k, following in pairwise(at):
        estimates[k] = x = scheme.update(times[k], y[k]).x
        if following > k + 1:  # what `predict` gives, without its covariance and all at once
            path = loop.path(x, nothing, still, times[k], times[k] + GAPS[1] * STEP)
            estimates[k + 1 : following] = path[: following - k - 1]
    return estimates, tuple(scheme.solves)


@checked
def thyroid_experiment(
    runs: int = 1,
    *,
    cases: Sequence[str] = ("per_second", "per_day"),
    days: float = 20.0,
    seed: int = 0,
    degree: int = DEGREE,
    path: str | os.PathLike[str] | None = None,
    workers: Workers = None,
    progress: Callable[[float, str], None] | None = None,
) -> ThyroidReport:
    """Return the errors of the sample-based and the standard estimator over many noise realisations.

    Parameters
    ----------
    runs : int
        Realisations per case.
    cases : names of `CASES`
        How w is read.
    days : float
        Length of a run [d].
    seed : int
        Realisation k has the generator of [seed, k].
    degree : int
        Of the polynomials of the state on pieces of 2 h.
    path : file, optional
        Result file (JSON lines), written whole after every run; runs that it holds already are not repeated.
    workers : Executor, Client, int or str, optional
        Any `concurrent.futures.Executor`, a Dask client, a number of processes (-1: one per core), or the name of a
        joblib backend. Default: one process per core.
    progress : callable, optional
        Called with a fraction in [0, 1] and a message after each run.

    Returns
    -------
    ThyroidReport

    Raises
    ------
    ArgumentError
        If a number is out of range, a case is unknown, `workers` is nobody, or the file holds runs of another
        experiment.
    FileFormatError
        If the file is no result file.
    MissingExtraError
        If casadi is not installed.

    Notes
    -----
    *Assumptions.* What the paper does not say is chosen as `ThyroidReport.open_points` lists it, not fitted to what it
    prints.
    *Method.* The root mean square over the 2 h grid of the 6-vector error in z = T x; between samples the
    sample-based estimate is the open loop.

    References
    ----------
    The paper, Section VI.

    Examples
    --------
    >>> report = thyroid_experiment(1, cases=["per_second"], days=0.25, workers=1)
    >>> report.runs, report.failures
    (1, 0)
    """
    count = checks.whole("runs", runs, 1)
    check_workers(workers)
    for case in cases:
        checks.word("cases", case, CASES)
    settings: Tree = {"days": _grid_steps(days) * STEP, "seed": checks.whole("seed", seed)}
    if checks.whole("degree", degree, 1) != DEGREE:
        settings["degree"] = degree
    lines = {} if path is None else _read(Path(path), settings)
    wanted = [(case, run) for case in cases for run in range(count)]
    missing = [key for key in wanted if key not in lines]
    if missing:
        casadi()  # before anything is written, and before others are asked to work without it
    if path is not None:
        _write(Path(path), settings, lines)  # a folder that cannot be written is found out before the work
    for _, line in _solved(missing, settings, workers):
        lines[line["case"], line["run"]] = line
        if path is not None:
            _write(Path(path), settings, lines)
        if progress is not None:
            done = sum(key in lines for key in wanted)
            progress(done / len(wanted), f"{done} of {len(wanted)} runs")
    found = tuple(lines[key] for key in wanted)
    return ThyroidReport(tuple(cases), count, settings["days"], settings["seed"], found, degree)


def _solved(missing: list[tuple[str, int]], settings: Tree, workers: Workers) -> Iterator[tuple[int, Tree]]:
    """Yield the number and the line of each missing run as it comes."""
    jobs = [(case, run, settings) for case, run in missing]
    chosen = min(os.cpu_count() or 1, len(jobs)) if workers is None else workers
    return numbered(_line, jobs, None if chosen == 1 or len(jobs) < 2 else chosen)


def _line(job: tuple[str, int, Tree]) -> Tree:
    case, run, settings = job
    return patient_run(case, run, **settings).summary()


def _grid_steps(days: float) -> int:
    steps = round(checks.positive("days", days) / STEP)
    if steps < 1:
        raise ArgumentError(f"`days` must be at least one step of 2 hours, got {days!r}.")
    return steps


def _write(path: Path, settings: Tree, lines: dict[tuple[str, int], Tree]) -> None:
    rows = [{"format": FORMAT, **settings}, *(lines[key] for key in sorted(lines))]
    write_text(path, "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))


def _read(path: Path, settings: Tree) -> dict[tuple[str, int], Tree]:
    """Return the runs of a result file (none if there is no such file)."""
    if not path.exists():
        return {}
    rows = [from_json(line, f"{path}, line {i + 1}") for i, line in enumerate(read_text(path).splitlines())]
    if not rows or rows[0].get("format") != FORMAT:
        raise FileFormatError(f"{path}: is no result file of this experiment (its first line must name {FORMAT}).")
    for key, plain in (("days", None), ("seed", None), ("degree", DEGREE)):
        stored, requested = (table.get(key, plain) for table in (rows[0], settings))
        if stored != requested:
            raise ArgumentError(
                f"`path` {path} holds runs with {key} = {stored}, asked for {requested}. Use another file."
            )
    return {(row["case"], row["run"]): row for row in rows[1:]}
