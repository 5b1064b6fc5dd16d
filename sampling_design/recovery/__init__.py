"""What anybody can recover of the state from a schedule when noise and disturbances keep their bounds."""
