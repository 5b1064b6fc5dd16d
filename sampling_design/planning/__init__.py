"""Plans: from opening hours, prices and a wanted accuracy to a calendar that keeps its promise."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "files": ("read_plan",),
    "plan": ("plan_samples",),
    "plan_record": ("write_plan",),
    "requirement": ("PlanRequirement",),
    "requirement_file": ("read_plan_requirement",),
    "upcoming_sample": ("next_sample",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
