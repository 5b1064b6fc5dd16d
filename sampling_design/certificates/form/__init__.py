"""What every certificate is made of: a seal, a verdict, constants with their sources, horizons."""
