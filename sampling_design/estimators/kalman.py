"""The continuous-discrete Kalman filter at irregular times, discounted or not, and its fixed-interval smoother."""

from __future__ import annotations

from copy import copy

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design._linalg import symmetrise
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_function import CostFunction
from sampling_design.estimators.gap_flows.cost_weights import build_weights
from sampling_design.estimators.online.estimator import Contradiction, Estimate, EstimateRecord, Taken
from sampling_design.estimators.online.history import Node, State
from sampling_design.estimators.online.in_order import listed, triple
from sampling_design.estimators.online.open_loop import ROUNDING, Held, MeasuredSample, OpenLoopEstimator, SolveDetails
from sampling_design.estimators.window.smoother import smooth
from sampling_design.estimators.window.square_root import absorb, covariance_root
from sampling_design.estimators.window.window_problem import build_window
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]


class KalmanFilter(OpenLoopEstimator):
    """The filter of all samples since the prior, without constraints.

        min  e^{-eta t}|x(0) - prior|^2_P2 + int e^{-eta(t-tau)}|w|^2_Qw + sum e^{-eta(t-tau)}|y - Cx - Du|^2_R~

    With eta = 0, and P2, Qw, R~ the inverses of the prior's covariance, the disturbance's intensity and the noise's
    covariance, this is the continuous-discrete Kalman filter; with eta > 0 its discounted form, which is what a
    moving horizon estimator without constraints and with an endless horizon computes.

    Parameters
    ----------
    plant : Plant
    certificate : Certificate, optional
        Brings P2, Qw, R, Qv and eta.
    cost : CostFunction, optional
        Weights and rate instead of the certificate's; its form and arrival are those above.
    prior, prior_time, w_bound, v_bound, initial_error, input_side
        As for `MovingHorizonEstimator`.
    maximum_delay : float
        How far back a late sample may lie [time]; snapshots are kept that long. Default 0.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or sign, or the cost is the paper's.

    Notes
    -----
    Limits of detection and composite samples are no Gaussian readings: state and ellipsoid leave them out; `interval`,
    `radii` and `centred` use them.

    Examples
    --------
    >>> cost = CostFunction(P2=[[1.0]], Qw=[[1e9]], R=[[2.0]], Qv=[[2.0]])
    >>> filter = KalmanFilter(Plant([[0.0]], [[1.0]]), cost=cost)
    >>> [round(float(filter.update(t, [3.0]).x[0]), 6) for t in (1.0, 2.0)]
    [1.5, 2.0]
    """

    def __init__(
        self,
        plant: Plant,
        certificate: SampledCertificate | None = None,
        *,
        cost: CostFunction | None = None,
        prior: npt.ArrayLike | None = None,
        prior_time: float = 0.0,
        w_bound: npt.ArrayLike | None = None,
        v_bound: npt.ArrayLike | None = None,
        initial_error: npt.ArrayLike | None = None,
        input_side: str = "right",
        maximum_delay: float = 0.0,
    ):
        cost = CostFunction() if cost is None else cost
        if cost.form == "paper":
            raise ArgumentError(
                '`cost` must have the form "certificate" here: a filter keeps no window of the paper\'s.'
            )
        weights = build_weights(plant, certificate, cost)
        self.claim_note = "No a-priori claim: a filter, not the estimator of the certificate."
        self._set_up(plant, weights, None, input_side)
        self.memory = self.maximum_delay = _checks.nonnegative("maximum_delay", maximum_delay)
        self._set_bounds(w_bound, v_bound, initial_error)
        self.state = self.initial_state(prior, prior_time)

    def _advance(self, state: State, sample: Taken) -> Node:
        y, mask, feedthrough = self._measured(state, sample)
        last, weights = state.last, self.weights
        (flow,) = self.table.get([sample.t - last.t])
        drift = self._drift.between(state, last.t, sample.t)
        with np.errstate(over="ignore", invalid="ignore"):
            x, Y, before = self._flown(last, flow, drift)
        self._refuse_overflow(flow, x if np.isfinite(Y).all() else np.array([np.inf]), sample.t)
        root = weights.at(mask).y_root
        H, innovation = root @ self.plant.C, root @ (y - feedthrough - self.plant.C @ x)
        details: SolveDetails = {"engine": "filter", "window_start": state.nodes[0].t}
        own = float(self._sample_energy(mask[None])[0])
        terms = before + own
        if self._too_large(innovation):
            residual = np.where(mask > 0, y - feedthrough - self.plant.C @ x, 0.0)
            found, note = self._overflowed(state, sample, residual, terms)
            x, Y, beta = self._ahead(last, flow, drift)
            found = found._replace(beta=beta)
            return self._node(
                state, MeasuredSample(sample, y, mask, feedthrough), Held(x, Y, flow, drift), found, details, note
            )
        terms += self._rounded(y, x)
        spread, step, half = absorb(covariance_root(Y), H, innovation)
        Y, x = freeze(symmetrise(spread @ spread.T)), freeze(x + step)
        cost = float(half @ half)
        past = 0.0 if last.sample.y is None else last.estimate.cost / flow.growth
        found = self._judged(terms, cost * (1 - ROUNDING), last)
        if found.status == "bounds disproved" and last.sound:
            found = found._replace(contradiction=self._blame(sample, last.number + 1, (half, cost), (terms, own)))
        details["cost"] = past + cost
        return self._node(state, MeasuredSample(sample, y, mask, feedthrough), Held(x, Y, flow, drift), found, details)

    def _blame(
        self, sample: Taken, number: int, innovation: tuple[Array, float], bounds: tuple[float, float]
    ) -> Contradiction:
        """Return what is known of the sample that made the innovations cost more than the bounds allow."""
        (half, cost), (terms, own) = innovation, bounds
        shown = np.where(np.isfinite(sample.y), np.abs(half), -1.0)
        room = own if own > 0 else terms
        with np.errstate(divide="ignore", over="ignore"):
            factor = float(np.sqrt((cost - terms + room) / np.float64(room)))
        return Contradiction(number, sample.t, self.plant.outputs.names[int(np.argmax(shown))], factor)

    def smooth(self, record: object) -> EstimateRecord:
        """Return the estimates at all samples given all samples (fixed-interval smoother); the filter stays as it is.

        Parameters
        ----------
        record : Measurements, pandas DataFrame or iterable of (t, y, u)
            As for `run`. In order of time, from the filter's prior on.

        Returns
        -------
        EstimateRecord
            `covariance` in units of the last sample (discounted to it), so that the one `radius` of the
            last sample holds for all: |x(t_j) - x_j|^2 in the inverse covariance is at most the radius.
        """
        fresh = copy(self)
        fresh.memory = np.inf
        fresh.state = State(self.initial_state(self.state.nodes[0].x, self.state.nodes[0].t).nodes)
        for item in listed(record, self.plant):
            fresh.update(*triple(item))
        nodes = fresh.state.nodes
        if len(nodes) == 1:
            return EstimateRecord.collect(self.plant, [])
        inside = [node for node in nodes[1:] if node.t > nodes[0].t]
        opening = nodes[1] if nodes[1].t == nodes[0].t else nodes[0]
        rows = [opening, *inside]
        window = build_window(
            self.weights,
            np.array([node.t for node in rows]),
            [node.flow for node in inside if node.flow is not None],
            np.array([node.drift for node in inside]).reshape(-1, self.plant.n_states),
            np.array([nodes[0].x, *(node.x for node in inside)]),
            *(np.array([getattr(node, key) for node in rows]) for key in ("y", "mask", "feedthrough")),
        )
        found = smooth(window)
        kernel, covariance = found.spread.kernel(), [found.covariance]
        for G, S in zip(kernel.gains[::-1], kernel.roots[-2::-1], strict=True):
            covariance.append(symmetrise(G @ covariance[-1] @ G.T + S @ S.T))
        last, estimates = nodes[-1].estimate, []
        for node, x, Y in zip(rows, found.nodes, covariance[::-1], strict=True):
            if node.sample.y is not None:
                estimates.append(
                    Estimate(
                        node.t,
                        freeze(x),
                        freeze(Y),
                        last.radius,
                        last.status,
                        certified=last.certified,
                        note=last.note,
                        cost=last.cost,
                        engine=found.engine,
                        window_start=nodes[0].t,
                    )
                )
        return EstimateRecord.collect(self.plant, estimates)
