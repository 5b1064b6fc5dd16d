"""Certificates that a process makes, kept as files and decided in ball arithmetic afterwards.

`watch` wraps the functions of the package that make certificates (`MAKERS`): whatever they return is written as a file,
once per content, into the folder that the environment names. A process that a test or a page starts (a notebook's
kernel, the arena) calls `watch` itself.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MAKERS = {
    "certificates.certification": ("certify_given",),
    "certificates.exact.proof": ("ScheduleProof.closed",),
    "certificates.exact.precise": ("_proven",),
    "certificates.families.certify_family": ("certified", "without_states"),
    "certificates.paper.proof_constants": ("ProofConstants.certificate",),
    "uncertain.inclusion.search": ("accepted",),
    "certificates.detectability.best_rate": ("proven",),
}
"""Functions that return a finished certificate; a law walks the package for constructors outside of them."""
FOLDER = "SAMPLING_DESIGN_CERTIFICATES"
"""Environment variable: where the certificates of this process go."""
BUDGET = 600.0
"""Seconds for one certificate, far beyond what any takes: no clock decides a test."""


def content(data: dict[str, Any]) -> str:
    """What a certificate states, as a key: all of its file but who made it."""
    stated = {key: value for key, value in data.items() if key not in ("digest", "tool", "solver")}
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()


def keep(certificate: Any) -> None:
    """Write a certificate into this process's folder, unless it is there."""
    data = certificate.to_dict()
    path = Path(os.environ[FOLDER]) / f"{content(data)}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        partly = path.with_suffix(f".{os.getpid()}")
        partly.write_text(json.dumps(data))
        partly.replace(path)


def watch() -> None:
    """Keep from now on what the makers return, if the environment says where."""
    if FOLDER not in os.environ:
        return
    for module, names in MAKERS.items():
        for name in names:
            *inner, last = name.split(".")
            holder: Any = importlib.import_module(f"sampling_design.{module}")
            for part in inner:
                holder = getattr(holder, part)
            if not hasattr(getattr(holder, last), "watched"):
                setattr(holder, last, _watched(getattr(holder, last)))


def _watched(maker: Any) -> Any:
    @functools.wraps(maker)
    def made(*arguments: Any, **options: Any) -> Any:
        certificate = maker(*arguments, **options)
        keep(certificate)
        return certificate

    made.watched = True  # type: ignore[attr-defined]
    return made


def open_ones(folder: Path) -> Iterator[str]:
    """Decide the certificates of a folder, move those that are proven to `proven` in it, and say of the others why."""
    from sampling_design.certificates.rigorous.decide import verify_rigorously

    (folder / "proven").mkdir(parents=True, exist_ok=True)
    for path in sorted(folder.glob("*.json")):
        data = json.loads(path.read_text())
        found = verify_rigorously(data, BUDGET)
        if found.verdict == "proven":
            path.replace(folder / "proven" / path.name)
        else:
            yield f"{data['claim']}: {found.verdict}: {found.reason}"


def check_proven(folder: Path, least: int) -> list[dict[str, Any]]:
    """Assert that at least so many certificates were written into a folder and that each is proven; return them."""
    told = list(open_ones(folder))
    assert not told, "; ".join(told)
    made = [json.loads(path.read_text()) for path in sorted((folder / "proven").glob("*.json"))]
    assert len(made) >= least, f"{len(made)} certificates were made, {least} at least were expected"
    return made
