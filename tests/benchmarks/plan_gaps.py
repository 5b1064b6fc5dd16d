"""How far from the best a plan can be: proven gaps of the most accurate plans of the library's plants.

    python -m tests.benchmarks.plan_gaps [SAMPLES ... or PLANT ...]

Each plant is asked for its slowest known state, in the disturbance and noise of its scales, with so many samples in a
period of its own time; the gap is what no other choice on the raster of 48 steps can gain, by proof.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import sampling_design as sd

PLANTS = Path(__file__).parents[2] / "examples" / "plants"
CASES = {  # file, period, share of the state's scale that w moves in a period, noise as a share of the output's scale
    "oscillator": 6.4,
    "double_integrator": 5.0,
    "triple_integrator": 6.0,
    "three_compartment": 24.0,
    "cart_pendulum": 1.0,
    "satellite": 5400.0,
}
STEPS, WORK, NOISE, MOVED = 48, 60.0, 0.05, 0.1


def scales(signals, count):
    """Scales of signals, 1 where there are none."""
    return np.ones(count) if signals.scales is None else np.asarray(signals.scales, float)


def posed(name, samples):
    """The most accurate plan of so many samples for one plant."""
    plant, period = sd.read_plant(PLANTS / f"{name}.toml"), CASES[name]
    states = scales(plant.states, plant.n_states)
    sensors = {
        output: {"noise_bound": NOISE * float(scale)}
        for output, scale in zip(plant.outputs.names, scales(plant.outputs, plant.n_outputs), strict=True)
    }
    pushed = np.abs(plant.G) / states[:, None]
    w = MOVED / period / np.maximum(pushed.max(axis=0), 1e-300)
    goal = plant.states.names[0]
    return plant, sd.PlanRequirement(
        {goal: float(states[0])},
        period=period,
        raster=period / STEPS,
        samples=samples,
        w_bound=w.tolist(),
        sensors=sensors,
    )


def main(counts, names):
    """Print a table: plant, samples, what is reached and out of reach, the gap, CPU seconds."""
    print("| plant | samples | of the scale | none below | gap | CPU [s] |\n|---|---|---|---|---|---|")
    for name in names:
        for samples in counts:
            began = time.process_time()
            try:
                found = sd.plan_samples(*posed(name, samples), search_seconds=WORK, certificate=False, robustness=False)
            except sd.SamplingDesignError as error:
                print(f"| {name} | {samples} | {type(error).__name__}: {error!s:.80} | | | |", flush=True)
                continue
            assert found.verify()
            level = 0.0 if found.bound.ratio is None else found.bound.ratio.level
            spent = time.process_time() - began
            print(
                f"| {name} | {samples} | {found.ratio:.4g} | {level:.4g} | {100 * found.gap:.1f} % | {spent:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    told = sys.argv[1:]
    main(
        [int(c) for c in told if c.isdigit()] or list(range(2, 9)), [n for n in told if not n.isdigit()] or list(CASES)
    )
