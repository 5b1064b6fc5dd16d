"""Which file decides which claim, and the judged content of a certificate file of any claim."""

from collections.abc import Mapping
from importlib import import_module

from .parts import FORMAT, Claim, digest, plant_of
from .strict import BadFile, is_text, plain, refuse

CLAIMS = {
    "assumption-7": "sampled",
    "family": "families",
    "detectability": "detectability",
    "inclusion": "inclusion",
    "interval": "recovered",
}
"""Each claim and the file whose `CLAIM` decides it, opened when one comes: what is not opened has no part in it."""


def claim_of(data: Mapping[str, object]) -> Claim:
    """What the file claims, or BadFile."""
    if data.get("format") != FORMAT:
        raise refuse("format", f"must be {FORMAT!r}, got {data.get('format')!r:.60}. Is this a certificate file?")
    name = data.get("claim")
    if not is_text(name) or name not in CLAIMS:
        known = ", ".join(map(repr, CLAIMS))
        raise BadFile(f"`claim` must be {known} here, got {name!r:.60}")
    found: Claim = import_module(f".{CLAIMS[name]}", __package__).CLAIM
    return found


def certificate(data: Mapping[str, object]) -> object:
    """Return the certificate in the plain data of a file, as the record of its claim, or raise BadFile."""
    data = plain(data)
    claim = claim_of(data)
    read = claim.table(data, "")
    if data["digest"] != digest(data):
        raise BadFile("the digest does not fit the content: something was altered after it was written", "digest")
    return claim.record(read, plant_of(read["plant"]))
