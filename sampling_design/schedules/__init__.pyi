# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.schedules.calendar import CalendarEntry as CalendarEntry
from sampling_design.schedules.calendar import write_calendar_csv as write_calendar_csv
from sampling_design.schedules.calendar import write_ics as write_ics
from sampling_design.schedules.family import SamplingFamily as SamplingFamily
from sampling_design.schedules.family_files import family_from_dict as family_from_dict
from sampling_design.schedules.files import read_schedule as read_schedule
from sampling_design.schedules.files import schedule_from_dict as schedule_from_dict
from sampling_design.schedules.files import write_schedule as write_schedule
from sampling_design.schedules.gap_range import GapRange as GapRange
from sampling_design.schedules.jitter import Jitter as Jitter
from sampling_design.schedules.lost_samples import LostSamples as LostSamples
from sampling_design.schedules.sampling_set import SamplingSet as SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule as PeriodicSchedule
from sampling_design.schedules.schedule import Schedule as Schedule
from sampling_design.schedules.spaced_windows import SpacedWindows as SpacedWindows
from sampling_design.schedules.time_stamps import import_time_stamps as import_time_stamps
