"""A certificate that holds for every plant of a model and every schedule with gaps in a range."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.certificate import SampledCertificate, times_to_dict
from sampling_design.certificates.families.graphs import PathCompleteGraph
from sampling_design.certificates.files import graph_from, times_from_dict, values_of
from sampling_design.certificates.form.claims import INCLUSION_CLAIM
from sampling_design.checkers.inclusion_file import Inclusion
from sampling_design.checkers.strict import Tree
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import Claim, Plain, above, below
from sampling_design.schedules.family import SamplingFamily, period_of
from sampling_design.schedules.files import family_from_dict
from sampling_design.schedules.gap_range import GapRange
from sampling_design.schedules.schedule import PeriodicSchedule
from sampling_design.uncertain.inclusion.members import Schedules, graph_for
from sampling_design.uncertain.plants.plant_files import parts_of_model
from sampling_design.uncertain.plants.uncertain_plant import LinearInclusion, UncertainPlant


@dataclass(frozen=True, eq=False, repr=False)
class InclusionCertificate(SampledCertificate):
    """Weights with which every plant of a model is sample-based exponentially i-iIOSS, on all schedules of a family.

        [P' + A'P + PA + eta P, PG; G'P, -Qw] < 0 between samples,    P(0) < P(tau) + C'R~C at a sample

    for every (A, G, C) of the model, P(tau) linear between its nodes, tau the time since the last sample. Each word of
    the schedules' graph has its P(tau), and P(0) is that of the next word. Then V = |x1 - x2|^2_P(tau) obeys Assumption
    7 along any two trajectories that share parameters and inputs.

    Attributes
    ----------
    plant : Plant
        The linear plant at the model's centre, with names, units and scales.
    family : SamplingFamily or PeriodicSchedule
        The schedules that it is about.
    graph : PathCompleteGraph
        Words and edges: every schedule is a path in it.
    model : LinearInclusion or None
        What the certificate is about: an UncertainPlant, or a NonlinearPlant with its region. None: read from a file
        whose model is only known as `model_data`.
    model_data : mapping
        The model as plain data, as the file holds it and the checker judges it.
    nodes : (N,) array [time]
        Of each word from 0 to the longest gap that may follow, the ends of gaps among them; words in their order.
    P : (N, n, n) array
        P(tau) at the nodes; P1 < P < P2.
    multipliers : (N - 1, 2, m) array, optional
        One number per end of a piece and column that a parameter moves, for boxes of many parameters.

    Notes
    -----
    `lam` is at least lambda_max(P2, P1), to 1e-3. *Claim.* For every real window start and every schedule of the
    family; for a nonlinear plant as long as both trajectories stay in its region. Before its first sample a schedule is
    so far in a gap that it ends as that sample comes.

    References
    ----------
    The paper, Assumption 7; Boyd et al. 1994.
    """

    _apart = 4.0  # V(t) <= 4 J(truth): each differs from the data's centre by at most the cost (Theorem G)

    family: Schedules
    graph: PathCompleteGraph | None = field(default=None, kw_only=True)
    model: LinearInclusion | None = field(default=None, kw_only=True)
    model_data: dict[str, Plain] = field(default_factory=dict, kw_only=True)
    nodes: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    P: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), kw_only=True)
    multipliers: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.family, (SamplingFamily, PeriodicSchedule)):
            kinds = "a GapRange, another family or a PeriodicSchedule"
            raise ArgumentError(f"`family` must be {kinds}, got {checks.described(self.family)}.")
        if self.graph is None:
            self._hold(graph=graph_for(self.family, 0, self.plant.n_outputs))
        nodes = checks.floats("nodes", self.nodes)
        if nodes.ndim != 1 or nodes.size < 2 or nodes[0] != 0 or not np.all(np.diff(nodes)[nodes[1:] != 0] > 0):
            raise ArgumentError("`nodes` must increase from 0, for each word of the graph.")
        shape = (nodes.size, *self.P2.shape)
        P = checks.floats("P", self.P)
        if P.shape != shape:
            raise ArgumentError(f"`P` must hold one matrix per node, shape {shape}, got {P.shape}.")
        if self.model is not None and not self.model_data:
            self._hold(model_data=self.model.model_to_dict())
        P = np.array([checks.definite(f"P[{k}]", M, self.P2.shape[0]) for k, M in enumerate(P)]).reshape(shape)
        self._hold(nodes=freeze(nodes), P=freeze(P))

    @property
    def covers(self) -> Schedules:
        """The schedules that it is about."""
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
            f"sample-based exponential i-iIOSS with rate {below(self.eta)} for every plant of the model, every "
            "schedule of the family and every real window start",
            "Assumption 7",
            (*(known if self.model is None else self.model.assumptions), self.family.explain().rstrip(".")),
        )

    @property
    def words(self) -> int:
        """How many P(tau) there are: one per word of the graph, and one for the start where it needs its own."""
        return int(np.count_nonzero(self.nodes == 0))

    def at(self, tau: npt.ArrayLike, word: int = -1) -> Array:
        """Return P(tau), (n, n) for a number and (K, n, n) for K times since the last sample.

        Parameters
        ----------
        tau : float or (K,) array [time]
        word : int
            Of which word, in the order of the nodes; default the last one.

        Raises
        ------
        ArgumentError
            If a time lies outside of [0, longest gap], or there is no such word.
        """
        if not -self.words <= checks.whole("word", word, -self.words) < self.words:
            raise ArgumentError(f"`word` must be one of the {self.words} words of the graph, got {word!r}.")
        ends = np.append(np.flatnonzero(self.nodes == 0), self.nodes.size)
        own = slice(ends[:-1][word], ends[1:][word])
        nodes, P = self.nodes[own], self.P[own]
        times = np.atleast_1d(checks.floats("tau", tau))
        if np.any((times < 0) | (times > nodes[-1] * (1 + 1e-12))):
            raise ArgumentError(f"`tau` must lie in [0, {nodes[-1]:.6g}], the gaps that are certified.")
        k = np.clip(np.searchsorted(nodes, times, side="right") - 1, 0, nodes.size - 2)
        share = np.clip((times - nodes[k]) / np.diff(nodes)[k], 0.0, 1.0)[:, None, None]
        found = (1 - share) * P[k] + share * P[k + 1]
        return np.asarray(found[0] if np.ndim(tau) == 0 else found)

    def _file_parts(self) -> dict[str, object]:
        family = self.family
        times = family.to_dict() if isinstance(family, SamplingFamily) else times_to_dict(family)
        diagonals = None if self.multipliers is None else np.asarray(self.multipliers).tolist()
        parts: dict[str, object] = {"claim": INCLUSION_CLAIM, "times": times, "model": self.model_data}
        if not isinstance(family, GapRange):
            assert self.graph is not None
            own = self.graph.to_dict(self.P[:0])
            parts["graph"] = {key: own[key] for key in ("words", "edges")}
        return parts | {"nodes": self.nodes, "P": self.P, "multipliers": diagonals}

    def _rows(self) -> list[tuple[str, str]]:
        arrival = self.horizon("arrival")
        about = {"box": "parameters in a box", "vertices": "between vertices", "nonlinear": "nonlinear, in a region"}
        return [
            ("plant", f"{self.plant.name or '-'} ({about.get(self.kind, self.kind)})"),
            ("family", self.family.explain()),
            *super()._rows(),
            ("horizon, arrival weight P(tau)", f"M > {above(arrival.minimum)} {self.plant.time_unit}"),
            ("pieces", str(int(np.count_nonzero(self.nodes)))),
        ]

    def explain(self) -> str:
        """Say what the certificate proves."""
        unit = self.plant.time_unit
        return (
            f"{self.family.explain()} Every plant of the model is detectable with each of these schedules: the "
            f"distance of two trajectories, weighed by P(tau), decays at rate {below(self.eta)} per {unit}, up to what "
            "disturbances, noise and samples show of it. The error bound of a moving horizon estimator contracts if "
            f"its horizon is longer than {above(self.horizon('arrival').minimum)} {unit} with the arrival weight "
            f"P(tau), and than {above(self.horizon().minimum)} {unit} with P2."
        )


def read_inclusion(data: Tree, plant: Plant, found: Inclusion) -> InclusionCertificate:
    """Return the certificate of an inclusion in plain data that the auditor read as `found`."""
    model = None
    if found.model.kind != "nonlinear":
        nominal, parameters, vertices, varying = parts_of_model(plant, data["model"])
        model = UncertainPlant(nominal, parameters, vertices=vertices, varying=varying)
    periodic = data["times"]["kind"] == "periodic"
    times = period_of(times_from_dict(data["times"])) if periodic else family_from_dict(data["times"])
    graph = graph_from(data["graph"]["words"], found.graph) if "graph" in data else None
    return InclusionCertificate(
        plant, times, **values_of(data), graph=graph, model=model, model_data=data["model"], nodes=found.nodes,
        P=found.P, multipliers=found.multipliers,
    )  # fmt: skip
