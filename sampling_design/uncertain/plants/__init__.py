"""Plants of which a set is known, or that vary in time."""
