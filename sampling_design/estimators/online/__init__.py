"""Samples as they come: order, lateness, history, and what is promised for each estimate."""
