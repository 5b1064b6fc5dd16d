"""Plants that are not exactly known: numbers in ranges, between vertices, or varying in time."""

from sampling_design.records.dispatch import register
from sampling_design.records.lazy import lazy

_NAMES = {
    "existence.largest_box": ("largest_box",),
    "inclusion.certify_inclusion": ("certify_inclusion", "longest_gap"),
    "inclusion.inclusion_certificate": ("InclusionCertificate",),
    "nominal_filter": ("NominalFilter",),
    "plants.plant_files": ("UncertainParameter",),
    "plants.time_varying": ("TimeVaryingPlant",),
    "plants.uncertain_plant": ("LinearInclusion", "UncertainPlant"),
}
__getattr__, __dir__, __all__ = lazy(
    __name__, _NAMES, modules=("accuracy", "box", "existence", "inclusion", "observability", "plants")
)

_BOX, _VARYING = f"{__name__}.plants.uncertain_plant.UncertainPlant", f"{__name__}.plants.time_varying.TimeVaryingPlant"
_REGISTERED = {
    ("zero_count_bound", _BOX): "observability.zero_count_over_box:zero_count_over_box",
    ("window_sigma", _BOX): "observability.window_sigma_over_box:window_sigma_over_box",
    ("window_sigma", _VARYING): "observability.bracket_varying:window_sigma_varying",
    ("worst_case_sigma", _BOX): "observability.worst_case_over_box:worst_case_over_box",
    ("certificate_exists", _BOX): "existence.existence_over_box:existence_over_box",
    ("guaranteed_accuracy", _BOX): "accuracy.accuracy_over_box:accuracy_over_box",
    ("guaranteed_accuracy", _VARYING): "accuracy.accuracy_varying:accuracy_along",
    ("certify", f"{__name__}.plants.uncertain_plant.LinearInclusion"): "inclusion.certify_inclusion:certify_plant",
    ("constants_from_proof", f"{__name__}.plants.uncertain_plant.LinearInclusion"): (
        "inclusion.proof_constants:constants_over_inclusion"
    ),
    ("read_certificate", "inclusion"): "inclusion.inclusion_certificate:read_inclusion",
    ("read_plant", "sampling-design/uncertain-plant/1"): "plants.uncertain_plant:UncertainPlant",
    ("verify_rigorously", "inclusion"): "inclusion.inclusion_balls:inclusion",
}
for (_verb, _kind), _does in _REGISTERED.items():
    register(_verb, _kind, f"{__name__}.{_does}")
