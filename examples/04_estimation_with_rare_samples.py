"""A state between rare samples: ellipsoids that hold the truth, a constraint that helps, an open loop in between.

An oscillator has an unknown bounded disturbance, and its position is measured at a few times with a coarse sensor.

Run: `python examples/04_estimation_with_rare_samples.py`
"""

import numpy as np

import sampling_design as sd

BOX = 1.2  # position and velocity stay within
GAPS = [0.7, 1.6, 0.9, 2.0]
W_BOUND, V_BOUND, START_ERROR = 0.02, 0.5, 1.5


def record(plant: sd.Plant, times: np.ndarray, start: np.ndarray, rng: np.random.Generator) -> tuple:
    """Return the states and the measurements at `times` under a bounded disturbance that is constant in each gap."""
    states, y, x, before = [], [], np.array(start), 0.0
    for t in times:
        w = rng.uniform(-1.0, 1.0, plant.n_disturbances)
        w *= W_BOUND / max(1.0, float(np.linalg.norm(w)))
        x = advance(plant, x, w, t - before)
        states.append(x)
        y.append(plant.C @ x + rng.uniform(-V_BOUND, V_BOUND, plant.n_outputs))
        before = t
    return np.array(states), np.array(y)


def advance(plant: sd.Plant, x: np.ndarray, w: np.ndarray, gap: float) -> np.ndarray:
    """Return the state after `gap` with the constant disturbance w, by the plant with w as further states."""
    n, q = plant.n_states, plant.n_disturbances
    grown = sd.Plant(np.block([[plant.A, plant.G], [np.zeros((q, n + q))]]), np.ones((1, n + q)))
    return (grown.transition(gap) @ np.concatenate([x, w]))[:n]


def main() -> None:
    """Estimate an oscillator over forty seconds, then the same data under a constraint on the state."""
    plant = sd.named_plant("oscillator")
    certificate = sd.certify(plant, sd.PeriodicSchedule(GAPS))
    bounds = {"w_bound": W_BOUND, "v_bound": V_BOUND, "initial_error": START_ERROR}
    times = sd.PeriodicSchedule(GAPS).between(0.0, 40.0).times
    truth, y = record(plant, times, np.array([1.0, 0.5]), np.random.default_rng(0))

    free = sd.MovingHorizonEstimator(plant, certificate, **bounds)
    boxed = sd.MovingHorizonEstimator(
        plant, certificate, constraints=sd.Constraints(x=([-BOX] * 2, [BOX] * 2)), **bounds
    )
    ratios, engines, errors = [], [], {"free": [], "boxed": []}
    for t, x, measured in zip(times, truth, y, strict=True):
        for name, estimator in (("free", free), ("boxed", boxed)):
            estimate = estimator.update(t, measured)
            assert estimate.certified
            assert estimate.holds(x)
            errors[name].append(np.linalg.norm(estimate.x - x))
            ratios.append(estimate.ratio(x))
            engines.append(estimate.engine)
    late = free.predict(times[-1] + 3.0)
    print(f"{len(times)} samples: the truth stays inside, at most at {max(ratios):.2f} of the ellipsoid's level.")
    mean = {name: float(np.mean(values)) for name, values in errors.items()}
    print(f"Average error {mean['free']:.3f}, with the constraint {mean['boxed']:.3f}.")
    print(f"The constraint was active {engines.count('active set')} times; otherwise the closed form is the answer.")
    print(f"Three seconds after the last sample the radii are {np.round(late.radii, 2)}.")

    assert max(ratios) <= 1.0
    assert np.all(np.abs(truth) < BOX), "the constraint must be true for the claim"
    assert mean["boxed"] < 0.9 * mean["free"]
    assert engines.count("active set") > 0
    assert np.all(late.radii > 0)


if __name__ == "__main__":
    main()
