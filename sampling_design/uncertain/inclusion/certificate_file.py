"""Certificates of inclusions from files."""

from __future__ import annotations

from sampling_design.certificates.files import graph_from, times_from_dict, values_of
from sampling_design.checkers.inclusion_file import Inclusion
from sampling_design.checkers.strict import Tree
from sampling_design.plants.plant import Plant
from sampling_design.schedules.family import period_of
from sampling_design.schedules.family_files import family_from_dict
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.uncertain.plants.plant_files import parts_of_model
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant


def read_inclusion(data: Tree, plant: Plant, found: Inclusion) -> InclusionCertificate:
    """Return the certificate of an inclusion in plain data that the auditor read as `found`."""
    model = None
    if found.model.kind != "nonlinear":
        nominal, parameters, vertices, varying = parts_of_model(plant, data["model"])
        model = UncertainPlant(nominal, parameters, vertices=vertices, varying=varying)
    periodic = data["times"]["kind"] == "periodic"
    times = period_of(times_from_dict(data["times"])) if periodic else family_from_dict(data["times"])
    return InclusionCertificate(
        plant,
        times,
        **values_of(data),
        graph=graph_from(data["graph"]["words"], found.graph) if "graph" in data else None,
        model=model,
        model_data=data["model"],
        nodes=found.nodes,
        P=found.P,
        multipliers=found.multipliers,
    )
