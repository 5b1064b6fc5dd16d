"""Certificates from files: one JSON tree, closed by a digest over its canonical form (`seal`)."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from sampling_design import _checks, _files
from sampling_design._door import door
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.certificates.exact.certificate import MATRICES, NUMBERS, Certificate, Witness
from sampling_design.certificates.families.family_certificate import FamilyCertificate, parts_from_dict
from sampling_design.certificates.form.seal import CLAIM, DETECTABILITY_CLAIM, FAMILY_CLAIM, FORMAT, digest
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError
from sampling_design.evidence import SolverRecord
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

_RATES = ("eta", "c_w", "c_y", "margin")
_AROUND = ("format", "claim", "plant", "tool", "solver", "digest")
_SAMPLED = (*_AROUND, "times", *MATRICES, *NUMBERS, "witness")
KEYS = {CLAIM: _SAMPLED, FAMILY_CLAIM: (*_SAMPLED, "graph"), DETECTABILITY_CLAIM: (*_AROUND, "P", *_RATES, "method")}
"""What a file of each claim holds, no more and no less."""


def times_from_dict(data: Any) -> Schedule | PeriodicSchedule:
    """Return the schedule in the `times` of a certificate file.

    Raises
    ------
    ArgumentError
        If it is of another kind, or no schedule.
    """
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind == "periodic":
        _checks.known_keys("`times`", data, ("kind", "gaps", "first", "outputs"))
        return PeriodicSchedule(data.get("gaps"), data.get("first"), data.get("outputs"))
    if kind == "finite":
        _checks.known_keys("`times`", data, ("kind", "times", "outputs"))
        return Schedule(data.get("times"), data.get("outputs"))
    raise ArgumentError(f'`times` must be of kind "periodic" or "finite" here, got {kind!r}.')


@door
def load_certificate(
    path: str | os.PathLike[str], plant: Plant | None = None
) -> Certificate | FamilyCertificate | DetectabilityCertificate:
    """Read a certificate from its JSON file.

    Parameters
    ----------
    path : path
    plant : Plant, optional
        Refuse the file if it certifies another plant.

    Returns
    -------
    Certificate, FamilyCertificate or DetectabilityCertificate
        By the file's claim; not yet proven again: call `verify()`.

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, or holds data that are no certificate.
    CertificateError
        If the digest does not fit (some byte was altered), or it certifies another plant.
    """
    where = os.fspath(path)
    data = _files.from_json(_files.read_text(where), where)
    try:
        found = certificate_from_dict(data, where)
    except ArgumentError as error:
        raise FileFormatError(f"{where}: is no certificate: {error}", where) from None
    if plant is not None and (other := first_difference(plant, found.plant)):
        who = found.plant.name or "unnamed"
        raise CertificateError(f"{where}: certifies another plant ({who}): {other}.", path=where)
    return found


def certificate_from_dict(
    data: dict[str, Any], where: str = "certificate"
) -> Certificate | FamilyCertificate | DetectabilityCertificate:
    """Return the certificate in plain data.

    Raises
    ------
    ArgumentError
        If a key is missing or unknown, or a value is not what it should be.
    CertificateError
        If the digest does not fit.
    """
    if data.get("format") != FORMAT:
        raise ArgumentError(f"`format` must be {FORMAT!r}, got {data.get('format')!r}. Is this a certificate file?")
    claim = data.get("claim")
    if not isinstance(claim, str) or claim not in KEYS:
        raise ArgumentError(f"`claim` must be {', '.join(map(repr, KEYS))} here, got {claim!r}.")
    _checks.known_keys("the certificate", data, KEYS[claim])
    missing = [key for key in KEYS[claim] if key not in data]
    if missing:
        raise ArgumentError(f"`{missing[0]}` is missing in the certificate. Was the file cut off?")
    if data["digest"] != digest(data):
        raise CertificateError(
            f"{where}: the digest does not fit the content: something was altered after it was written.", path=where
        )
    return READERS[claim](data, plant_from_dict(data["plant"], where))


def _sampled(data: dict[str, Any], plant: Plant) -> Certificate:
    return Certificate(plant, times_from_dict(data["times"]), **_values(data))


def _of_family(data: dict[str, Any], plant: Plant) -> FamilyCertificate:
    values = _values(data)
    return FamilyCertificate(plant, **values, **parts_from_dict(data, values["P2"]))


def _detectable(data: dict[str, Any], plant: Plant) -> DetectabilityCertificate:
    values = {key: data[key] for key in ("P", *_RATES, "method")}
    solver = None if data["solver"] is None else _solver(data["solver"])
    return DetectabilityCertificate(plant, **(values | {"P": data["P"] or np.zeros((0, 0))}), solver=solver)


def _values(data: dict[str, Any]) -> dict[str, Any]:
    """Weights, numbers, witness and solver record of a certificate about samples."""
    seen = data["witness"]
    return {
        **{key: data[key] if data[key] else np.zeros((0, 0)) for key in MATRICES},
        **{key: data[key] for key in NUMBERS},
        "witness": None if seen is None else Witness(**{**seen, "direction": tuple(seen["direction"])}),
        "solver": _solver(data["solver"]),
    }


READERS: dict[str, Callable[[dict[str, Any], Plant], Certificate | FamilyCertificate | DetectabilityCertificate]] = {
    CLAIM: _sampled,
    FAMILY_CLAIM: _of_family,
    DETECTABILITY_CLAIM: _detectable,
}
"""Claim of a file and how the record behind it is made from plain data whose keys and digest are right."""


def _solver(data: Any) -> SolverRecord:
    if not isinstance(data, dict):
        raise ArgumentError(f"`solver` must be a table, got {type(data).__name__}.")
    _checks.known_keys("`solver`", data, SolverRecord.__dataclass_fields__)
    return SolverRecord(**data)
