"""What certificate files claim, by name, and how closely they state it."""

from __future__ import annotations

CLAIM = "assumption-7"
FAMILY_CLAIM = "family"
DETECTABILITY_CLAIM = "detectability"
INCLUSION_CLAIM = "inclusion"

RESOLUTION = 1e-3  # `lam` is the supremum to within this fraction: (1 - RESOLUTION) P2/lam is proven to stay below Pi
STATED_MARGIN = 1e-4
"""Margin that a certificate states, Pi >= (1 + this) P1; what is left of `RESOLUTION` is for the proof."""
