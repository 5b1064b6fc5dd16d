"""Certificates from files: one JSON tree, closed by a digest over its canonical form (`digest`)."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.exact.certificate import MATRICES, NUMBERS, Certificate, SampledCertificate, Witness
from sampling_design.certificates.families.family_certificate import FamilyCertificate
from sampling_design.certificates.families.graphs import PathCompleteGraph
from sampling_design.checkers import claims, detectability, family_file, schedule_file
from sampling_design.checkers.check import verdict
from sampling_design.checkers.interval_file import OfInterval
from sampling_design.checkers.outcome import REFUTED, UNDECIDED
from sampling_design.checkers.strict import BadFile, Tree
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError, UndecidedError
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.records import checks, file_io
from sampling_design.records.dispatch import offered
from sampling_design.records.record import SolverRecord
from sampling_design.records.signatures import checked
from sampling_design.schedules.files import family_from_dict
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

AnyCertificate: TypeAlias = SampledCertificate | DetectabilityCertificate
_RATES = ("eta", "c_w", "c_y", "margin")


def times_from_dict(data: Tree) -> Schedule | PeriodicSchedule:
    """Return the schedule in the `times` of a certificate file, which the checkers' grammar has read."""
    if data["kind"] == "periodic":
        return PeriodicSchedule(data["gaps"], data["first"], data.get("outputs"))
    return Schedule(data["times"], data.get("outputs"))


@checked
def read_certificate(path: str | os.PathLike[str], plant: Plant | None = None) -> AnyCertificate:
    """Read a certificate from its JSON file.

    Parameters
    ----------
    path : path
    plant : Plant, optional
        Refuse the file if it certifies another plant.

    Returns
    -------
    Certificate, FamilyCertificate, InclusionCertificate or DetectabilityCertificate
        By the file's claim; not yet proven again: call `verify()`.

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, holds data that are no certificate, or its digest does
        not fit (some byte was altered).
    CertificateError
        If it certifies another plant, or a weight is not positive definite; UndecidedError where the
        checkers leave that open.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from sampling_design import PeriodicSchedule, certify
    >>> made = certify(Plant([[0.0]], [[1.0]]), PeriodicSchedule([1.0]), eta=0.5, P2=[[1.0]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = read_certificate(made.save(pathlib.Path(folder) / "certificate.json"))
    >>> found.lam == made.lam, found.verify().passed
    (True, True)
    """
    where = os.fspath(path)
    data = file_io.from_json(file_io.read_text(where), where)
    try:
        certificate = certificate_from_dict(data, where)
    except ArgumentError as error:
        raise FileFormatError(f"{where}: is no certificate: {error}", where) from None
    if plant is not None and (other := first_difference(plant, certificate.plant)):
        who = certificate.plant.name or "unnamed"
        raise CertificateError(f"{where}: certifies another plant ({who}): {other}.", path=where)
    return certificate


def certificate_from_dict(data: Tree, where: str = "certificate") -> AnyCertificate:
    """Return the certificate in plain data.

    Raises ArgumentError if a key is missing or unknown, or a value is not exactly what it should be; FileFormatError if
    the digest does not fit; CertificateError if a weight is not positive definite.
    """
    try:
        content = claims.certificate(data)
    except BadFile as error:
        if error.broken == "digest":
            raise FileFormatError(error.said(where), where) from None
        raise ArgumentError(error.said()) from None
    if isinstance(content, OfInterval):
        raise FileFormatError(
            f"{where}: holds an interval. Use Interval.read (sampling_design.accuracy.interval).", where
        )
    read = READERS.get(type(content)) or offered("read_certificate", data["claim"], SampledCertificate)
    assert read is not None, "a claim that the auditor reads and nobody else"
    try:
        return read(data, plant_from_dict(data["plant"], where), content)
    except ArgumentError:  # of numbers that the auditor reads too: what it says of them is the answer
        found, refused = verdict(data), {REFUTED: CertificateError, UNDECIDED: UndecidedError}
        if found.verdict not in refused:
            raise
        why = f"{where}: is not proven: {found.reason}."
        raise refused[found.verdict](why, path=where, inequality=found.inequality) from None


def _sampled(data: Tree, plant: Plant, content: schedule_file.Sampled) -> Certificate:
    return Certificate(plant, times_from_dict(data["times"]), **values_of(data))


def graph_from(words: list[list[float]], read: family_file.Graph) -> PathCompleteGraph:
    """The graph as it was read, its words as they were written: whole numbers and others."""
    return PathCompleteGraph(tuple(tuple(word) for word in words), read.edges)


def _of_family(data: Tree, plant: Plant, content: family_file.OfFamily) -> FamilyCertificate:
    graph = graph_from(data["graph"]["words"], content.graph)
    values = values_of(data)
    n = plant.n_states
    P = [checks.definite("P2", values["P2"], n), *(checks.definite("graph.P", M, n) for M in content.graph.P[1:])]
    return FamilyCertificate(plant, family_from_dict(data["times"]), **values, graph=graph, P=np.stack(P))


def _detectable(data: Tree, plant: Plant, content: detectability.Detectability) -> DetectabilityCertificate:
    values = {key: data[key] for key in ("P", *_RATES, "method")}
    solver = None if data["solver"] is None else SolverRecord(**data["solver"])
    return DetectabilityCertificate(plant, **(values | {"P": data["P"] or np.zeros((0, 0))}), solver=solver)


def values_of(data: Tree) -> Tree:
    """Weights, numbers, witness and solver record of a certificate about samples."""
    witness = data["witness"]
    return {
        **{key: data[key] if data[key] else np.zeros((0, 0)) for key in MATRICES},
        **{key: data[key] for key in NUMBERS},
        "witness": None if witness is None else Witness(**{**witness, "direction": tuple(witness["direction"])}),
        "solver": SolverRecord(**data["solver"]),
    }


READERS: dict[type, Callable[..., AnyCertificate]] = {
    schedule_file.Sampled: _sampled,
    family_file.OfFamily: _of_family,
    detectability.Detectability: _detectable,
}
"""What the auditor read of a file -> the record that it is for everybody else."""
