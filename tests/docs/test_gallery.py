"""Every picture stands in the gallery: what a page only finds out when it is built is found out here."""

from pathlib import Path

import pytest

from sampling_design import plotting

GALLERY = (Path(__file__).parents[2] / "docs" / "gallery.md").read_text()
DRAWN_BY = {
    "Schedule": "sensors.plot()",
    "PeriodicSchedule": "schedule.plot()",
    "SamplingFamily": "sd.Jitter(schedule",
    "WindowSigma": "sd.window_sigma(",
    "ScheduleDesign": "plotting.draw(visits",
    "Plan": "weekly.plot()",
    "PlanComparison": "weekly.compare(",
    "PatientRun": "run.plot()",
    "PatientFigure": "run.figure(",
    "Accuracy": "sd.guaranteed_accuracy(",
    "Projection": ".projection(",
    "WorstCaseSigma": "sd.worst_case_sigma(",
    "ParetoFront": "sd.pareto_front(",
    "SampleLosses": "sd.design.sample_losses(",
    "Certificate": "certificate.plot()",
    "FamilyCertificate": "sd.certify(plant, sd.GapRange(",
    "InclusionCertificate": "sd.certify(sd.UncertainPlant(",
    "InformationCurve": "sd.certificates.information_curve(",
    "TradeoffCurve": "sd.certificates.tradeoff_curve(",
    "Robustness": "sd.robustness(",
    "FourHorizons": "sd.certificates.four_horizons(",
    "ModalSplit": "sd.plants.split_modes(",
    "Counterexample": "unseen.plot()",
    "Measurements": "sd.Measurements(",
    "SimulatedRecord": "record.plot()",
    "SmoothedWindow": "scheme.smoothed().plot()",
    "EstimateRecord": "plotting.draw(estimates",
    "EstimateCurve": "estimate_curve(follower",
    "EstimateEnvelope": "envelope.plot()",
    "ValidationReport": "sd.validate(",
    "ScheduleLog": "sd.compare_schedule(",
}


@pytest.mark.parametrize("record", plotting._PICTURES)
def test_a_record_with_a_picture_has_a_cell(record):
    assert record in DRAWN_BY, f"{record} has a picture: draw it in docs/gallery.md, and say here by which words"
    assert DRAWN_BY[record] in GALLERY
