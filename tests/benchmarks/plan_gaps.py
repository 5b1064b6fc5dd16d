"""Most accurate plans of the library's plants, for the proven gaps of `plans`.

Each plant is asked for its slowest known state, in the disturbance and noise of its scales, with so many samples in a
period of its own time; the gap is what no other choice on the grid of 48 steps can gain, by proof.
"""

from __future__ import annotations

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
STEPS, NOISE, MOVED = 48, 0.05, 0.1


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
        grid=period / STEPS,
        samples=samples,
        w_bound=w.tolist(),
        sensors=sensors,
    )
