"""What happens over one gap: transition, noise, discount, and the weights of the cost."""
