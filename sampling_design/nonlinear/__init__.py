"""Nonlinear plants and their moving horizon estimation, on CasADi (extra `nonlinear`)."""
