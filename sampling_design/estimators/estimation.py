"""From a record to estimates, by any estimator with the three methods."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import time_or_span
from sampling_design.estimators.online.estimator import EstimateRecord, Estimator, estimate_from
from sampling_design.estimators.online.in_order import listed, triple
from sampling_design.observability.count.functional import part_for
from sampling_design.plants.plant import Plant
from sampling_design.plants.rows import Wanted
from sampling_design.records import checks
from sampling_design.records.signatures import open_verb


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
    estimator.start(begin, checks.number("prior_time", prior_time))
    results = [(estimator.update(s.t, s.y, s.u), s.t) for s in samples]  # type: ignore[arg-type]  # as it came
    return EstimateRecord.collect(plant, [estimate_from(found, time_or_span(t)[0], n) for found, t in results], origin)
