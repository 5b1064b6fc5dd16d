"""The radius of a nonlinear estimate after the fact, from an inclusion certificate: any trajectory, however found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import MATRICES, CostFunction
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.estimators.online.schedule_watch import ROUNDINGS
from sampling_design.nonlinear.jacobians import model_of
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.region import StateRegion
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import Plain
from sampling_design.records.vector_bounds import VectorBound, vector_bound
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate

ROUNDING = 1e-9
"""Share of itself that is added to every bound, so that rounding and the integrator's own error cannot break it."""

SAME_GAP = 1e-9  # a gap beyond the certified ones by this share of itself is rounding, and by that of its two times

UNCOVERED = (
    "a gap, an input or an output that the certificate does not cover, a state outside its region, or an unbounded "
    "start"
)
"""Why an estimate under a certificate may have none."""


class WindowTrajectory(NamedTuple):
    """A trajectory of the window as the bound needs it, physical.

    times (K+1,), x (K+1, n), w (K, q), misfit (K+1, p) = y - h(x), counted (K+1,) where the proof takes the sample,
    jumps (K, n): where each interval really ends, seen from the next node.
    """

    times: Array
    x: Array
    w: Array
    misfit: Array
    counted: Mask
    jumps: Array


class InclusionBound:
    """Bounds on |x - xhat|_P(tau) along an estimate's trajectory, tau the time since the last sample that counts.

        r_t = sqrt(J) + sqrt(e^{-eta M} r_{t-M}^2 + int e^{-eta(t-s)} w_bar^2 ds + sum e^{-eta(t-t_j)} v_bar^2)
              + sum e^{-eta(t-t_k)/2} |jump_k|_P(tau_k)

    J is the certificate's cost of the trajectory with the arrival weight P(tau). Where the trajectory jumps, sqrt(V)
    grows by no more than the jump's own size in P, and decays with the rest. Raises ArgumentError if the certificate is
    of another kind or belongs to another plant.

    Parameters
    ----------
    certificate : InclusionCertificate
    plant : NonlinearPlant
        Its boxes of disturbances and noises are w_bar and v_bar.
    initial_error : float or (n,) array, optional
        Bound on |x - prior|, together or entry by entry.
    """

    def __init__(self, certificate: InclusionCertificate, plant: NonlinearPlant, initial_error: VectorBound):
        if certificate.kind != "nonlinear":
            raise ArgumentError(
                "`certificate` must be the InclusionCertificate of a nonlinear plant, from "
                "certify(plant.in_region(...), GapRange(...))."
            )
        data = certificate.model_data
        own = model_of(plant)
        differs = [key for key in ("f", "h", "u", "w") if own[key] != data.get(key)]
        if differs:
            names = {"f": "dynamics", "h": "measurement", "u": "box of inputs", "w": "box of disturbances"}
            raise ArgumentError(f"`certificate` belongs to another plant: its {names[differs[0]]} differs.")
        self.certificate = certificate
        self.region = _region_of(data)
        if certificate.words > 1:
            raise ArgumentError(
                "`certificate` must have one P(tau) for all gaps, to weigh priors between samples, as a GapRange "
                f"or equal gaps have; this one has {certificate.words}, one for each word of its schedules."
            )
        self.shortest, self.longest = certificate.min_gap, certificate.d_max
        self.eta = certificate.eta
        states = plant.states.names
        self._initial = None if initial_error is None else vector_bound("initial_error", initial_error, states)
        self.w_square = _square(certificate.Qw, plant.bounds["disturbances"])
        self.v_square = _square(certificate.Rtilde, plant.bounds["noises"])
        self._bounded = bool(np.isfinite([self.region.lower, self.region.upper]).all())
        self._inputs, still = plant.bounds["inputs"], plant.bounds["disturbances"]
        squares = {"disturbances": self.w_square, "noises": self.v_square}
        missing = [name for name, size in squares.items() if np.isinf(size)]
        self.trouble = f"the plant's box of {' and of '.join(missing)} is not bounded" if missing else ""
        if not missing and self._initial is None and not self._bounded:
            self.trouble = "neither `initial_error` nor a bounded region says how wrong the prior may be"
        if np.any(still[0] > 0) or np.any(still[1] < 0):
            self.w_square, self.trouble = np.inf, "the plant's box of disturbances leaves out 0, the open loop's"

    def counts(self, t: float, last: float) -> bool:
        """Whether the proof takes a sample at t, the last one taken being at `last`."""
        return t - last >= self.shortest - _rounding(self.shortest, t, last)

    def origin(self, prior_time: float, t: float) -> float:
        """When a sample may be thought to have been taken before the prior, so that one at t counts."""
        return min(prior_time, t - self.shortest)

    def age(self, t: float, last: float) -> float:
        """Time since the last sample that counts, as P(tau) takes it; NaN beyond the certified gaps."""
        tau = t - last
        return min(tau, self.longest) if tau <= self.longest + _rounding(self.longest, t, last) else np.nan

    def weight(self, t: float, last: float) -> Array:
        """P(tau) at t, (n, n)."""
        return self.certificate.at(self.age(t, last))

    def largest(self, t: float, last: float, x: Array, prior: bool) -> float:
        """Return the largest V at t about x that the region leaves the truth, and the first error if x is the prior."""
        age = self.age(t, last)
        if np.isnan(age):
            return float("inf")
        P, error = self.certificate.at(age), self._initial
        found = [np.inf]
        if prior and error is not None:
            ball = error.ndim == 0
            found.append(float(np.linalg.eigvalsh(P)[-1] * error**2) if ball else float(error @ np.abs(P) @ error))
        if self._bounded:
            far = np.maximum(self.region.upper - x, x - self.region.lower)
            found.append(float(far @ np.abs(P) @ far))
        return min(found)

    def ahead(self, square: float, start: float, stop: float) -> float:
        """Return the bound on V at `stop`, open loop with w = 0 from one at `start`, without a sample in between."""
        length = stop - start
        grown = np.exp(-self.eta * length) * square + self.w_square * float(discounted_length(self.eta, length))
        return float(grown * (1 + ROUNDING))

    def radius(self, trajectory: WindowTrajectory, prior: Array, square: float, last: float) -> float:
        """Return the bound on V at the window's end; infinite where some gap is not certified.

        Parameters
        ----------
        prior : (n,) array
            Estimate at the window's start, before the sample there if that one counts.
        square : float
            Bound on V there.
        last : float
            When the last sample before that counted.
        """
        times, end = trajectory.times, trajectory.times[-1]
        decay = np.exp(-self.eta * (end - times))
        ages = np.empty(times.size)
        for k, t in enumerate(times.tolist()):
            ages[k] = self.age(t, last)
            last = t if trajectory.counted[k] else last
        if np.isnan(ages).any() or np.isinf(square):
            return float("inf")
        c = self.certificate
        off = trajectory.x[0] - prior
        lengths = np.diff(times)
        spent = discounted_length(self.eta, lengths) * decay[1:]
        cost = decay[0] * off @ c.at(ages[0]) @ off + spent @ np.einsum("ki,ij,kj->k", trajectory.w, c.Qw, trajectory.w)
        weights_of_noise = decay * trajectory.counted
        cost += weights_of_noise @ np.einsum("ki,ij,kj->k", trajectory.misfit, c.Rtilde, trajectory.misfit)
        truth = decay[0] * square + self.w_square * spent.sum() + self.v_square * weights_of_noise.sum()
        jumped = (
            np.einsum("ki,kij,kj->k", trajectory.jumps, c.at(ages[1:]), trajectory.jumps)
            if len(lengths)
            else np.zeros(0)
        )
        total = np.sqrt(cost) + np.sqrt(truth) + np.sqrt(decay[1:]) @ np.sqrt(np.maximum(jumped, 0.0))
        return float(total * (1 + ROUNDING)) ** 2

    def holds(self, x: Array) -> bool:
        """Whether all states (..., n) lie in the region."""
        return bool(self.region.holds(x).all())

    def drives(self, u: Array) -> bool:
        """Whether all inputs (..., m) lie in the box for which the certificate is."""
        low, high = self._inputs
        return bool(np.all((u >= low) & (u <= high)))


