"""The paper's own chain of constants, from Theorem 10 to a horizon, number by number."""
