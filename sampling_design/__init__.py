"""Sampling design: when to measure a plant that is measured rarely, and what that proves.

    plant -> modal split -> zero count -> schedule -> worst-case sigma -> certificate -> estimator -> validation report

Names load on first use, so that importing this package costs nothing but itself.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_FRONT_DOOR = {
    "errors": ("SamplingDesignError", "ArgumentError"),
    "plants.plant": ("Plant", "Signals"),
    "plants.clusters": ("EigenvalueCluster", "eigenvalue_clusters"),
    "plants.modes": ("ModalSplit", "split_modes"),
    "plants.files": ("read_plant", "write_plant"),
    "plants.library": ("named_plant",),
    "plants": ("library",),
    "observability.count.zero_count": ("ZeroCountBound", "zero_count_bound"),
    "observability.count.critical_length": ("critical_length",),
    "observability.count.pbh": ("UnseenModes", "unseen_modes", "require_observable"),
    "observability.windows.sampled": ("observability_matrix", "sigma_min", "observability_gramian"),
    "observability.windows.window_sigma": ("window_sigma", "WindowSigma", "WindowWitness", "WindowProfile"),
    "observability.worst_case.worst_case_sigma": ("worst_case_sigma", "WorstCaseSigma", "WorstCaseProfile"),
    "certificates.exact.certificate": ("Certificate",),
    "certificates.form.verdict": ("Verification",),
    "certificates.certify": ("certify",),
    "certificates.files": ("load_certificate",),
    "certificates.families.certify_family": ("certify_family",),
    "certificates.families.family_certificate": ("FamilyCertificate",),
    "certificates.compare.robustness": ("survival", "Survival"),
    "certificates.existence.counterexample": ("Counterexample", "find_counterexample"),
    "certificates.existence.periodic": ("certificate_exists", "smallest_repair"),
    "certificates.compare.four_horizons": ("four_horizons", "FourHorizons"),
    "certificates.exact.bound_weights": ("weights_from_bounds",),
    "certificates.exact.information": ("information_curve", "InformationCurve"),
    "certificates.form.horizon": ("Horizon",),
    "certificates.compare.tradeoff": ("tradeoff_curve", "TradeoffCurve"),
    "certificates.compare.contraction": ("spectral_radius", "least_contracting"),
    "estimators.mhe": ("MovingHorizonEstimator",),
    "estimators.kalman": ("KalmanFilter",),
    "estimators.constraints.convex_set": ("ConvexSet",),
    "estimators.baselines": ("standard_mhe", "periodic_at_equal_cost"),
    "estimators.measurements": ("Measurements", "read_measurements", "write_measurements", "write_estimates"),
    "nonlinear": ("thyroid",),
    "nonlinear.model": ("NonlinearPlant",),
    "nonlinear.conversion": ("from_expressions", "from_linear"),
    "nonlinear.mhe": ("NonlinearMovingHorizonEstimator",),
    "nonlinear.detectability": ("check_detectability", "DetectabilityEvidence"),
    "nonlinear.experiment": ("thyroid_experiment",),
    "nonlinear.report": ("ThyroidReport",),
    "estimators.online.estimator": ("Estimate", "EstimateRecord", "Estimator", "Sample", "GuaranteeWarning"),
    "validation.validate": ("validate",),
    "validation.report": ("ValidationReport", "Finding"),
    "validation.scenario": ("simulate_record", "SimulatedRecord"),
    "validation.schedule_log": ("compare_schedule", "ScheduleLog"),
    "design.problem.posing": ("default_window",),
    "schedules.schedule": ("Schedule", "PeriodicSchedule"),
    "schedules.sampling_set": ("SamplingSet",),
    "schedules.spaced_windows": ("SpacedWindows",),
    "schedules.gap_range": ("GapRange",),
    "schedules.family": ("SamplingFamily",),
    "schedules.jitter": ("Jitter",),
    "schedules.lost_samples": ("LostSamples",),
    "schedules.files": ("read_schedule", "write_schedule", "schedule_to_dict", "schedule_from_dict"),
    "schedules.family_files": ("family_to_dict", "family_from_dict"),
    "schedules.time_stamps": ("import_time_stamps",),
    "schedules.calendar": ("CalendarEntry", "calendar", "write_calendar_csv", "write_ics"),
    "certificates.form.constants": ("Constant", "ConstantList"),
    "certificates.detectability.dissipation": ("DetectabilityCertificate",),
    "certificates.detectability.best_rate": ("certify_detectability", "detectability_from_proof"),
    "certificates.paper.restarts": ("restart_times", "output_predictor"),
    "certificates.paper.proof_constants": ("ProofConstants", "constants_from_proof", "certify_from_proof"),
    "design.problem.requirement": ("Requirement", "OutputAccess"),
    "design.problem.requirement_file": ("read_requirement", "write_requirement", "requirement_from_dict"),
    "design.design": ("design_schedule",),
    "design.schedule_design": ("ScheduleDesign",),
    "design.bounds.evidence": ("UpperBound", "BoundPart"),
    "design.losses": ("SampleLosses", "sample_losses"),
    "design.pareto": ("ParetoFront", "ParetoPoint", "pareto"),
}
_HOME = {name: room for room, names in _FRONT_DOOR.items() for name in names}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sampling_design' has no attribute {name!r}")
    value = getattr(import_module(f"sampling_design.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
