"""Plans: from opening hours, prices and a wanted accuracy to a calendar that keeps its promise."""

from sampling_design._lazy import lazy

_NAMES = {
    "files": ("load_plan",),
    "requirement": ("PlanRequirement",),
    "requirement_file": ("read_plan_requirement",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
