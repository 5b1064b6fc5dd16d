"""Where to put the samples: requirements, schedules, and the bound that no schedule can beat."""
