"""How many samples determine the state, and which modes no output sees."""
