# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.accuracy.accuracy import guaranteed_accuracy as guaranteed_accuracy
from sampling_design.accuracy.deviation import standard_deviation as standard_deviation
from sampling_design.accuracy.interval import state_interval as state_interval
from sampling_design.accuracy.limit import accuracy_limit as accuracy_limit
from sampling_design.accuracy.recursion import PeriodicGains as PeriodicGains
from sampling_design.accuracy.sample_counts import accuracy_by_count as accuracy_by_count
