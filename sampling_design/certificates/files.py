"""Certificates as files: one JSON tree, closed by a digest over its canonical form."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sampling_design import __version__, _checks, _files
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError
from sampling_design.evidence import SolverRecord
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.plant import Plant
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

if TYPE_CHECKING:
    from sampling_design.certificates.certificate import Certificate
    from sampling_design.certificates.dissipation import DetectabilityCertificate
    from sampling_design.certificates.family_certificate import FamilyCertificate

FORMAT = "sampling-design/certificate/1"
CLAIM = "assumption-7"
FAMILY_CLAIM = "family"
DETECTABILITY_CLAIM = "detectability"
_NUMBERS = ("eta", "lam", "lam_samples", "margin")
_MATRICES = ("P1", "P2", "Qw", "R", "Qv")
_RATES = ("eta", "c_w", "c_y", "margin")
_AROUND = ("format", "claim", "plant", "tool", "solver", "digest")
_SAMPLED = (*_AROUND, "times", *_MATRICES, *_NUMBERS, "witness")
KEYS = {CLAIM: _SAMPLED, FAMILY_CLAIM: (*_SAMPLED, "graph"), DETECTABILITY_CLAIM: (*_AROUND, "P", *_RATES, "method")}
"""What a file of each claim holds, no more and no less."""


def digest(data: dict[str, Any]) -> str:
    """Return the SHA-256 of the canonical JSON (sorted keys, no spaces, UTF-8) without the key `digest`."""
    rest = {key: value for key, value in data.items() if key != "digest"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def times_to_dict(schedule: Schedule | PeriodicSchedule) -> dict[str, Any]:
    """Return the `times` of a certificate file; outputs null means that every sample measures all of them."""
    outputs = None if schedule.outputs is None else schedule.outputs.astype(int).tolist()
    if isinstance(schedule, PeriodicSchedule):
        return {"kind": "periodic", "gaps": schedule.gaps.tolist(), "first": schedule.first, "outputs": outputs}
    return {"kind": "finite", "times": schedule.times.tolist(), "outputs": outputs}


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


def sealed(plant: Plant, parts: dict[str, Any], solver: SolverRecord | None) -> dict[str, Any]:
    """Return the plain data of a certificate: what every claim's file holds around its own `parts`, digest included."""
    data: dict[str, Any] = {
        "format": FORMAT,
        "plant": plant.to_dict(),
        **parts,
        "tool": {"name": "sampling_design", "version": __version__},
        "solver": None if solver is None else solver.to_dict(),
    }
    data["digest"] = digest(data)
    return data


def certificate_to_dict(certificate: Certificate) -> dict[str, Any]:
    """Return the plain data of a certificate, digest included."""
    seen = certificate.witness
    parts: dict[str, Any] = {
        **certificate._file_parts(),
        **{key: getattr(certificate, key).tolist() for key in _MATRICES},
        **{key: getattr(certificate, key) for key in _NUMBERS},
        "witness": None
        if seen is None
        else {"t": seen.t, "start": seen.start, "direction": list(seen.direction), "ratio": seen.ratio},
    }
    return sealed(certificate.plant, parts, certificate.solver)


def write_certificate(certificate: Certificate | DetectabilityCertificate, path: str | os.PathLike[str]) -> Path:
    """Write a certificate as JSON, whole or not at all; return the path."""
    return _files.write_text(path, _files.to_json(certificate.to_dict()))


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
    if plant is not None and not same_plant(plant, found.plant):
        raise CertificateError(f"{where}: certifies another plant ({found.plant.name or 'unnamed'}).", path=where)
    return found


def same_plant(first: Plant, second: Plant) -> bool:
    """Whether A, C, G and the time unit agree to the last bit; names and inputs do not enter a certificate."""
    alike = all(np.array_equal(getattr(first, key), getattr(second, key)) for key in ("A", "C", "G"))
    return alike and first.time_unit == second.time_unit


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
    from sampling_design.certificates.certificate import Certificate

    return Certificate(plant, schedule=times_from_dict(data["times"]), **_values(data))


def _of_family(data: dict[str, Any], plant: Plant) -> FamilyCertificate:
    from sampling_design.certificates.family_certificate import FamilyCertificate, parts_from_dict

    values = _values(data)
    return FamilyCertificate(plant, **values, **parts_from_dict(data, values["P2"]))


def _detectable(data: dict[str, Any], plant: Plant) -> DetectabilityCertificate:
    from sampling_design.certificates.dissipation import DetectabilityCertificate

    values = {key: data[key] for key in ("P", *_RATES, "method")}
    solver = None if data["solver"] is None else _solver(data["solver"])
    return DetectabilityCertificate(plant, **(values | {"P": data["P"] or np.zeros((0, 0))}), solver=solver)


def _values(data: dict[str, Any]) -> dict[str, Any]:
    """Weights, numbers, witness and solver record of a certificate about samples."""
    from sampling_design.certificates.certificate import Witness

    seen = data["witness"]
    return {
        **{key: data[key] if data[key] else np.zeros((0, 0)) for key in _MATRICES},
        **{key: data[key] for key in _NUMBERS},
        "witness": None if seen is None else Witness(**{**seen, "direction": tuple(seen["direction"])}),
        "solver": _solver(data["solver"]),
    }


READERS: dict[str, Callable[[dict[str, Any], Plant], Any]] = {
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
