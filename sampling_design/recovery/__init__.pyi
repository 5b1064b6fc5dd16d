# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.recovery.deviation import standard_deviation as standard_deviation
from sampling_design.recovery.record_bounds import bounds_from_record as bounds_from_record
from sampling_design.recovery.recursion import PeriodicGains as PeriodicGains
