"""The exact certificate of one schedule: the discounted Riccati recursion, its supremum, and the choice of weights."""
