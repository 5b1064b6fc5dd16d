"""The core works where no ring and no extra can be imported: the paper's way from a plant to a validation report."""

import subprocess
import sys

import pytest

from tests.benchmarks.installation import EXTRAS
from tests.house.sources import ROOT
from tests.house.test_floors import RINGS

ALONE = """
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        if name in EXTRAS or (name.startswith("sampling_design.") and name.split(".")[1] in RINGS):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refused())
import sampling_design as sd

plant = sd.read_plant("examples/plants/oscillator.toml")
schedule = sd.design_schedule(plant, sd.Requirement(window=4.0, spacing=0.5, samples=3), starts=1, branches=0).schedule
assert sd.window_sigma(plant, schedule, 4.0).lower > 0
certificate = sd.certify(plant, schedule, eta=0.4)
assert certificate.verify().passed
assert sd.read_certificate(certificate.save(sys.argv[1])).lam == certificate.lam
estimator = sd.MovingHorizonEstimator(plant, certificate, w_bound=0.1, v_bound=0.1, initial_error=2.0)
assert estimator.update(0.4, [0.98]).certified
ball = sd.estimators.ConvexSet.ball(0.5, dimension=2) & sd.estimators.ConvexSet.box([-0.4, -0.4], [0.4, 0.4])
sets = sd.Constraints(x=ball, y=(5.0, 10.0), v=(-1.0, 1.0))
assert "No trajectory meets" in sd.MovingHorizonEstimator(plant, certificate, constraints=sets).update(0.4, [9.0]).note
assert sd.certificates.certify_detectability(plant).verify().passed
for extra, asked in (("modelling", estimator.problem), ("control", plant.to_control)):
    try:
        asked()
    except sd.errors.MissingExtraError as error:
        assert error.extra == extra
    else:
        raise AssertionError(extra)
assert sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=0.1).verify()
assert sd.validate(plant, schedule, certificate, runs=4, scenarios=["random"]).passed
for other, words in ((lambda: sd.window_sigma(schedule, schedule, 4.0), "`plant` must be a Plant"),
                     (certificate.plot, "nothing that draws a Certificate is installed")):
    try:
        other()
    except sd.ArgumentError as error:
        assert words in str(error), error
    else:
        raise AssertionError(words)
assert not [name for name in sys.modules if name.split(".")[1:2] and name.startswith("sampling_design.")
            and name.split(".")[1] in RINGS]
"""


@pytest.mark.long
def test_the_core_is_used_with_no_ring_to_import(tmp_path):
    extras = {module.split(".")[0] for _, module, _ in EXTRAS.values()}
    given = f"RINGS, EXTRAS = {RINGS!r}, {extras!r}"
    words = [sys.executable, "-c", f"{given}\n{ALONE}", str(tmp_path / "certificate.json")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
