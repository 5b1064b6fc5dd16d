"""Certificates for uncertain, varying and nonlinear plants: P(tau), tau the time since the last sample."""
