"""Certificate files decided in ball arithmetic: proven, refuted, or undecided."""
