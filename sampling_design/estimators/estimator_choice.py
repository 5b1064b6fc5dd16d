"""From a record to estimates, by any estimator, or by that with the strongest guarantee at hand."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import time_or_span
from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact.bound_weights import ErrorBoundArguments
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import MathematicsError, SolverError
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.online.estimator import (
    EstimateRecord,
    Estimator,
    GuaranteeWarning,
    answering,
    estimate_from,
)
from sampling_design.estimators.online.in_order import listed, triple
from sampling_design.estimators.records.frames import DataFrame, Dataset, LazyFrame, Series
from sampling_design.estimators.records.measurements import Measurements, read_measurements
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.budget import Progress
from sampling_design.records.record import short
from sampling_design.records.signatures import checked, open_verb
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.schedule import Schedule


@open_verb(EstimateRecord)
def estimate(
    plant: Plant,
    record: object,
    estimator: Estimator,
    *,
    prior: npt.ArrayLike | None = None,
    prior_time: float = 0.0,
    of: Wanted = None,
) -> EstimateRecord:
    """Return the estimates of an estimator, started anew, at every sample of a record.

    Parameters
    ----------
    plant : Plant
    record : Measurements, DataFrame or iterable of (t, y, u)
        Gone through in order of time.
    estimator : Estimator
        Any object with `start(prior, prior_time)`, `update(t, y, u)` and `predict(t)`: those of this package, or one of
        your own, which may return the state alone.
    prior : (n,) array, optional
        State at `prior_time`; default 0.
    prior_time : float [time]
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows themselves (`functional_plant`). What else
        is given, estimator and prior, and what is returned is of the part that they need. Default: all states.

    Returns
    -------
    EstimateRecord
        As `update` returned them: `run` of a moving horizon estimator, which this does not call, centres them. Of an
        estimator that returns states alone nothing is certified, and every radius is infinite.

    Raises
    ------
    ArgumentError
        If the record cannot be gone through, the prior has the wrong length, or the estimator returns no state.

    Examples
    --------
    >>> from sampling_design import KalmanFilter
    >>> plant = Plant([[-1.0]], [[1.0]])
    >>> found = estimate(plant, [(0.0, [1.0]), (1.0, [0.4])], KalmanFilter(plant))
    >>> found.x.shape
    (2, 1)
    """
    plant = part_for(plant, of)
    n = plant.n_states
    taken, origin = listed(record, plant)
    samples = [triple(item) for item in taken]
    begin = checks.vector("prior", np.zeros(n) if prior is None else prior, n)
    with answering(estimator):
        estimator.start(begin.copy(), checks.number("prior_time", prior_time))
        found = [
            estimate_from(estimator.update(s.t, s.y, s.u), time_or_span(s.t)[0], n)  # type: ignore[arg-type]  # as it came
            for s in samples
        ]
    return EstimateRecord.collect(plant, found, origin)


GAPS_IN_HORIZON = 10  # longest gaps in the horizon of an estimator that has no certificate

FAMILY_STATES = 8
"""Most states of which a certificate for all schedules with the record's gaps is sought in passing: the work grows with
their sixth power, two seconds for six, minutes for eleven."""

OWN_SAMPLES = 10_000
"""Most samples whose own times are certified in passing: some six seconds; memory and work grow with their number, and
some three times as many are more than one proof may follow."""


class RecordEstimator(NamedTuple):
    """An estimator for a record, what it rests on (in words, too), and the defaults that were used, by argument."""

    estimator: MovingHorizonEstimator
    certificate: SampledCertificate | None
    guarantee: str
    defaults_used: dict[str, str]


@checked
def estimator_for(
    plant: Plant,
    record: Measurements | LazyFrame | DataFrame | Series | Dataset,
    certificate: SampledCertificate | None = None,
    *,
    schedule: AnySchedule | None = None,
    eta: float | None = None,
    horizon: float | None = None,
    prior: npt.ArrayLike | None = None,
    w_bound: VectorBound = None,
    v_bound: VectorBound = None,
    initial_error: VectorBound = None,
    of: Wanted = None,
    progress: Progress | None = None,
) -> RecordEstimator:
    """Return a moving horizon estimator for a record, with the strongest guarantee that is at hand.

    That of the certificate or the schedule given; else for all schedules with the record's gaps; else for its own
    times, counted from its start; else the ellipsoid alone.

    Parameters
    ----------
    plant : Plant
    record : Measurements, DataFrame, Series or Dataset
        A frame is read by `read_measurements`, which also takes an origin and a zone.
    certificate : Certificate or FamilyCertificate, optional
    schedule : Schedule or PeriodicSchedule, optional
        Certified with weights that follow the bounds.
    eta : float, optional [1/time]
        Rate, where one is certified. Default: one over the longest gap.
    horizon : float, optional [time]
        Default: the certificate's, without one ten times the longest gap.
    prior : (n,) array, optional
        State before any sample; default 0.
    w_bound, v_bound, initial_error : float or array, optional
        Default: the plant's scales.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows themselves (`functional_plant`). What else
        is given, and what is returned, is of the part that they need, `estimator.plant`, whose first states they are.
        Default: all states.
    progress : callable, optional
        Called with (fraction, message) while a certificate is sought.

    Returns
    -------
    RecordEstimator
        A horizon that gives up the guarantee is named in `defaults_used["notice"]`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign.
    FileFormatError
        If `record` is a frame that holds no measurements of this plant.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> times = np.array([0.5, 1.2, 2.0, 2.6])
    >>> chosen = estimator_for(plant, Measurements(plant, times, np.cos(times)[:, None]), w_bound=0.1, v_bound=0.1)
    >>> chosen.guarantee
    'The guarantee is for all schedules with gaps from 0.6 to 0.8 s.'
    """
    plant, used = part_for(plant, of), dict[str, str]()
    match record:
        case Measurements():
            ordered = record.in_order()
        case frame:
            ordered = read_measurements(frame, plant).in_order()
    scales = {"w_bound": plant.disturbances, "v_bound": plant.outputs, "initial_error": plant.states}
    given = {"w_bound": w_bound, "v_bound": v_bound, "initial_error": initial_error}
    for name, signals in scales.items():
        if given[name] is None:
            given[name] = signals.scales
            used[name] = f"the plant's scales {short(signals.scales)} are used, typical sizes in place of bounds"
    bounds = ErrorBoundArguments(
        w_bound=given["w_bound"], v_bound=given["v_bound"], initial_error=given["initial_error"]
    )
    start = ordered.start if certificate is None and schedule is None else 0.0
    guarantee = "Guarantee of the certificate given."
    if certificate is None and schedule is not None:
        rate = _rate(plant, eta, schedule.d_max, used)
        certificate = certify(plant, schedule, eta=rate, progress=progress, **bounds)
        guarantee = "The guarantee is for the schedule given."
    elif certificate is None:
        certificate, guarantee = _from_gaps(plant, ordered, eta, bounds, used, progress)
    if certificate is None and horizon is None:
        longest = float(np.max(np.diff(np.unique(ordered.times)), initial=0.0))
        horizon = GAPS_IN_HORIZON * longest if longest > 0 else 1.0
        used["horizon"] = f"{short(horizon)} {plant.time_unit} is used"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GuaranteeWarning)
        estimator = MovingHorizonEstimator(
            plant, certificate, horizon=horizon, prior=prior, prior_time=start, schedule_zero=start, **bounds
        )
    if caught:
        used["notice"] = " ".join(str(warning.message) for warning in caught)
    return RecordEstimator(estimator, certificate, guarantee, used)


def _rate(plant: Plant, eta: float | None, longest: float, used: dict[str, str]) -> float:
    """The rate that was asked for, else one over the longest gap."""
    if eta is not None:
        return eta
    used["eta"] = f"{short(1 / longest)} per {plant.time_unit}, one over the longest gap, is used"
    return 1 / longest


def _from_gaps(
    plant: Plant,
    record: Measurements,
    eta: float | None,
    bounds: ErrorBoundArguments,
    used: dict[str, str],
    progress: Progress | None,
) -> tuple[SampledCertificate | None, str]:
    """A certificate for every schedule with the record's gaps, else for its own times, else none; and words for it."""
    times, taken = record.samples(numbers=True)
    times = times - record.start
    if times.size < 2:
        return None, "No guarantee: one sample is no schedule that could be certified."
    gaps = np.diff(times)
    shortest, longest = float(gaps.min()), float(gaps.max())
    span = f"gaps from {short(shortest)} to {short(longest)} {plant.time_unit}"
    span += " between numbers, limits and means left out" if any(record.censored) else ""
    rate = _rate(plant, eta, longest, used)
    asked = plant.n_states <= FAMILY_STATES
    if asked and taken.all():
        family = GapRange(shortest, max(longest, float(times[0])), time_unit=plant.time_unit)
        try:
            found = certify(plant, family, eta=rate, progress=progress, **bounds)
            return found, f"The guarantee is for all schedules with {span}."
        except (MathematicsError, SolverError):
            pass  # not every schedule with these gaps can be certified: perhaps this one can
    if times.size > OWN_SAMPLES:
        words = f"No guarantee beyond the ellipsoid: the file's own {times.size} times ({span}) are more than the "
        return None, words + f"{OWN_SAMPLES} that are certified in passing. Give a certificate or a schedule."
    try:
        own = Schedule(times, taken, time_unit=plant.time_unit)
        certificate = certify(plant, own, eta=rate, progress=progress, **bounds)
    except (MathematicsError, SolverError) as error:
        return None, f"No guarantee beyond the ellipsoid: {span} cannot be certified ({str(error).rstrip('.')})."
    words = f"The guarantee is for the file's own times only, certified to its last time ({span})."
    if not asked:
        words += f" For all schedules with such gaps ask `certify --gap-range`: {plant.n_states} states take it long."
    return certificate, words
