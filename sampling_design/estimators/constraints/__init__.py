"""Constraints of the window problem: convex sets, what they ask, and the engines that solve it."""
