"""Whether each plant of a box has a certificate, and how large the box may be."""
