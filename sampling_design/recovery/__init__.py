"""What anybody can recover of the state from a schedule when noise and disturbances keep their bounds."""

from sampling_design._lazy import lazy

_NAMES = {
    "deviation": ("standard_deviation",),
    "record_bounds": ("bounds_from_record",),
    "recursion": ("PeriodicGains",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
