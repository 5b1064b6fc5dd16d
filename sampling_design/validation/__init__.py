"""Validation: does what was promised come true? Trials, worst cases, and a report that compares."""
