"""The search for one schedule: Fedorov exchange, refinement, costs. None of it is a claim."""
