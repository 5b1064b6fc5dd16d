"""Names that changed in 0.1: until 0.2 an old one raises an error that says the new one."""

ARGUMENTS = {
    "carried_weight": 'arrival_cost="filtered"',
    "every_lap": "every_period",
    "feedthrough": "input_side",
    "lateness": "maximum_delay",
}
"""Old keyword -> new one, with the value that means the same where the kind changed."""

NAMES = {"survival": "robustness", "Survival": "Robustness"}
"""Old name at the front door -> new one."""
