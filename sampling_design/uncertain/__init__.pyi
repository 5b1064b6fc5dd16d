# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.uncertain import accuracy as accuracy
from sampling_design.uncertain import box as box
from sampling_design.uncertain import existence as existence
from sampling_design.uncertain import inclusion as inclusion
from sampling_design.uncertain import observability as observability
from sampling_design.uncertain import plants as plants
from sampling_design.uncertain.existence.largest_box import largest_box as largest_box
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion as certify_inclusion
from sampling_design.uncertain.inclusion.certify_inclusion import longest_gap as longest_gap
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate as InclusionCertificate
from sampling_design.uncertain.nominal_filter import NominalFilter as NominalFilter
from sampling_design.uncertain.plants.plant_files import UncertainParameter as UncertainParameter
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant as TimeVaryingPlant
from sampling_design.uncertain.plants.uncertain_plant import LinearInclusion as LinearInclusion
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant as UncertainPlant
