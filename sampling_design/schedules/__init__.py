"""Schedules: when something is measured, independent of what."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "calendar": ("CalendarEntry", "write_calendar_csv", "write_ics"),
    "family": ("SamplingFamily",),
    "files": ("family_from_dict", "read_schedule", "schedule_from_dict", "write_schedule"),
    "gap_range": ("GapRange",),
    "jitter": ("Jitter",),
    "lost_samples": ("LostSamples",),
    "output_jitter": ("OutputJitter",),
    "sampling_set": ("SamplingSet",),
    "opening": ("OpeningCalendar",),
    "sensor": ("Sensor",),
    "schedule": ("PeriodicSchedule", "Schedule"),
    "spaced_windows": ("SpacedWindows",),
    "time_stamps": ("import_time_stamps",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES)
