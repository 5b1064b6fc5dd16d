"""Names that changed in 0.1: until 0.2 an old one raises an error that says the new one."""

ARGUMENTS = {
    "P2": "cost=CostFunction(P2=...)",
    "Qv": "cost=CostFunction(Qv=...)",
    "Qw": "cost=CostFunction(Qw=...)",
    "R": "cost=CostFunction(R=...)",
    "arrival_cost": "cost=CostFunction(arrival=...)",
    "capacity": "collocation=Collocation(capacity=...)",
    "carried_weight": 'cost=CostFunction(arrival="filtered")',
    "check_spacing": "constraints=Constraints(check_spacing=...)",
    "degree": "collocation=Collocation(degree=...)",
    "engine": "constraints=Constraints(engine=...)",
    "eta": "cost=CostFunction(eta=...)",
    "every_lap": "every_period",
    "feedthrough": "input_side",
    "lap": "period",
    "lateness": "maximum_delay",
    "max_iterations": "solver=WindowSolver(max_iterations=...)",
    "tolerance": "solver=WindowSolver(tolerance=...)",
    "v_set": "constraints=Constraints(v=...)",
    "w_model": "constraints=Constraints(w_model=...)",
    "w_step": "collocation=Collocation(w_step=...)",
    "w_set": "constraints=Constraints(w=...)",
    "x_set": "constraints=Constraints(x=...)",
    "y_set": "constraints=Constraints(y=...)",
}
"""Old keyword -> new one, with the value that means the same where the kind changed."""

MOVED_ARGUMENTS = {
    ("Certificate.from_matrices", "margin"): "dataclasses.replace(certificate, margin=...)",
    ("Certificate.from_matrices", "solver"): "dataclasses.replace(certificate, solver=...)",
    ("plan", "budget"): "search_seconds",
}
"""(Function, keyword that it no longer takes) -> what does it now."""

ATTRIBUTES = {("FamilyCertificate", "schedule"): "family", ("SampleLosses", "every_lap"): "every_period"}
"""(Record, attribute that it no longer has) -> the attribute that has it now."""

NAMES = {"survival": "robustness", "Survival": "Robustness"}
"""Old name at the front door -> new one."""
