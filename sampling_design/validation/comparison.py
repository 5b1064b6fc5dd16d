"""From a plant, a schedule and a certificate to a report: did the promises hold?"""

from __future__ import annotations

import inspect
import os
import platform
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from sampling_design import __version__
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.checkers.strict import is_text
from sampling_design.errors import ArgumentError, CallError
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.online.estimator import Estimator, answering
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.budget import Progress
from sampling_design.records.dispatch import OpenPlant, registered
from sampling_design.records.signatures import checked
from sampling_design.records.sweeps import Journal, digest_of
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.records.workers import Workers, check_workers
from sampling_design.schedules.family import AnySchedule
from sampling_design.validation.monte_carlo import growth, own_growth, read_trials
from sampling_design.validation.report import ClaimCheck, ErrorCurve, ValidationReport
from sampling_design.validation.scenario import (
    ErrorSources,
    EstimatedRun,
    ScenarioBounds,
    draw_inputs,
    initial_inputs,
    real_run,
    resonant_inputs,
    true_run,
)
from sampling_design.validation.study import GROWTH_LIMIT, SCENARIOS, ValidationStudy
from sampling_design.validation.timeline import GAPS_TO_SETTLE, Timeline, build_timeline, default_duration


@checked
def validate(
    plant: Plant | OpenPlant,
    schedule: AnySchedule,
    certificate: SampledCertificate | None = None,
    *,
    estimator: Estimator | None = None,
    runs: int = 200,
    duration: float | None = None,
    w_bound: VectorBound = None,
    v_bound: VectorBound = None,
    initial_error: VectorBound = None,
    scenarios: Iterable[str] = SCENARIOS,
    rng: checks.Seed = None,
    workers: Workers = None,
    resume: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: object,
) -> ValidationReport:
    """Compare what a certificate and the online ellipsoids promise with what happens in trials and in worst cases.

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
        When samples are taken.
    certificate : Certificate, optional
        Without one only the ellipsoids and the growth of the error are judged, and `estimator` must bring a horizon.
    estimator : Estimator, optional
        Any object with `start(prior, prior_time)`, `update(t, y, u)` and `predict(t)`, in place of a moving horizon
        estimator; it runs beside the truth in the scenarios "random", "resonant" and "initial". Whether its error grows
        is judged over 40 samples or more.
    runs : int
        Random trials.
    duration : float, optional [time]
        Default three horizons and at least 40 gaps; of a finite schedule its last time.
    w_bound, v_bound, initial_error : float or array, optional
        A number bounds the norm, a vector each entry. Default: the plant's scales, entry by entry.
    scenarios : sequence of str
        Of "pairs", "random", "worst", "resonant", "initial", "estimator", "constraints" and "paper".
    rng : numpy.random.Generator or its seed, optional
        Default seed 0. Every run has a seed of its own, spawned from it.
    workers : Executor, Client, int or str, optional
        Any `concurrent.futures.Executor`, a Dask client, a number of processes (-1: one per core), or the name of a
        joblib backend. The report is the same for all, to the last bit; a worker that is killed takes nothing with it.
    resume : path, optional
        A journal of the random trials, written as they are finished; what it holds already is not run again.
    progress : callable, optional
        Called with (fraction, message).
    **options
        Options of `MovingHorizonEstimator` (cost, horizon), if they are not the certificate's, and `of`: the rows of
        the state that all else that is given, and the report, is about (the part that they need, as there).

    Returns
    -------
    ValidationReport
        What the certificate promises and could not be judged (as where the samples are off its schedule) is a check
        that did not hold.

    Raises
    ------
    ArgumentError
        If a scenario is unknown, the schedule does not fit the plant or holds no sample, a bound is negative,
        `workers` is nobody, or there is neither certificate nor horizon nor estimator.
    FileFormatError
        If `resume` belongs to another study.

    Notes
    -----
    *Assumptions.* Linear plant; w is constant over cells much shorter than the gaps and otherwise arbitrary, so that
    the truth is exact. *Claim.* A promise that is broken here is false. One that held is only as sure as its proof;
    the worst cases are exact for the disturbances considered. *Method.* The error of the unconstrained
    estimator is linear in initial error, disturbance and noise; run forward for whole batches it gives the trials,
    run backward the worst disturbances. The real estimator is run beside it, with and without constraints.
    *Numerical aspects.* Errors are propagated themselves, so that growing states do not drown them; where the real
    estimator runs, an unstable truth is held near zero by a known input.

    References
    ----------
    The paper, Theorem 9 and Assumption 7.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant, certify
    >>> plant, schedule = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([1.0])
    >>> certificate = certify(plant, schedule, eta=0.4, P2=[[1.0, 0.0], [0.0, 1.0]])
    >>> report = validate(plant, schedule, certificate, runs=20, scenarios=["random", "worst"])
    >>> report.passed, len(report.checks) > 3
    (True, True)
    """
    if not isinstance(plant, Plant):
        if options.get("of") is not None:
            raise ArgumentError("`of` is for exactly known plants: validate all states of this one.")
        return registered("validate", plant, ValidationReport)(
            plant, schedule, certificate, estimator=estimator, runs=runs, duration=duration, w_bound=w_bound,
            v_bound=v_bound, initial_error=initial_error, scenarios=scenarios, rng=rng, workers=workers, resume=resume,
            progress=progress, **options,
        )  # fmt: skip
    plant, chosen = part_for(plant, typing.cast(Wanted, options.pop("of", None))), tuple(scenarios)
    unknown = [name for name in chosen if not is_text(name) or name not in SCENARIOS]
    if unknown:
        raise ArgumentError(f"`scenarios` must be among {', '.join(SCENARIOS)}, got {checks.described(unknown[0])}.")
    taken = inspect.signature(MovingHorizonEstimator).parameters
    for key in options.keys() - taken.keys():
        every = (*inspect.signature(validate).parameters, *taken)
        raise CallError(
            f"`validate` and its MovingHorizonEstimator have no argument `{key}`. {checks.meant(key, every)}"
        )
    if estimator is not None:
        for key, value in {"certificate": certificate, "workers": workers, "resume": resume, **options}.items():
            if value is not None:
                raise ArgumentError(
                    f"`{key}` must be left out where an `estimator` is given: its own estimates and radii are judged."
                )
    check_workers(workers)
    bounds = ScenarioBounds.of(plant, w_bound, v_bound, initial_error)
    source = checks.generator(rng)
    root = source.bit_generator.seed_seq
    assert isinstance(root, np.random.SeedSequence)
    count = checks.whole("runs", runs, 1)
    with np.errstate(over="ignore", invalid="ignore"):  # what grows beyond all numbers is found as such by each check
        if estimator is not None:
            line = build_timeline(plant, schedule, default_duration(schedule, 0.0) if duration is None else duration)
            known = {**_settings(line, count, chosen, bounds, root), "estimator": type(estimator).__name__}
            return _study_estimates(line, bounds, estimator, chosen, root.spawn(count), known, progress)
        settled = (plant, schedule, certificate, bounds, options, duration, count, _seed_of(root))
        study = ValidationStudy(plant, schedule, certificate, bounds, options, duration)
        if resume is not None:
            study.journal = Journal(resume, digest_of(*settled), read_trials)
        study.run(chosen, root.spawn(count), workers, progress)
        return study.report({**_settings(study.line, count, chosen, bounds, root), "horizon": study.horizon})


