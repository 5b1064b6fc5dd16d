"""What was measured: records of samples, their files and frames."""
