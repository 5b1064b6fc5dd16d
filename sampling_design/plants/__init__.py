"""Plants: what is measured, independent of when."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "clusters": ("EigenvalueCluster", "eigenvalue_clusters"),
    "files": ("read_plant", "write_plant"),
    "functional": ("FunctionalPlant",),
    "library": ("named_plant", "plant_of_modes"),
    "modes": ("ModalSplit", "split_modes"),
    "plant": ("Plant", "Signals"),
    "sparse": ("SparsePlant", "split_sparse"),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES, modules=("library",))
