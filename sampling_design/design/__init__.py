"""Where to put the samples: requirements, schedules, and the bound that no schedule can beat."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "bounds.evidence": ("BoundPart", "UpperBound"),
    "design": ("design_schedule",),
    "design_files": ("write_design",),
    "losses": ("SampleLosses", "design_and_losses", "sample_losses"),
    "pareto": ("ParetoFront", "ParetoPoint", "pareto_front"),
    "problem.requirement": ("Requirement", "read_requirement", "requirement_from_dict", "write_requirement"),
    "schedule_design": ("ScheduleDesign",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES, modules=("bounds", "problem", "search"))
