"""Sigma and counts over a box of plants, or along a plant that varies."""
