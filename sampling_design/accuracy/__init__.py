"""What anybody can recover of the state from a schedule when noise and disturbances keep their bounds."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "accuracy": ("guaranteed_accuracy",),
    "deviation": ("standard_deviation",),
    "interval": ("state_interval",),
    "limit": ("accuracy_limit",),
    "recursion": ("PeriodicGains",),
    "sample_counts": ("accuracy_by_count",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
