"""Schedules: when something is measured, independent of what."""
