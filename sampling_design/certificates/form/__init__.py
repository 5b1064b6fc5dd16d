"""What every certificate is made of: a digest, a verdict, constants with their sources, horizons."""
