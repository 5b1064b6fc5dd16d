# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.validation.comparison import validate as validate
from sampling_design.validation.report import ClaimCheck as ClaimCheck
from sampling_design.validation.report import ValidationReport as ValidationReport
from sampling_design.validation.scenario import SimulatedRecord as SimulatedRecord
from sampling_design.validation.scenario import simulate_record as simulate_record
from sampling_design.validation.schedule_log import ScheduleLog as ScheduleLog
from sampling_design.validation.schedule_log import compare_schedule as compare_schedule
