"""Plants: what is measured, independent of when."""