def _study_estimates(
    line: Timeline,
    bounds: ScenarioBounds,
    estimator: Estimator,
    scenarios: Sequence[str],
    seeds: Sequence[np.random.SeedSequence],
    settings: Mapping[str, object],
    progress: Progress | None,
) -> ValidationReport:
    """Run one estimator under the scenarios that need nothing but its estimates; say of the others that they do."""
    found, error_curves = list[ClaimCheck](), list[ErrorCurve]()
    inputs: dict[str, Callable[[], ErrorSources]] = {
        "random": lambda: draw_inputs(line, bounds, seeds),
        "resonant": lambda: resonant_inputs(line, bounds)[0],
        "initial": lambda: initial_inputs(line, bounds),
    }
    known = [name for name in scenarios if name in inputs]
    few = f"{line.samples.size} samples, it settles in {GAPS_TO_SETTLE}" if line.samples.size < GAPS_TO_SETTLE else ""
    few = few or "samples get rarer" * line.rarer
    skipped = [f"{name}: it needs a certificate's estimator." for name in scenarios if name not in known]
    skipped += [
        f"growth of the error ({name}): {few}." for name in known if name in GROWTH_LIMIT and few
    ]  # fmt: skip
    for k, name in enumerate(known):
        if progress is not None:
            progress(k / len(known), name)
        drawn, runs = inputs[name](), list[EstimatedRun]()
        for run in range(len(drawn.e0)):
            truth = true_run(line, drawn, run, steered=False)
            with answering(estimator):
                estimator.start(np.zeros(line.plant.n_states), 0.0)
                runs.append(real_run(line, truth, estimator))
        size = np.linalg.norm([run.errors / line.plant.states.scales for run in runs], axis=2)
        error_curves.append(ErrorCurve(name, size.max(axis=0), np.median(size, axis=0)))
        if name in GROWTH_LIMIT and not few:
            grown, own = growth(size, line.rows.times), own_growth(drawn.w, line.times[1:])
            at = int(np.argmax(grown / own))
            limit = GROWTH_LIMIT[name] * float(own[at])
            found.append(ClaimCheck("error does not grow", name, limit, float(grown[at])))
        certified = np.array([run.certified for run in runs])
        if certified.any():  # of those that say that their ellipsoid is proven: did it hold the truth?
            worst = float(np.max(np.array([run.ratios for run in runs])[certified]))
            found.append(ClaimCheck("online ellipsoid", name, 1.0, worst))
    if progress is not None:
        progress(1.0, "done")
    return ValidationReport(
        plant=line.plant,
        checks=tuple(found),
        times=line.rows.times,
        bound=None,
        norm="states over their scales",
        error_curves=tuple(error_curves),
        settings=settings,
        skipped=tuple(skipped),
    )


def _settings(
    line: Timeline, runs: int, scenarios: tuple[str, ...], bounds: ScenarioBounds, root: np.random.SeedSequence
) -> dict[str, object]:
    """What a report says of how it was made."""
    return {
        "runs": runs,
        "duration": line.times[-1].item(),
        "samples": int(line.samples.size),
        "scenarios": list(scenarios),
        **bounds.to_dict(),
        "seed": _seed_of(root),
        "versions": {"sampling-design": __version__, "numpy": np.__version__, "python": platform.python_version()},
    }


def _seed_of(root: np.random.SeedSequence) -> str:
    """The entropy that repeats the study, as text: it may be longer than a float of JSON holds."""
    key = "" if not root.spawn_key else f", spawn key {tuple(root.spawn_key)}"
    return f"{root.entropy}{key}"
