"""The least sigma over all schedules that keep a spacing rule (Theorem 17), bracketed."""
