"""What work costs that is counted, never timed: a search that stops after so much finds the same plan on every machine.

The unit is about a second of an ordinary processor core, worked out from the sizes of what is solved.
"""

from __future__ import annotations

CONE = (1e-3, 1e-6)  # work of a cone program, and for each entry that is not zero
STAGES = (1e-2, 1.5e-5)  # of a program over stages, and for each of them, with n states, n^1.5 times
EXCESS = (2e-3, 4e-6)  # the same where every output is a variable

COVER, NODE = (5e-3, 2e-5), 0.2
"""Of an integer program, and for each entry; a node of its tree more costs so much of that."""

MEETING = (4e-5, 2e-9)  # of a node of a tree of sets that a choice must meet, and for each entry of them

WEIGHED = (1.2e-4, 2e-9)
"""For each trajectory, of weighing what may take the place of a measurement, and for each end and measurement."""

FILTER = (4e-5, 1e-7)  # of each step of a filter, and for each choice, step and state

SEQUENCE = (1e-3, 5e-5)
"""The same through samples that leave a plan for a while: for each of them, with n states, n times."""

RELAXED = (5e-3, 3e-6)  # of a linear program, and for each entry
GAINS = (5e-3, 1e-4)  # of bounding a row by gains, and for each sample behind it, with n states, n times
BETWEEN = 1e-2  # of bounding a row between two samples
SYSTEM = (1e-2, 2e-4)  # of making a sampled system, and for each of them, with n states, n^2 times

STARTED = (0.0, 5e-5)
"""The same from a plan's start on: for N samples, of which a filter with n states forgets F, n N F times."""

CERTIFIED = (1.5, 0.06)  # of a certificate, and for each sample, with n states, n^2 times

AFTER = ((0.1, 1.0), (0.2, 1.5), (1.0, 2.0))
"""By what share of itself, and how many seconds, a budget may be exceeded: after the proof of the least cost, after
that of the best accuracy, and in the end."""
