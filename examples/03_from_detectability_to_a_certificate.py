"""Four horizons for one schedule: the proof's constants, the exact certificate twice, and the truth.

Run: `python examples/03_from_detectability_to_a_certificate.py`
"""

import numpy as np

import sampling_design as sd


def corrupt(certificate: sd.Certificate, factor: float) -> sd.Certificate:
    """Return the certificate with P1 multiplied by `factor`: larger claims more than was proven."""
    parts = {name: getattr(certificate, name) for name in ("P2", "Qw", "R", "Qv", "eta")}
    return sd.Certificate.from_matrices(certificate.plant, certificate.schedule, P1=factor * certificate.P1, **parts)


def main() -> None:
    """Compare the four horizons and check the certificate."""
    plant = sd.named_plant("double_integrator")
    schedule = sd.PeriodicSchedule([1.0])

    detectable = sd.certificates.certify_detectability(plant)
    print(f"The plant forgets at the rate eta = {detectable.eta:.3g} 1/s if it is measured all the time.")

    horizons = sd.certificates.four_horizons(plant, schedule)
    print(horizons)
    paper, exact, improved, true = (row.minimum for row in horizons.rows)
    print(f"The proof's constants ask for {paper / improved:.0f} times the horizon that is certified.")

    certificate = horizons.certificate
    verdict = certificate.verify()
    print("verified:", verdict.passed, "- with P1 two percent larger:", corrupt(certificate, 1.02).verify().passed)

    # the same for every schedule whose gaps lie in a range, and a range that must be refused
    oscillator = sd.named_plant("oscillator")
    family = sd.certify(oscillator, sd.GapRange(0.5, 1.5), eta=0.1)
    print(f"Any gap between 0.5 and 1.5 s: horizon M > {family.horizon().minimum:.2f} s.")
    try:
        sd.certify(oscillator, sd.GapRange(3.0, 3.3), eta=0.1)
        refused = ""
    except sd.SamplingDesignError as reason:
        refused = str(reason)
    print("Any gap between 3.0 and 3.3 s:", refused)

    assert true <= improved < exact < paper
    assert paper > 20 * improved
    assert verdict.passed
    assert not corrupt(certificate, 1.02).verify().passed
    assert np.all(np.linalg.eigvalsh(certificate.P2 - certificate.P1) >= 0)
    assert "3.14159" in refused


if __name__ == "__main__":
    main()
