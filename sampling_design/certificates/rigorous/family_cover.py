"""Does the graph of a family certificate hold the whole family? Decided in rational numbers, from words and edges.

A word is what a node may take for granted about the schedule since the window's start. At every node each gap that the
family allows there must have an edge, and what the edge's target takes for granted must be true.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from sampling_design.certificates.rigorous.ball_problem import REFUTED, Unproven


@dataclass(frozen=True)
class FileEdge:
    """From node `source` to node `target` in a time within [low, high]; `outputs` are measured at its end."""

    source: int
    target: int
    low: Fraction
    high: Fraction
    outputs: tuple[bool, ...]


@dataclass(frozen=True)
class FileGraph:
    """Words, edges, and the number of outputs of the plant."""

    words: tuple[tuple[Any, ...], ...]
    edges: tuple[FileEdge, ...]
    p: int

    @classmethod
    def read(cls, graph: dict[str, Any], p: int) -> FileGraph:
        """The graph in the plain data of a file."""
        words = tuple(tuple(word) for word in graph["words"])
        edges = []
        for source, target, low, high, outputs in graph["edges"]:
            edge = FileEdge(int(source), int(target), exact(low), exact(high), tuple(bool(on) for on in outputs))
            if not (0 <= edge.source < len(words) and 0 < edge.target < len(words) and len(edge.outputs) == p):
                raise Unproven(REFUTED, "graph", f"[{source}, {target}, {low}, {high}, {outputs}] is no edge")
            if not 0 <= edge.low <= edge.high:
                raise Unproven(REFUTED, "graph", f"the edge from node {source} to {target} has no interval of times")
            edges.append(edge)
        return cls(words, tuple(edges), p)

    def leaving(self, u: int) -> list[FileEdge]:
        """Edges that leave node u."""
        return [edge for edge in self.edges if edge.source == u]

    def top(self, u: int) -> Fraction:
        """Longest time that may pass at node u."""
        return max((edge.high for edge in self.leaving(u)), default=Fraction(0))


def exact(value: Any) -> Fraction:
    """The number of the file, without rounding."""
    return Fraction(float(value))


def require(condition: bool, u: int, what: str) -> None:
    """Raise Unproven if a schedule of the family could leave the graph at node u."""
    if not condition:
        raise Unproven(REFUTED, "graph", f"the graph does not hold the family: at node {u}, {what}")


def covers(edges: list[tuple[Fraction, Fraction]], low: Fraction, high: Fraction) -> bool:
    """Whether closed intervals together cover [low, high]."""
    reached = None
    for a, b in sorted(edges):
        if a > (low if reached is None else reached):
            break
        if b >= low:
            reached = b if reached is None else max(reached, b)
    return reached is not None and reached >= high


def gap_range(graph: FileGraph, times: dict[str, Any]) -> None:
    """From the start every gap up to the longest has an edge, elsewhere every gap of the range."""
    shortest, longest = exact(times["shortest"]), exact(times["longest"])
    for u in range(len(graph.words)):
        low = shortest if u else Fraction(0)
        whole = [(e.low, e.high) for e in graph.leaving(u) if all(e.outputs)]
        require(covers(whole, low, longest), u, f"gaps from {float(low):g} to {float(longest):g}")


def _remembers(graph: FileGraph, edge: FileEdge, word: tuple[Any, ...]) -> bool:
    """Whether the target takes more for granted than lower bounds of the last gaps that hold along the edge."""
    claimed, known = [exact(x) for x in graph.words[edge.target]], [edge.low, *(exact(x) for x in word)]
    return len(claimed) > len(known) or any(x > y for x, y in zip(claimed, known, strict=False))


def spaced_windows(graph: FileGraph, times: dict[str, Any]) -> None:
    """Words are lower bounds of the last gaps, newest first; any k gaps in a row sum to at most T."""
    T, k, spacing = exact(times["window"]), int(times["count"]), exact(times["spacing"])
    for u, word in enumerate(graph.words):
        bounds = [exact(x) for x in word]
        most = min(T - sum(bounds[:i]) - (k - 1 - i) * spacing for i in range(min(len(bounds), k - 1) + 1))
        low = spacing if u else Fraction(0)
        known = [(e.low, e.high) for e in graph.leaving(u) if all(e.outputs) and not _remembers(graph, e, word)]
        require(most < low or covers(known, low, most), u, f"gaps from {float(low):g} to {float(most):g}")


@dataclass(frozen=True)
class Lap:
    """The nominal schedule of a family: gaps, reach of a window start before each sample, outputs of each sample."""

    gaps: tuple[Fraction, ...]
    reach: tuple[Fraction, ...]
    outputs: tuple[tuple[bool, ...], ...]

    @classmethod
    def read(cls, schedule: dict[str, Any], p: int) -> Lap:
        """The nominal schedule in the plain data of a file."""
        if schedule.get("output_names") is not None:
            raise Unproven(REFUTED, "times", "the columns of the nominal schedule must be the plant's outputs")
        gaps = tuple(exact(gap) for gap in schedule["gaps"])
        first = exact(schedule.get("first", schedule["gaps"][0]))
        seen = schedule.get("outputs") or [[1] * p] * len(gaps)
        outputs = tuple(tuple(bool(on) for on in row) for row in seen)
        sound = all(gap > 0 for gap in gaps) and 0 <= first <= sum(gaps) and len(outputs) == len(gaps)
        if not (sound and all(len(row) == p for row in outputs)):
            raise Unproven(REFUTED, "times", "the nominal schedule must have positive gaps and one column per output")
        return cls(gaps, (max(gaps[0], first), *gaps[1:]), outputs)

    def next(self, word: tuple[Any, ...], u: int) -> list[int]:
        """Which samples of the lap may come next at a node."""
        return [(int(word[0]) + 1) % len(self.gaps)] if u else list(range(len(self.gaps)))


def lost_samples(graph: FileGraph, times: dict[str, Any]) -> None:
    """Words are the phase and which of the last samples were lost (1), newest first; at most d of any w are."""
    lap, most, of = Lap.read(times["schedule"], graph.p), int(times["most"]), int(times["of"])
    for u, word in enumerate(graph.words):
        bits = [int(bit) for bit in word[1:]] if u else []
        for j in lap.next(word, u):
            low = lap.gaps[j] if u else Fraction(0)
            high = lap.gaps[j] if u else lap.reach[j]
            for lost in (False, True):
                if lost and sum(bits[: of - 1]) >= most:
                    continue
                seen = tuple([False] * graph.p) if lost else lap.outputs[j]
                found = []
                for e in graph.leaving(u):
                    phase, *claimed = graph.words[e.target]
                    true = [int(lost), *bits]
                    fits = len(claimed) <= len(true) and all(x <= y for x, y in zip(claimed, true, strict=False))
                    found += [(e.low, e.high)] if phase == j and e.outputs == seen and fits else []
                require(covers(found, low, high), u, f"sample {j} of the lap, {'lost' if lost else 'taken'}")


def jitter(graph: FileGraph, times: dict[str, Any]) -> None:
    """Words are the phase and the ends of the last deviation from the nominal time."""
    lap, radius = Lap.read(times["schedule"], graph.p), exact(times["radius"])
    for u, word in enumerate(graph.words):
        before = [exact(end) for end in word[1:]] if u else []
        for j in lap.next(word, u):
            cells = []
            for e in graph.leaving(u):
                phase, a, b = graph.words[e.target]
                a, b = exact(a), exact(b)
                low = lap.gaps[j] + a - before[1] if u else Fraction(0)
                high = lap.gaps[j] + b - before[0] if u else lap.reach[j] + radius + b
                if phase == j and e.outputs == lap.outputs[j] and e.low <= max(low, Fraction(0)) and high <= e.high:
                    cells.append((a, b))
            require(covers(cells, -radius, radius), u, f"deviations of sample {j} of the lap")


COVERED: dict[str, Callable[[FileGraph, dict[str, Any]], None]] = {
    "gap-range": gap_range,
    "spaced-windows": spaced_windows,
    "lost-samples": lost_samples,
    "jitter": jitter,
}
