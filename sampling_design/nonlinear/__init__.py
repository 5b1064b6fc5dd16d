"""Nonlinear plants and their moving horizon estimation, on CasADi (extra `nonlinear`)."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "collocation": ("Collocation",),
    "detectability": ("DetectabilityEvidence", "check_detectability"),
    "experiment": ("thyroid_experiment",),
    "mhe": ("NonlinearMovingHorizonEstimator",),
    "model": ("NonlinearPlant", "from_linear"),
    "report": ("ThyroidReport",),
    "simulation": ("plant_along",),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES, modules=("examples", "thyroid", "thyroid_logs"))
