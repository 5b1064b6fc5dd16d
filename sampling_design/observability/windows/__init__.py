"""Sigma of given samples: the observability matrix, and every real position of a sliding window."""
