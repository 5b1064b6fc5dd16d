"""Bounds that no admissible schedule can beat, as evidence that anyone can check."""