def _rounding(gap: float, t: float, last: float) -> float:
    """What rounding leaves open of a gap between two times: clocks that count from 1970 round to 2e-7 s."""
    return SAME_GAP * gap + ROUNDINGS * float(np.spacing(max(abs(t), abs(last))))


def _square(weight: Array, box: tuple[Array, Array]) -> float:
    """Largest weighted square in a box."""
    size = np.maximum(np.abs(box[0]), np.abs(box[1]))
    if not np.isfinite(size).all():
        return float("inf")
    return float(size @ np.abs(weight) @ size)


def _region_of(data: Mapping[str, Plain]) -> StateRegion:
    """The region that a certificate's model names."""
    box = data["x"]
    low, high = (np.array(box[key], dtype=float) for key in ("low", "high"))  # type: ignore[call-overload,index]
    lower, upper = np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)  # None: no bound
    rows = np.array(data["rows"], dtype=float).reshape(-1, low.size)
    return StateRegion(lower, upper, rows, np.array(data["offsets"], dtype=float))


def cost_for(certificate: InclusionCertificate | None, cost: CostFunction | None) -> CostFunction:
    """The cost with a certificate's weights where none are given, and with its form; without one the paper's.

    Raises ArgumentError if the form or the arrival does not fit.
    """
    given = CostFunction() if cost is None else cost
    if certificate is None:
        return replace(given, form=given.form or "paper")
    if given.form == "paper" or given.arrival == "filtered":
        raise ArgumentError(
            '`cost` must have the form "certificate" and the arrival "fixed" with a certificate: the prior weighs '
            "P(tau)."
        )
    own = {key: getattr(certificate, key) for key in (*MATRICES, "eta") if key not in given.given}
    return replace(given, form="certificate", **own)
