"""Nonlinear plants and their moving horizon estimation, on CasADi (extra `nonlinear`)."""

from sampling_design.nonlinear import thyroid

__all__ = ["thyroid"]
