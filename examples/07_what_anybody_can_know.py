"""What anybody can know: the least guaranteed error, from two sides, and why a larger sigma may be a worse schedule.

Run: `python examples/07_what_anybody_can_know.py`
"""

import numpy as np

import sampling_design as sd

PERIOD = 6.0
BOUNDS = {"w_bound": 0.02, "v_bound": 0.1}
EVEN = sd.PeriodicSchedule.from_times([0.5, 2.0, 3.5, 5.0], PERIOD, time_unit="s")
BUNCHES = sd.PeriodicSchedule.from_times([1.0, 1.05, 1.1, 2.5, 2.55, 2.6], PERIOD, time_unit="s")


def main() -> None:
    """Compare two schedules of a swing by sigma and by what can be guaranteed."""
    swing = sd.named_plant("oscillator")
    found = {name: sd.guaranteed_accuracy(swing, s, **BOUNDS) for name, s in (("even", EVEN), ("bunches", BUNCHES))}
    sigma = {name: sd.window_sigma(swing, one.schedule, PERIOD).lower for name, one in found.items()}
    for name, one in found.items():
        print(f"{name}: sigma {sigma[name]:.3f}, position within {one.upper[0]:.3f}, velocity {one.upper[1]:.3f}")
    hidden = found["even"].witnesses[0]
    run = hidden.simulate()
    print(f"Two trajectories that every reading may show as zero end {2 * hidden.value:.3f} apart.")
    floor = sd.accuracy.accuracy_limit(swing, **BOUNDS).lower
    print(f"Who reads at every moment is uncertain by {floor[0]:.3f} and {floor[1]:.3f}.")
    level = sd.state_interval(
        sd.Plant([[0.0]], [[1.0]]), [(0.0, [1.0], None), (1.0, [1.5], None)], w_bound=0.1, v_bound=0.3
    )
    print(f"A level read as 1.0 and 1.5 lies between {level.lower[0]:.3f} and {level.upper[0]:.3f}.")

    assert sigma["bunches"] > 1.1 * sigma["even"]
    assert np.all(found["bunches"].lower > 1.25 * found["even"].upper)
    assert np.nanmax(np.abs(run.v)) <= BOUNDS["v_bound"] * (1 + 1e-9)
    assert np.max(np.linalg.norm(run.w, axis=1)) <= BOUNDS["w_bound"] * (1 + 1e-9)
    assert np.isclose(run.x[0], hidden.value)
    assert np.all(floor < found["even"].lower)
    assert np.allclose([level.lower[0], level.upper[0]], [1.2, 1.4])
    assert all(one.verify() for one in found.values())


if __name__ == "__main__":
    main()
