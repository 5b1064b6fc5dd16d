"""The Earth's pole as a plant: its record since 1962, bounds found before 2000, and what readings prove after that.

    x' = A x + w,   y = C x + v,   |w_i| <= scale * shape_i,   |v_i| <= 10 mas + 2 * (error that the record states)

Eight states: a mean that drifts, the Chandler wobble (prograde, 433 d), and the annual motion, prograde and retrograde,
two states each and none of them damped. The output is the pole's two coordinates, in milliarcseconds (1 mas = 31 mm on
the ground).

*Chosen with hindsight*, from what is known of the Earth today: the three motions and the period of 433 d, the 10 mas
for everything faster than a season, and the shape of the disturbance. *Chosen before looking at what is judged*: the
scale, by a rule that sees the years up to 1999 only: the least scale that no three years of readings, ten days apart,
disprove, and 15 % more.

Record: IERS Earth Orientation Product Center, EOP 20 C04, from the package astropy-iers-data.
"""

from dataclasses import dataclass

import numpy as np

import sampling_design as sd

CHANDLER, YEAR = 433.0, 365.25
SHAPE = np.repeat([0.1, 1.0, 0.05], [2, 2, 4])  # mas/d: mean, Chandler, annual
FASTER = 10.0  # mas: weather and ocean, faster than a season
RESERVE = 1.15
JUDGED_FROM = 51544  # 2000-01-01 as a modified Julian date


@dataclass(frozen=True)
class Pole:
    """The record: modified Julian dates, one a day, the pole's coordinates and their stated errors, both in mas."""

    days: np.ndarray
    xy: np.ndarray
    error: np.ndarray

    def at(self, days):
        """Rows of given days."""
        return np.asarray(days, dtype=int) - int(self.days[0])

    def readings(self, days, faster: float = FASTER):
        """What somebody who reads on these days knows: (time, y) rows, and the bounds on their noise."""
        rows = self.at(days)
        shown = [(float(d - JUDGED_FROM), y, None) for d, y in zip(days, self.xy[rows], strict=True)]
        return shown, faster + 2.0 * self.error[rows]


def read_pole() -> Pole:
    """Read the record that astropy-iers-data carries."""
    import astropy_iers_data

    table = np.loadtxt(astropy_iers_data.IERS_B_FILE, usecols=(4, 5, 6, 13, 14))
    return Pole(table[:, 0].astype(int), 1e3 * table[:, 1:3], 1e3 * table[:, 3:])


def plant() -> sd.Plant:
    """Mean, Chandler wobble, annual motion forwards and backwards; seen from above x + iy turns clockwise."""
    A = np.zeros((8, 8))
    for k, rate in ((2, 2 * np.pi / CHANDLER), (4, 2 * np.pi / YEAR), (6, -2 * np.pi / YEAR)):
        A[k : k + 2, k : k + 2] = [[0.0, rate], [-rate, 0.0]]
    names = [f"{motion} {axis}" for motion in ("mean", "Chandler", "annual", "retrograde") for axis in "xy"]
    units = ["mas"] * 8
    C = np.hstack([np.eye(2)] * 4)
    outputs = sd.plants.Signals(["x", "y"], ["mas"] * 2)
    return sd.Plant(
        A, C, time_unit="d", states=sd.plants.Signals(names, units), outputs=outputs, name="pole of the Earth"
    )


def proven(pole: Pole, days, scale: float, t: int, faster: float = FASTER):
    """What readings on `days` prove of the pole on day `t`."""
    shown, noise = pole.readings(days, faster)
    where = plant()
    return sd.state_interval(where, shown, float(t - JUDGED_FROM), w_bound=scale * SHAPE, v_bound=noise, of=where.C)


def least_scale(pole: Pole, until: int = JUDGED_FROM, years: float = 3.0, every: int = 10, step: float = 0.5) -> float:
    """The least scale, to 0.005, that no stretch of so many years before `until` disproves."""
    count, scale = round(years * YEAR / every), 0.0
    for last in np.arange(pole.days[0] + count * every, until, round(step * YEAR)):
        days = last - every * np.arange(count)[::-1]
        if scale and not proven(pole, days, scale, last).contradiction:
            continue
        low, high = scale, 1.0
        while high - low > 0.005:
            middle = (low + high) / 2
            low, high = (middle, high) if proven(pole, days, middle, last).contradiction else (low, middle)
        scale = high
    return scale


@dataclass(frozen=True)
class Schedule:
    """When the pole is read: every so many days, or on fixed dates; how many readings are kept; what to call it."""

    name: str
    gap: float
    kept: int

    def days(self, until: int) -> np.ndarray:
        """Whole days of reading, as many before 2000 as are kept."""
        first = JUDGED_FROM - self.gap * self.kept
        return np.floor(np.arange(first, until, self.gap)).astype(int)


