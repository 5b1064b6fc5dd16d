"""Sampling design: when to measure a plant that is measured rarely, and what that proves.

    plant -> modal split -> zero count -> schedule -> worst-case sigma -> certificate -> estimator -> validation report

Names and rooms load on first use, so that importing this package costs nothing but itself. What editors and
type checkers know of it stands beside it in `__init__.pyi`, which `python -m tests.house.front_door` writes.
"""

from sampling_design.records.lazy import lazy

__version__ = "0.1.0"

# What a user types: things to make, verbs, files. What a verb returns, and its parts, live in the verb's room.
_FRONT_DOOR = {
    "errors": ("SamplingDesignError", "ArgumentError"),
    "plants.plant": ("Plant",),
    "uncertain.plants.uncertain_plant": ("UncertainPlant",),
    "uncertain.plants.plant_files": ("UncertainParameter",),
    "plants.files": ("read_plant",),
    "plants.library": ("named_plant",),
    "observability.count.zero_count": ("zero_count_bound",),
    "observability.windows.window_sigma": ("window_sigma",),
    "observability.worst_case.worst_case_sigma": ("worst_case_sigma",),
    "accuracy.accuracy": ("guaranteed_accuracy",),
    "accuracy.interval": ("state_interval",),
    "certificates.exact.certificate": ("Certificate",),
    "certificates.certification": ("certify",),
    "certificates.files": ("read_certificate",),
    "certificates.compare.robustness": ("robustness",),
    "certificates.existence.periodic": ("certificate_exists",),
    "estimators.mhe": ("MovingHorizonEstimator",),
    "estimators.kalman": ("KalmanFilter", "SetMembershipEstimator"),
    "estimators.constraints.constraints": ("Constraints",),
    "estimators.gap_flows.cost_weights": ("CostFunction",),
    "estimators.records.measurements": ("Measurements", "read_measurements"),
    "nonlinear.model": ("NonlinearPlant",),
    "nonlinear.mhe": ("NonlinearMovingHorizonEstimator",),
    "validation.comparison": ("validate",),
    "validation.scenario": ("simulate_record",),
    "validation.schedule_log": ("compare_schedule",),
    "schedules.schedule": ("Schedule", "PeriodicSchedule"),
    "schedules.spaced_windows": ("SpacedWindows",),
    "schedules.gap_range": ("GapRange",),
    "schedules.jitter": ("Jitter",),
    "schedules.lost_samples": ("LostSamples",),
    "schedules.files": ("read_schedule",),
    "design.problem.requirement": ("Requirement", "read_requirement"),
    "planning.requirement": ("PlanRequirement",),
    "planning.plan": ("plan_samples",),
    "planning.files": ("read_plan",),
    "planning.upcoming_sample": ("next_sample",),
    "design.design": ("design_schedule",),
    "design.pareto": ("pareto_front",),
}
_ROOMS = (
    "accuracy",
    "certificates",
    "checkers",
    "cli",
    "design",
    "errors",
    "estimators",
    "explorer",
    "nonlinear",
    "numerics",
    "observability",
    "planning",
    "plants",
    "plotting",
    "records",
    "schedules",
    "uncertain",
    "validation",
)
__getattr__, __dir__, _ = lazy(__name__, _FRONT_DOOR, modules=_ROOMS)
__all__ = ["__version__", *sorted(name for names in _FRONT_DOOR.values() for name in names)]
