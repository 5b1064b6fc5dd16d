"""Aliasing, unseen modes, lost samples, jitter: what goes wrong, and what the toolbox says about it.

Run: `python examples/06_when_it_fails.py`
"""

import numpy as np

import sampling_design as sd

RATE = 0.1


def verdict(plant: sd.Plant, times: object) -> tuple[bool, str]:
    """Return whether a certificate with `RATE` is found, and its horizon or the reason why not."""
    try:
        certificate = sd.certify(plant, times, eta=RATE)
    except sd.SamplingDesignError as reason:
        return False, str(reason)
    return True, f"certified, M > {certificate.horizon().minimum:.2f} {plant.time_unit}"


def main() -> None:
    """Meet each failure and its repair."""
    oscillator = sd.named_plant("oscillator")
    every = sd.PeriodicSchedule([1.0])
    blind = sd.Plant(np.diag([0.1, -1.0]), [[0.0, 1.0]])
    cases = {
        "period pi": (oscillator, sd.PeriodicSchedule([np.pi])),
        "period 3.2": (oscillator, sd.PeriodicSchedule([3.2])),
        "an unstable mode that no output sees": (blind, every),
        "one of any three samples lost": (oscillator, sd.LostSamples(every, 1, 3)),
        "period 2.9 with 0.15 of jitter": (oscillator, sd.Jitter(sd.PeriodicSchedule([2.9]), 0.15)),
        "any gaps between 2.6 and 3.2": (oscillator, sd.GapRange(2.6, 3.2)),
    }
    answers = {name: verdict(*case) for name, case in cases.items()}
    for name, (holds, words) in answers.items():
        print(f"{name}: {'yes' if holds else 'NO'}. {words}")
    print("Jitter moves each sample about its own place; gaps of pi in a row would drift away from it.")
    repair = sd.certificates.smallest_repair(oscillator, sd.PeriodicSchedule([np.pi]), RATE)
    print(f"Repair of period pi: gap {repair['gap']} from {repair['from']:.4f} to {repair['to']:.4f}.")

    assert [holds for holds, _ in answers.values()] == [False, True, False, True, True, False]
    assert "aliased" in answers["period pi"][1]
    assert "0.1" in answers["an unstable mode that no output sees"][1]
    assert sd.certificate_exists(oscillator, sd.PeriodicSchedule([repair["to"]]), RATE).exists


if __name__ == "__main__":
    main()
