"""`python -m checkers certificate.json`."""

from .check import run

run()
