"""Estimators: the state, and a radius that holds it, from rare and irregular measurements."""
