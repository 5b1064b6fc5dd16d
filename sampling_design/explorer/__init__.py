"""What happens when a sample moves: a time line to drag, in a browser or a notebook."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "schedule_explorer": ("ScheduleExplorer",),
    "notebook": ("explore",),
    "scenes": ("SCENES", "scene"),
    "server": ("serve",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