SCHEDULES = (
    Schedule("every 30 d", 30, 60),
    Schedule("every 91 d", 91, 40),
    Schedule("every 300 d", 300, 36),
    Schedule("every 198 d", 198, 50),
    Schedule("two fixed dates a year", YEAR / 2, 50),
    Schedule("one fixed date a year", YEAR, 36),
)


def disproved(pole: Pole, schedule: Schedule, scale: float, faster: float, every: int = 1) -> tuple[int, int]:
    """How many stretches of kept readings after 2000 disprove these bounds, and of how many; each ends at a reading."""
    days = schedule.days(int(pole.days[-1]))
    ends = [k for k in range(len(days)) if days[k] >= JUDGED_FROM][::every]
    stretches = [days[max(0, k + 1 - schedule.kept) : k + 1] for k in ends]
    return sum(proven(pole, s, scale, int(s[-1]), faster).contradiction > 0 for s in stretches), len(stretches)


def ellipsoids(pole: Pole, schedule: Schedule, scale: float, eta: float) -> float:
    """Mean half-width, over both coordinates, of the moving horizon estimator's ellipsoid between readings after 2000.

    Its prior knows each state to 500 mas, before the readings that are kept.
    """
    where, days = plant(), schedule.days(int(pole.days[-1]) - round(schedule.gap))
    shown, noise = pole.readings(days)
    certificate = sd.certify(where, sd.PeriodicSchedule([schedule.gap], schedule.gap), eta=eta)
    bounds = {"w_bound": scale * SHAPE, "v_bound": noise.max(axis=0), "initial_error": np.full(8, 500.0)}
    mhe = sd.MovingHorizonEstimator(where, certificate, prior_time=shown[0][0] - 1, **bounds)
    widths = []
    for t, y, _ in shown:
        mhe.update(t, y)
        if t >= 0:
            then = mhe.predict(t + schedule.gap / 2)
            variance = np.einsum("ij,jk,ik->i", where.C, then.covariance, where.C)
            widths.append(np.sqrt(then.radius * variance))
    return float(np.mean(widths))


TIGHTER = ((10.0, 0.10), (8.0, 0.14), (8.0, 0.10), (10.0, 0.05))
"""Bounds below those that are used: noise faster than a season, scale of the disturbance."""


@dataclass(frozen=True)
class Coverage:
    """How the withheld days came out."""

    schedule: Schedule
    days: int
    inside: float
    radius: float
    widest: float
    rms: float
    worst: float


def coverage(pole: Pole, schedule: Schedule, scale: float, count: int, seed: int = 0) -> Coverage:
    """Judge one withheld day in each of `count` gaps from 2000 on (all gaps, if there are fewer)."""
    rng = np.random.default_rng(seed)
    days = schedule.days(int(pole.days[-1]))
    gaps = [k for k in range(len(days) - 1) if days[k] >= JUDGED_FROM]
    chosen = sorted(rng.choice(gaps, min(count, len(gaps)), replace=False))
    inside, radii, errors = [], [], []
    for k in chosen:
        withheld = int(rng.integers(days[k] + 1, days[k + 1]))
        found = proven(pole, days[max(0, k + 1 - schedule.kept) : k + 1], scale, withheld)
        assert not found.contradiction, f"the readings before {days[k]} contradict the bounds"
        truth, error = pole.xy[pole.at(withheld)], pole.error[pole.at(withheld)]
        inside.append(np.all((found.lower - error <= truth) & (truth <= found.upper + error)))
        radii.append(found.radii)
        errors.append(found.centre - truth)
    off = np.abs(errors)
    return Coverage(
        schedule,
        len(chosen),
        float(np.mean(inside)),
        float(np.mean(radii)),
        float(np.max(radii)),
        float(np.sqrt(np.mean(off**2))),
        float(off.max()),
    )


def sinusoids_error(pole: Pole) -> tuple[float, float]:
    """The usual way: mean, drift and waves fitted to 1962 to 1999, continued. Error after that: rms and worst."""
    t = (pole.days - JUDGED_FROM).astype(float)
    waves = [f(2 * np.pi * t / period) for period in (CHANDLER, YEAR) for f in (np.cos, np.sin)]
    columns = np.column_stack([np.ones_like(t), t, *waves])
    before = pole.days < JUDGED_FROM
    fitted, *_ = np.linalg.lstsq(columns[before], pole.xy[before], rcond=None)
    off = np.linalg.norm(pole.xy - columns @ fitted, axis=1)[~before]
    return float(np.sqrt(np.mean(off**2))), float(off.max())


def chandler(pole: Pole, scale: float, day: int, gap: int = 30, kept: int = 60) -> float:
    """The amplitude of the Chandler wobble as the middle of what readings prove of its two states."""
    days = day - gap * np.arange(kept)[::-1]
    shown, noise = pole.readings(days)
    found = sd.state_interval(plant(), shown, w_bound=scale * SHAPE, v_bound=noise, of=["Chandler x", "Chandler y"])
    return float(np.hypot(*found.centre))
