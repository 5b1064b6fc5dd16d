"""Certificates side by side: four horizons, horizon against noise gain, true contraction, robustness."""
