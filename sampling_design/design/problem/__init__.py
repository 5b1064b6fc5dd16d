"""What is asked: requirements, and all numbers of one design problem."""
