"""What every room uses: argument checks, records, files, units, workers, sweeps and progress."""

from sampling_design.records.lazy import lazy

_NAMES = {"budget": ("progress_bar",), "sweeps": ("Sweep", "sweep")}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
