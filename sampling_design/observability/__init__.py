"""What a plant and a set of sample times show of the state together."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "count.loss_tolerance": ("loss_tolerance",),
    "count.pbh": ("UnobservableModes", "require_observable", "unobservable_modes"),
    "count.zero_count": ("ZeroCountBound", "critical_length", "default_window", "zero_count_bound"),
    "count.functional": ("functional_plant",),
    "sigma_bracket": ("SigmaDeviations",),
    "windows.sampled": ("observability_gramian", "observability_matrix", "sigma_min"),
    "windows.pieces": ("WindowWitness",),
    "windows.window_record": ("WindowProfile", "WindowSigma"),
    "windows.window_sigma": ("window_sigma",),
    "worst_case.worst_case_sigma": ("WorstCaseProfile", "WorstCaseSigma", "worst_case_sigma"),
}
__getattr__, __dir__, __all__ = lazy(__name__, _NAMES, modules=("count", "windows", "worst_case"))
