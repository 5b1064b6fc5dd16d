"""Validation: does what was promised come true? MonteCarloTrials, worst cases, and a report that compares."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "comparison": ("validate",),
    "report": ("ClaimCheck", "ValidationReport"),
    "scenario": ("SimulatedRecord", "simulate_record"),
    "schedule_log": ("ScheduleLog", "compare_schedule"),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
