"""A certificate that holds for every schedule of a family."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sampling_design.certificates.exact.certificate import WITHOUT_GAIN, SampledCertificate, latest_samples
from sampling_design.certificates.families.graphs import PathCompleteGraph, family_in_words, in_plant_terms
from sampling_design.certificates.form.claims import FAMILY_CLAIM
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Claim, below
from sampling_design.schedules.family import SamplingFamily


@dataclass(frozen=True, eq=False, repr=False)
class FamilyCertificate(SampledCertificate):
    """Weights with which every schedule of a family makes a plant sample-based exponentially i-iIOSS.

    Attributes
    ----------
    family : GapRange, SpacedWindows, LostSamples, Jitter or OutputJitter
    graph : PathCompleteGraph
        Its schedules as paths of gap words, window starts at any real time included.
    P : (graph.count, n, n) array
        Information that is kept at each node; P[0] = P2. `path_complete` lists the inequalities.
    lam : float
        lambda_max(P2, Phi_s(P_u)) is at most lam/(1 - 1e-3) at every node and time: an upper bound on the supremum
        over all schedules of the family and all window starts, attained by the matrices, not by a schedule.
    lam_samples : float
        The same number: the first sample of a schedule may come at any time.

    Notes
    -----
    All other attributes, horizons and error bounds are those of `SampledCertificate`; samples that an error bound
    counts are as many as the least gap of the family allows.
    """

    family: SamplingFamily
    graph: PathCompleteGraph = field(default_factory=lambda: PathCompleteGraph(((),), ()), kw_only=True)
    P: Array = field(default_factory=lambda: np.zeros((1, 0, 0)), kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "family", in_plant_terms(self.plant, self.family))
        checks.of_kind("graph", self.graph, PathCompleteGraph)
        P = checks.floats("P", self.P)
        if P.shape != (self.graph.count, *self.P2.shape) or not np.array_equal(P[0], self.P2):
            raise ArgumentError(f"`P` must hold one matrix per node of the graph, P2 first, got shape {P.shape}.")
        object.__setattr__(self, "P", freeze(P))

    @property
    def covers(self) -> SamplingFamily:
        """The family of schedules."""
        return self.family

    @property
    def claim(self) -> Claim:
        """What the certificate says; `verify()` proves it."""
        return Claim(
            f"sample-based exponential i-iIOSS with rate {below(self.eta)} for every schedule of the family and every "
            "real window start",
            "Assumption 7",
            ("linear plant", family_in_words(self.plant, self.family).rstrip(".")),
        )

    def _samples_until(self, end: float) -> Array:
        """The most that a schedule of the family has; outputs that are read one at a time have samples of their own."""
        gaps = [part.min_gap for part in self.family.by_output if part is not None] or [self.min_gap]
        return np.concatenate([latest_samples(end, gap) for gap in gaps])

    def _file_parts(self) -> dict[str, object]:
        return {"claim": FAMILY_CLAIM, "times": self.family.to_dict(), "graph": self.graph.to_dict(self.P)}

    def _rows(self) -> list[tuple[str, str]]:
        size = f"{self.graph.count - 1} node{'s' * (self.graph.count != 2)}, {len(self.graph.edges)} edges"
        return [("family", family_in_words(self.plant, self.family)), *super()._rows(), ("graph", size)]

    def explain(self) -> str:
        """Say what the certificate proves."""
        weights = str(self.solver.details.get("weights", ""))
        counted = f" Its {weights}." if weights.startswith(WITHOUT_GAIN) else f" Its weights count {weights}."
        counted = counted if weights else ""
        family = family_in_words(self.plant, self.family)
        return f"{family} The plant is detectable with each of them: {self._promise()}{counted}"
