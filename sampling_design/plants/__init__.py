"""Plants: what is measured, independent of when."""

from sampling_design.plants import library

__all__ = ["library"]
