"""What a schedule proves: certificates of detectability from samples, exact and from the paper."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "certification": ("certify",),
    "compare.contraction": ("error_map", "least_contracting", "spectral_radius"),
    "compare.four_horizons": ("FourHorizons", "four_horizons"),
    "compare.random_arrivals": ("RandomArrivals", "random_arrivals"),
    "compare.robustness": ("Robustness", "robustness"),
    "compare.tradeoff": ("TradeoffCurve", "tradeoff_curve"),
    "detectability.best_rate": ("certify_detectability", "detectability_from_proof"),
    "detectability.dissipation": ("DetectabilityCertificate",),
    "exact.bound_weights": ("weights_from_bounds",),
    "exact.certificate": ("Certificate",),
    "exact.information": ("InformationCurve", "information_curve"),
    "existence.counterexample": ("Counterexample", "find_counterexample"),
    "existence.periodic": ("certificate_exists", "smallest_repair"),
    "families.family_certificate": ("FamilyCertificate",),
    "files": ("read_certificate",),
    "form.horizon": ("Constant", "ConstantList", "Horizon"),
    "form.verdict": ("Verification",),
    "paper.proof_constants": ("ProofConstants", "certify_from_proof", "constants_from_proof"),
    "paper.restarts": ("output_predictor", "restart_times"),
}
__getattr__, __dir__, __all__ = lazy(
    __name__,
    _NAMES,
    modules=("compare", "detectability", "exact", "existence", "families", "form", "paper", "rigorous"),
)
