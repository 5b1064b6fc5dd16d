"""The patient's certificates, made anew: `python -m tests.benchmarks.thyroid_theorem [--therapy] [FILE]`.

P(tau) is sought at a slower rate than it is then proven at: the search leaves slack in every inequality for the proof.
"""

import sys
import time
from dataclasses import replace

import numpy as np

from sampling_design import GapRange
from sampling_design.nonlinear.thyroid import NOISE_BOUND, PROCESS_BOUND
from sampling_design.nonlinear.thyroid_logs import patient_in_tube, patient_under_therapy
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion

if __name__ == "__main__":
    began = time.process_time()
    Qw, R = np.diag(1e4 / PROCESS_BOUND**2), np.diag(2e-2 / NOISE_BOUND**2)
    therapy = "--therapy" in sys.argv
    plant, sought, eta = (patient_under_therapy(), 0.45, 0.49) if therapy else (patient_in_tube(), 0.58, 0.66)
    found = replace(certify_inclusion(plant, GapRange(0.5, 1.5), eta=sought, Qw=Qw, R=R, pieces=3), eta=eta)
    print(found, found.verify())
    print(f"{time.process_time() - began:.1f} s of processor time")
    if len(sys.argv) > 1 + therapy:
        found.save(sys.argv[-1])
