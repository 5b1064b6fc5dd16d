"""Theorem 10: detectability as one dissipation inequality, with the best rate and gains."""
