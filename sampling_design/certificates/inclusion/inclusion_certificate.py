"""A certificate that holds for every plant of a model and every schedule with gaps in a range."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Plain, short
from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.certificates.form.horizon import Horizon, horizon_of, largest_eigenvalue, least_eigenvalue
from sampling_design.certificates.form.seal import INCLUSION_CLAIM
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.evidence import Claim
from sampling_design.plants.inclusion import LinearInclusion
from sampling_design.schedules.gap_range import GapRange

Array = npt.NDArray[np.float64]

_TWO_TRAJECTORIES = 4.0
"""V(t) <= 4 J(truth): estimate and truth each differ from the data's centre by at most the cost (Theorem G)."""
_CONTRACTION = 4.0
"""By default a window shrinks the squared error by this factor."""


@dataclass(frozen=True, eq=False, repr=False)
class InclusionCertificate(SampledCertificate):
    """Weights with which every plant of a model is sample-based exponentially i-iIOSS, for all gaps in a range.

        [P' + A'P + PA + eta P, PG; G'P, -Qw] < 0 between samples,    P(0) < P(tau) + C'R~C at a sample

    for every (A, G, C) of the model, P(tau) linear between its nodes, tau the time since the last sample. Then
    V = |x1 - x2|^2_P(tau) obeys Assumption 7 along any two trajectories that share parameters and inputs.

    Attributes
    ----------
    plant : Plant
        The linear plant at the model's centre, with names, units and scales.
    family : GapRange
    model : LinearInclusion or None
        What the certificate is about: an UncertainPlant, or a NonlinearPlant with its region. None: read from a file
        whose model is only known as `model_data`.
    model_data : mapping
        The model as plain data, as the file holds it and the checker judges it.
    nodes : (N,) array [time]
        0 first, the longest gap last, the shortest gap among them.
    P : (N, n, n) array
        P(tau) at the nodes; P1 < P < P2.
    multipliers : (N - 1, 2, m) array, optional
        One number per end of a piece and column that a parameter moves, for boxes of many parameters.

    Notes
    -----
    `lam` is at least lambda_max(P2, P1), to 1e-3. *Claim.* For every real window start and every schedule with gaps in
    the range; for a nonlinear plant as long as both trajectories stay in its region.

    References
    ----------
    The paper, Assumption 7; Boyd et al. 1994.
    """

    family: GapRange
    model: LinearInclusion | None = field(default=None, kw_only=True)
    model_data: dict[str, Plain] = field(default_factory=dict, kw_only=True)
    nodes: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    P: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), kw_only=True)
    multipliers: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.family, GapRange):
            raise ArgumentError(f"`family` must be a GapRange, got {_checks.described(self.family)}.")
        nodes = _checks.increasing("nodes", self.nodes)
        shape = (nodes.size, *self.P2.shape)
        P = _checks.floats("P", self.P)
        if P.shape != shape:
            raise ArgumentError(f"`P` must hold one matrix per node, shape {shape}, got {P.shape}.")
        if self.model is not None and not self.model_data:
            object.__setattr__(self, "model_data", self.model.model_to_dict())
        object.__setattr__(self, "nodes", nodes)
        P = np.array([_checks.definite(f"P[{k}]", M, self.P2.shape[0]) for k, M in enumerate(P)]).reshape(shape)
        object.__setattr__(self, "P", _checks.freeze(P))

    @property
    def covers(self) -> GapRange:
        """The range of the gaps."""
        return self.family

    @property
    def kind(self) -> str:
        """ "box", "vertices" or "nonlinear"."""
        return str(self.model_data.get("kind", ""))

    @property
    def claim(self) -> Claim:
        """What the certificate says; `verify()` proves it."""
        nonlinear = ("both trajectories stay in the plant's region", "noise added to the outputs")
        known = nonlinear if self.model is None and self.kind == "nonlinear" else ("linear plant in the model",)
        return Claim(
            f"sample-based exponential i-iIOSS with rate {short(self.eta)} for every plant of the model, every "
            "schedule of the family and every real window start",
            "Assumption 7",
            (*(known if self.model is None else self.model.assumptions), self.family.explain().rstrip(".")),
        )

    @property
    def d_max(self) -> float:
        """Largest gap."""
        return float(self.family.longest)

    def at(self, tau: npt.ArrayLike) -> Array:
        """Return P(tau), (n, n) for a number and (K, n, n) for K times since the last sample.

        Raises
        ------
        ArgumentError
            If a time lies outside of [0, longest gap].
        """
        times = np.atleast_1d(_checks.floats("tau", tau))
        if np.any((times < 0) | (times > self.nodes[-1] * (1 + 1e-12))):
            raise ArgumentError(f"`tau` must lie in [0, {self.nodes[-1]:.6g}], the gaps that are certified.")
        k = np.clip(np.searchsorted(self.nodes, times, side="right") - 1, 0, self.nodes.size - 2)
        share = np.clip((times - self.nodes[k]) / np.diff(self.nodes)[k], 0.0, 1.0)[:, None, None]
        found = (1 - share) * self.P[k] + share * self.P[k + 1]
        return np.asarray(found[0] if np.ndim(tau) == 0 else found)

    def horizon(self, theorem: str = "sharp", length: float | None = None) -> Horizon:
        """Return a horizon and its error bound.

            "sharp":   M > ln(4 lam)/eta, arrival weight P2             (Theorem G)
            "arrival": M > ln(4)/eta whatever lam is, arrival weight P(tau)  (Theorem G)
            "paper":   M > 2 ln(2 lam)/eta, cost (15)                   (Theorem 9)

        Parameters
        ----------
        theorem : str
        length : float, optional [time]
            Default: each window shrinks the squared error to a quarter.

        Raises
        ------
        ArgumentError
            If the theorem is unknown.
        CertificateError
            If `length` is too short for the theorem.
        """
        _checks.word("theorem", theorem, ("sharp", "arrival", "paper"))
        if theorem == "paper":
            return horizon_of(self, "paper", length)
        lost = _TWO_TRAJECTORIES * (self.lam_proven if theorem == "sharp" else 1.0)
        minimum = float(np.log(lost)) / self.eta
        default = max(self.d_max, minimum + float(np.log(_CONTRACTION)) / self.eta)
        M = default if length is None else _checks.positive("length", length)
        if not minimum < M:
            raise CertificateError(
                f"`length` = {M:.6g} is too short: Theorem G needs M > {minimum:.6g}.", minimum=minimum, length=M
            )
        low = least_eigenvalue(self.P1)
        C_x, C_w, C_v = (_TWO_TRAJECTORIES * largest_eigenvalue(W) / low for W in (self.P2, self.Qw, self.Rtilde))
        rate = self.eta - float(np.log(lost)) / M
        found = {"C_x": C_x, "C_w": C_w, "C_v": C_v, "lam": self.lam_proven}
        return Horizon(theorem, minimum, M, rate, **found, time_unit=self.plant.time_unit)

    def _samples_until(self, end: float) -> Array:
        # the i-th last sample of any schedule lies at least i least gaps before `end`
        return np.asarray(end - self.family.min_gap * np.arange(int(max(end, 0.0) / self.family.min_gap) + 1))

    def _file_parts(self) -> dict[str, Plain]:
        times: dict[str, Plain] = {
            "kind": "gap-range",
            "shortest": self.family.shortest,
            "longest": self.family.longest,
        }
        diagonals = None if self.multipliers is None else np.asarray(self.multipliers).tolist()
        parts: dict[str, Plain] = {"claim": INCLUSION_CLAIM, "times": times, "model": self.model_data}
        return parts | {"nodes": self.nodes.tolist(), "P": self.P.tolist(), "multipliers": diagonals}

    def _rows(self) -> list[tuple[str, str]]:
        arrival = self.horizon("arrival")
        about = {"box": "parameters in a box", "vertices": "between vertices", "nonlinear": "nonlinear, in a region"}
        return [
            ("plant", f"{self.plant.name or '-'} ({about.get(self.kind, self.kind)})"),
            ("family", self.family.explain()),
            *super()._rows(),
            ("horizon, arrival weight P(tau)", f"M > {short(arrival.minimum)} {self.plant.time_unit}"),
            ("pieces", str(self.nodes.size - 1)),
        ]

    def explain(self) -> str:
        """Say what the certificate proves."""
        unit = self.plant.time_unit
        return (
            f"{self.family.explain()} For every plant of the model and each of these schedules the distance of two "
            f"trajectories, weighed by P(tau), fades at rate {short(self.eta)} per {unit} but for what noise and "
            f"samples show of it; a window longer than {short(self.horizon('arrival').minimum)} {unit} contracts with "
            f"the arrival weight P(tau), longer than {short(self.horizon().minimum)} {unit} with P2."
        )
