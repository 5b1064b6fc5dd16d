"""The window problem as a finite one, and its solution without constraints."""
