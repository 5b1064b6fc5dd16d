"""What a plant and a set of sample times show of the state together."""
