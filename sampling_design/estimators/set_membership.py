"""The set-membership estimator: the centre of what the data and the bounds leave possible."""

from __future__ import annotations

import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import Constraints, WindowConstraints, narrowed
from sampling_design.estimators.kalman import KalmanFilter
from sampling_design.estimators.online.recorder import Recorder
from sampling_design.plants.plant import Plant
from sampling_design.plants.rows import Wanted
from sampling_design.records.vector_bounds import VectorBound


class SetMembershipEstimator(KalmanFilter):
    """The centre of the interval of every state: no other estimate has a smaller largest error.

        x_i = (lower_i + upper_i)/2,    |x_i(t) - x_i| <= radii_i = (upper_i - lower_i)/2

    Parameters
    ----------
    plant : Plant
    constraints : Constraints, optional
        What else is known of x, v and w.
    w_bound, v_bound : float or array
        Bounds on |w(t)| and |v|: a number bounds the Euclidean norm, a vector each entry.
    prior, prior_time, input_side, maximum_delay, of
        As for `KalmanFilter`.
    initial_error : float or array, optional
        Bound on |x - prior|; default: nothing is known, and states are unbounded until the samples show them.

    Raises
    ------
    ArgumentError
        If a bound is missing or has the wrong shape or sign.

    Notes
    -----
    *Claim.* If w, v and the first error keep their bounds, the state lies in the box of half-widths `radii`; the
    ellipsoid is one around that box. Where the data leave a state unbounded it is that of a filter and its radius
    infinite. *Method.* Two cone programs for each state and sample (`accuracy/`): some milliseconds.

    References
    ----------
    Milanese and Tempo, Optimal algorithms theory for robust estimation and prediction (1985).

    Examples
    --------
    >>> walk = SetMembershipEstimator(Plant([[0.0]], [[1.0]]), w_bound=0.1, v_bound=0.3)
    >>> [round(float(walk.update(t, [y]).x[0]), 4) for t, y in ((0.0, 1.0), (1.0, 1.5))]
    [1.0, 1.3]
    >>> walk.predict(2.0).radii.round(4)
    array([0.2])
    """

    def __init__(
        self,
        plant: Plant,
        *,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        constraints: Constraints | None = None,
        w_bound: VectorBound = None,
        v_bound: VectorBound = None,
        initial_error: VectorBound = None,
        input_side: str = "right",
        maximum_delay: float = 0.0,
        of: Wanted = None,
    ):
        missing = [name for name, bound in (("w_bound", w_bound), ("v_bound", v_bound)) if bound is None]
        if missing:
            raise ArgumentError(f"`{missing[0]}` is missing: without it no set is bounded. Give 0 where there is none.")
        super().__init__(
            plant,
            prior=prior,
            prior_time=prior_time,
            w_bound=w_bound,
            v_bound=v_bound,
            initial_error=initial_error,
            input_side=input_side,
            maximum_delay=maximum_delay,
            of=of,
        )
        assumed, given = self.recorder.assumed, Constraints() if constraints is None else constraints
        assert assumed is not None
        narrow = narrowed(assumed, WindowConstraints(self.table, given))
        self.prepare(Recorder(self.loop, self.claim, narrow, centred=True), input_side)
        self.start(prior, prior_time)
