"""Estimators: the state, and a radius that holds it, from rare and irregular measurements."""

from sampling_design.records.lazy import lazy

_NAMES = {
    "constraints.constraints": ("Constraints",),
    "constraints.convex_set": ("ConvexSet",),
    "estimate_file": ("write_estimates",),
    "estimator_choice": ("RecordEstimator", "estimate", "estimator_for"),
    "gap_flows.cost_weights": ("CostFunction",),
    "kalman": ("KalmanFilter", "SetMembershipEstimator"),
    "mhe": ("MovingHorizonEstimator",),
    "online.curve": ("estimate_curve",),
    "online.estimate": ("Estimate",),
    "online.estimator": ("EstimateRecord", "Estimator", "GuaranteeWarning", "Sample"),
    "records.measurements": ("Measurements", "read_measurements", "write_measurements"),
}
__getattr__, __dir__, __all__ = lazy(
    __name__, _NAMES, modules=("constraints", "gap_flows", "online", "records", "window")
)
