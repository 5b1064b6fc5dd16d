"""A clock made of what is done, so that a law about seconds is the same on every machine and under any load."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from types import FrameType

import pytest

STEP = 4e-6
"""Seconds for every function that is entered or left, and every call of one of C: about what they take."""


class Counted:
    """Seconds of what is done while it runs, and of `time` then; what is imported on the way is not counted."""

    def __init__(self, each: float = STEP) -> None:
        self.each, self.steps, self.imports = each, 0, 0

    def step(self, frame: FrameType, event: str, _: object) -> None:
        """Count one event of the profiler."""
        if frame.f_code.co_name == "_find_and_load" and event in ("call", "return"):
            self.imports += 1 if event == "call" else -1
        self.steps += not self.imports

    def read(self) -> float:
        """The seconds so far."""
        return self.each * self.steps

    @contextlib.contextmanager
    def running(self) -> Iterator[Counted]:
        """Let it count, and be the clock of everyone who asks `time`."""
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(time, "perf_counter", self.read)
            before = sys.getprofile()
            sys.setprofile(self.step)
            try:
                yield self
            finally:
                sys.setprofile(before)
