"""A spring that the drawing knows and the workshop does not: one certificate for a whole range of plants.

Run: `python examples/08_plants_not_exactly_known.py` (extra `nonlinear`)
"""

import numpy as np

import sampling_design as sd
from sampling_design.nonlinear.examples import pendulum


def spring(omega: float) -> sd.Plant:
    """Return the mass on a spring that swings with `omega` rad/s."""
    return sd.Plant([[0.0, 1.0], [-(omega**2), 0.0]], [[1.0, 0.0]], time_unit="s")


def refusal(plant: object, times: object, eta: float = 0.1) -> str:
    """Return why there is no certificate, or nothing."""
    try:
        sd.certify(plant, times, eta=eta)
    except sd.SamplingDesignError as reason:
        return str(reason)
    return ""


def main() -> None:
    """Certify the drawing, both ends, the range, and a pendulum at all angles."""
    drawing = sd.named_plant("oscillator")
    nominal = sd.certify(drawing, sd.PeriodicSchedule([1.0, 1.5]), eta=0.1)
    parts = {name: getattr(nominal, name) for name in ("P1", "P2", "Qw", "R", "Qv", "eta")}
    neighbour = sd.Certificate.from_matrices(spring(1.1), nominal.schedule, **parts)
    print("The drawing's certificate for a spring of 1.1 rad/s:", neighbour.verify().verdict)

    every = sd.PeriodicSchedule([3.0])
    ends = [refusal(spring(omega), every) for omega in (0.9, 1.1)]
    middle = refusal(spring(np.pi / 3), every)
    print("Every 3 s, both ends of the range:", [words or "certified" for words in ends])
    print("And in the middle:", middle)

    stiffness = sd.UncertainParameter("omega^2", 0.9**2, 1.1**2, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
    springs = sd.UncertainPlant(drawing, [stiffness])
    proof = sd.certify(springs, sd.GapRange(0.5, 1.5), eta=0.1)
    print(proof.explain())
    named = refusal(springs, sd.GapRange(0.5, 3.0))
    print("Gaps up to 3 s:", named)
    swinging = sd.certify(pendulum(), sd.GapRange(0.1, 1.0), eta=0.2)
    print(f"A pendulum at all angles, gaps to 1 s: lambda {swinging.lam:.1f}.")

    assert nominal.verify().passed
    assert not neighbour.verify().passed
    assert ends == ["", ""]
    assert "aliased" in middle
    assert proof.verify().passed
    assert proof.lam < 4.0
    assert np.isclose(proof.horizon("arrival").minimum, np.log(4) / 0.1)
    assert "omega^2 = 1.21" in named
    assert swinging.verify().passed


if __name__ == "__main__":
    main()
