# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.nonlinear import examples as examples
from sampling_design.nonlinear import thyroid as thyroid
from sampling_design.nonlinear import thyroid_logs as thyroid_logs
from sampling_design.nonlinear.collocation import Collocation as Collocation
from sampling_design.nonlinear.detectability import DetectabilityEvidence as DetectabilityEvidence
from sampling_design.nonlinear.detectability import check_detectability as check_detectability
from sampling_design.nonlinear.experiment import thyroid_experiment as thyroid_experiment
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator as NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant as NonlinearPlant
from sampling_design.nonlinear.model import from_linear as from_linear
from sampling_design.nonlinear.report import ThyroidReport as ThyroidReport
from sampling_design.nonlinear.simulation import plant_along as plant_along
