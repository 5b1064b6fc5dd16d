"""Tests, a package of their own: another distribution may bring a `tests` that would stand for it."""
