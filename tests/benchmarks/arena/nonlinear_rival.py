"""do-mpc's moving horizon estimator over irregular samples of a nonlinear plant, as its own manual lets it have them.

It takes one measurement at each of its regular steps. So its step is that of the grid on which w is constant, and two
time-varying parameters of its model say what happens in a step: `seen`, which the weight of the measurement is
multiplied with, and `begun`, which lets the state stand still before the first step, as its window is always full. The
disturbance is an input that is measured as 0. Arrival weight and its centre are do-mpc's own: constant, and the
estimate of the window before.
"""

from __future__ import annotations

import time
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .nonlinear import Case


class DoMpc:
    """One run: `step` after each step of the grid, with a measurement or without."""

    def __init__(self, case: Case, step: float, window: int, seen: np.ndarray, prior: np.ndarray) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import do_mpc

            plant, model = case.plant, do_mpc.model.Model("continuous", "SX")
            x = model.set_variable("_x", "x", (plant.n_states, 1))
            w = model.set_variable("_u", "w", (plant.n_disturbances, 1))
            shown = model.set_variable("_tvp", "seen")
            begun = model.set_variable("_tvp", "begun")
            model.set_meas("y", plant.h_casadi(x, case.u, np.zeros(plant.n_noises)), meas_noise=True)
            model.set_meas("w", w, meas_noise=True)
            model.set_rhs("x", begun * plant.f_casadi(x, case.u, w))
            model.setup()
            mhe = do_mpc.estimator.MHE(model, [])
            mhe.settings.n_horizon, mhe.settings.t_step, mhe.settings.meas_from_data = window, step, True
            mhe.settings.collocation_deg = 3
            mhe.settings.supress_ipopt_output()
            mhe.scaling["_x", "x"] = plant.states.scales
            trust = [shown / s**2 for s in case.noise] + [1 / s**2 for s in case.disturbance]
            weight: Any = type(shown).zeros(len(trust), len(trust))
            for k, each in enumerate(trust):
                weight[k, k] = each
            mhe.set_default_objective(P_x=np.diag(1 / np.square(case.error)), P_v=weight)
            low, high = plant.bounds["states"]
            mhe.bounds["lower", "_x", "x"], mhe.bounds["upper", "_x", "x"] = low, high
            table, steps = mhe.get_tvp_template(), np.arange(window + 1) - window + 1

            def at(t: float) -> Any:
                for k, place in enumerate((steps + round(float(np.ravel(t)[0]) / step)).tolist()):
                    table["_tvp", k, "seen"] = float(0 <= place < len(seen) and seen[place])
                    table["_tvp", k, "begun"] = float(place >= 0)
                return table

            mhe.set_tvp_fun(at)
            mhe.setup()
            mhe.x0 = prior
            mhe.set_initial_guess()
        self.mhe, self.quiet = mhe, np.zeros(plant.n_disturbances)

    def step(self, y: np.ndarray) -> np.ndarray:
        """The estimate at the end of one more step."""
        return np.array(self.mhe.make_step(np.concatenate([y, self.quiet])[:, None])).ravel()


def stepped(case: Case, data: tuple[np.ndarray, ...], step: float, window: int) -> tuple[np.ndarray, float]:
    """Estimates at the samples, and the processor time from one to the next."""
    counts, _, shown, prior = data
    ends = np.cumsum(counts)
    seen = np.isin(np.arange(1, ends[-1] + 1), ends)
    rival = DoMpc(case, step, window, seen, prior)
    found, before, y = [], time.process_time(), iter(shown)
    for measured in seen:
        x = rival.step(next(y) if measured else np.zeros(shown.shape[1]))
        if measured:
            found.append(x)
    return np.array(found), (time.process_time() - before) / len(shown)
