"""What every room uses: argument checks, records, files, units, workers and sweeps."""
