"""The cost of a nonlinear estimator whose least is the most likely trajectory of Gaussian noise."""

import numpy as np

from sampling_design.estimators.gap_flows.cost_weights import CostFunction


def likely_cost(prior, v, w=None, w_time=1.0, form="paper", **more):
    """Inverse covariances of standard deviations; `w` keeps a value for `w_time`."""
    twice = 1.0 if form == "certificate" else 2.0
    P2, R = (np.diag(1 / np.square(value)) for value in (prior, v))
    Qw = None if w is None else np.diag(1 / (np.square(w) * w_time)) / twice
    return CostFunction(P2 / twice, Qw, 2 * R, 2 * R / twice, form=form, **more)
