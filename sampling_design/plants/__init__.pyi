# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.plants import library as library
from sampling_design.plants.clusters import EigenvalueCluster as EigenvalueCluster
from sampling_design.plants.clusters import eigenvalue_clusters as eigenvalue_clusters
from sampling_design.plants.files import read_plant as read_plant
from sampling_design.plants.files import write_plant as write_plant
from sampling_design.plants.functional import FunctionalPlant as FunctionalPlant
from sampling_design.plants.library import named_plant as named_plant
from sampling_design.plants.library import plant_of_modes as plant_of_modes
from sampling_design.plants.modes import ModalSplit as ModalSplit
from sampling_design.plants.modes import split_modes as split_modes
from sampling_design.plants.plant import Plant as Plant
from sampling_design.plants.plant import Signals as Signals
from sampling_design.plants.sparse import SparsePlant as SparsePlant
from sampling_design.plants.sparse import split_sparse as split_sparse
