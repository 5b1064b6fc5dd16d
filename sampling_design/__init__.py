"""Sampling design: when to measure a plant that is measured rarely, and what that proves.

    plant -> modal split -> zero count -> schedule -> worst-case sigma -> certificate -> estimator -> validation report

Names and rooms load on first use, so that importing this package costs nothing but itself. What editors and
type checkers know of it stands beside it in `__init__.pyi`, which `python -m tests.house.front_door` writes.
"""

import sys
from importlib import import_module

__version__ = "0.1.0"

# What a user types: things to make, verbs, files. What a verb returns, and its parts, live in the verb's room.
_FRONT_DOOR = {
    "errors": ("SamplingDesignError", "ArgumentError"),
    "plants.plant": ("Plant", "Signals"),
    "plants.modes": ("split_modes",),
    "plants.sparse": ("SparsePlant", "split_sparse"),
    "plants.uncertain": ("UncertainPlant",),
    "plants.uncertain_parameter": ("UncertainParameter",),
    "plants.files": ("read_plant", "write_plant"),
    "plants.library": ("named_plant",),
    "plants": ("library",),
    "observability.count.zero_count": ("zero_count_bound",),
    "observability.count.critical_length": ("critical_length",),
    "observability.count.loss_tolerance": ("loss_tolerance",),
    "observability.count.pbh": ("unseen_modes",),
    "observability.windows.sampled": ("observability_matrix", "sigma_min", "observability_gramian"),
    "observability.windows.window_sigma": ("window_sigma",),
    "observability.worst_case.worst_case_sigma": ("worst_case_sigma",),
    "recovery.accuracy": ("accuracy",),
    "recovery.deviation": ("standard_deviation",),
    "recovery.limit": ("limit",),
    "recovery.recursion": ("PeriodicGains",),
    "recovery.interval": ("interval",),
    "recovery.record_bounds": ("bounds_from_record",),
    "certificates.exact.certificate": ("Certificate",),
    "certificates.certify": ("certify",),
    "certificates.files": ("load_certificate",),
    "certificates.families.certify_family": ("certify_family",),
    "certificates.families.family_certificate": ("FamilyCertificate",),
    "certificates.compare.robustness": ("robustness",),
    "certificates.existence.counterexample": ("find_counterexample",),
    "certificates.existence.largest_box": ("largest_box",),
    "certificates.existence.periodic": ("certificate_exists", "smallest_repair"),
    "certificates.compare.four_horizons": ("four_horizons",),
    "certificates.exact.bound_weights": ("weights_from_bounds",),
    "certificates.exact.information": ("information_curve",),
    "certificates.compare.tradeoff": ("tradeoff_curve",),
    "estimators.mhe": ("MovingHorizonEstimator",),
    "estimators.kalman": ("KalmanFilter",),
    "estimators.set_membership": ("SetMembershipEstimator",),
    "estimators.constraints.constraints": ("Constraints",),
    "estimators.gap_flows.cost_function": ("CostFunction",),
    "estimators.constraints.convex_set": ("ConvexSet",),
    "estimators.records.measurements": ("Measurements", "read_measurements", "write_measurements"),
    "estimators.estimate_file": ("write_estimates",),
    "nonlinear": ("thyroid",),
    "nonlinear.model": ("NonlinearPlant",),
    "nonlinear.conversion": ("from_expressions", "from_linear"),
    "nonlinear.collocation": ("Collocation",),
    "nonlinear.mhe": ("NonlinearMovingHorizonEstimator",),
    "nonlinear.detectability": ("check_detectability",),
    "nonlinear.experiment": ("thyroid_experiment",),
    "estimators.online.estimate": ("Estimate",),
    "estimators.online.estimator": ("EstimateRecord", "Sample", "GuaranteeWarning"),
    "validation.validate": ("validate",),
    "validation.scenario": ("simulate_record",),
    "validation.schedule_log": ("compare_schedule",),
    "schedules.schedule": ("Schedule", "PeriodicSchedule"),
    "schedules.sampling_set": ("SamplingSet",),
    "schedules.spaced_windows": ("SpacedWindows",),
    "schedules.gap_range": ("GapRange",),
    "schedules.jitter": ("Jitter",),
    "schedules.lost_samples": ("LostSamples",),
    "schedules.files": ("read_schedule", "write_schedule"),
    "schedules.time_stamps": ("import_time_stamps",),
    "schedules.calendar": ("write_ics",),
    "certificates.detectability.dissipation": ("DetectabilityCertificate",),
    "certificates.detectability.best_rate": ("certify_detectability", "detectability_from_proof"),
    "certificates.paper.proof_constants": ("constants_from_proof", "certify_from_proof"),
    "design.problem.requirement": ("Requirement", "OutputAccess"),
    "design.problem.requirement_file": ("read_requirement", "write_requirement"),
    "planning.requirement": ("PlanRequirement",),
    "planning.requirement_file": ("read_plan_requirement",),
    "planning.plan": ("plan",),
    "planning.files": ("load_plan",),
    "planning.next_sample": ("next_sample",),
    "design.design": ("design_schedule",),
    "design.losses": ("sample_losses",),
    "design.pareto": ("pareto",),
}
_ROOMS = (
    "certificates",
    "checkers",
    "cli",
    "design",
    "errors",
    "estimators",
    "evidence",
    "explorer",
    "nonlinear",
    "observability",
    "planning",
    "plants",
    "plotting",
    "recovery",
    "schedules",
    "sweeps",
    "validation",
)
_HOME = {name: room for room, names in _FRONT_DOOR.items() for name in names}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> object:
    if name in _HOME:
        value = getattr(import_module(f"sampling_design.{_HOME[name]}"), name)
    elif name in _ROOMS:
        value = import_module(f"sampling_design.{name}")
    else:
        raise _absent(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS])


def _absent(name: str) -> AttributeError | ImportError:
    """Return the error for a name that is not here, with the one that was probably meant."""
    message = f"module 'sampling_design' has no attribute {name!r}"
    if name.startswith("_"):
        return AttributeError(message)
    from difflib import get_close_matches

    close = get_close_matches(name, __dir__(), n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    # `from sampling_design import NAME` swallows an AttributeError with its words, and says only "cannot import name"
    importing = bool(hint) and sys._getframe(2).f_code.co_name == "_handle_fromlist"
    return (ImportError if importing else AttributeError)(message + hint)
