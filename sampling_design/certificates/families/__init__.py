"""One certificate for all schedules of a family: path-complete graphs, their program, and the proof of each step."""
