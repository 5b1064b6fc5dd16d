"""Does the graph of a family certificate hold the whole family? Derived in rational numbers; the file is only compared.

A word is what a node takes for granted about the schedule since the window's start. At the start that is nothing; along
each edge this module derives it anew from the family's parameters and the word before, and the file may say no more.
At every node each gap that the family allows there must have an edge, which measures what the family measures.
"""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

from .family_file import Family, GapRange, Graph, Jitter, LostSamples, SpacedWindows
from .outcome import Refused

Word = tuple[Fraction, ...]


def need(condition: bool, u: int, what: str) -> None:
    """Refused if a schedule could leave the graph at node u, or an edge there is none of the family's."""
    if not condition:
        raise Refused("graph", f"the graph does not hold the family: at node {u}, {what}")


def covers(parts: list[tuple[Fraction, Fraction]], low: Fraction, high: Fraction) -> bool:
    """Whether closed intervals together cover [low, high]."""
    reached = None
    for a, b in sorted(parts):
        if a > (low if reached is None else reached):
            break
        if b >= low:
            reached = b if reached is None else max(reached, b)
    return reached is not None and reached >= high


def exact(word: tuple[float, ...]) -> Word:
    """The numbers of the file, without rounding."""
    return tuple(map(Fraction, word))


def implied(claimed: Word, derived: Word) -> bool:
    """Whether lower bounds that a word claims follow from those that were derived."""
    known = derived + (Fraction(0),) * len(claimed)
    return all(x <= y for x, y in zip(claimed, known, strict=False))


def gaps(graph: Graph, least: Fraction, most: Callable[[Word], Fraction]) -> None:
    """Words are lower bounds of the last gaps, newest first."""
    words = [exact(word) for word in graph.words]
    for u, word in enumerate(words):
        low, high, parts = least if u else Fraction(0), most(word), []
        for edge in graph.leaving(u):
            known = implied(words[edge.target], (Fraction(edge.low), *word))
            need(known, u, f"node {edge.target} takes longer gaps for granted than there were")
            need(all(edge.outputs), u, f"the edge to node {edge.target} does not measure every output")
            parts.append((Fraction(edge.low), Fraction(edge.high)))
        # a gap that only rounding allowed may leave no room for another one: no schedule comes here
        need((u > 0 and high < low) or covers(parts, low, high), u, f"gaps from {float(low):g} to {float(high):g}")


def gap_range(family: GapRange, graph: Graph) -> None:
    """From the start every gap up to the longest has an edge, elsewhere every gap of the range."""
    longest = Fraction(family.longest)
    gaps(graph, Fraction(family.shortest), lambda word: longest)


def spaced_windows(family: SpacedWindows, graph: Graph) -> None:
    """Any k gaps in a row sum to at most T: of those that hold the next one, i are known, k - 1 - i are to come."""
    k, spacing = family.count, Fraction(family.spacing)
    T = max(Fraction(family.window), k * spacing)  # where rounding alone leaves no room, equal gaps are in the family

    def most(word: Word) -> Fraction:
        return min(T - sum(word[:i]) - (k - 1 - i) * spacing for i in range(min(len(word), k - 1) + 1))

    gaps(graph, spacing, most)


def lost_samples(family: LostSamples, graph: Graph) -> None:
    """Words are the phase and which of the last samples were lost (1), newest first; less than that may be said."""
    nominal, words, N = family.nominal, [exact(word) for word in graph.words], family.nominal.gaps.size
    lengths, reach = [Fraction(g) for g in nominal.gaps], [Fraction(r) for r in nominal.reach]
    measured, lost = [tuple(row) for row in nominal.measured.tolist()], (False,) * nominal.measured.shape[1]
    for u, word in enumerate(words):
        bits, moves = word[1:], dict[tuple[int, bool], list[tuple[Fraction, Fraction]]]()
        for j in [(int(word[0]) + 1) % N] if u else range(N):
            moves[j, False] = []
            if sum(bits[: family.of - 1]) < family.most:
                moves[j, True] = []
        for edge in graph.leaving(u):
            bit = edge.outputs == lost
            phase, *claimed = words[edge.target]
            j = int(phase)
            fits = (j, bit) in moves and (bit or edge.outputs == measured[j])
            fits = fits and implied(tuple(claimed), (Fraction(bit), *bits))
            need(fits, u, f"the edge to node {edge.target} is no sample of the period, taken or lost, that may follow")
            moves[j, bit].append((Fraction(edge.low), Fraction(edge.high)))
        for (j, bit), parts in moves.items():
            low, high = (lengths[j], lengths[j]) if u else (Fraction(0), reach[j])
            need(covers(parts, low, high), u, f"sample {j} of the period, {'lost' if bit else 'taken'}")


def orders(read: list[list[int]], word: Word, u: int) -> list[tuple[int, int, Word]]:
    """Which reading of which sample may come next at a node, and which of that sample are then yet to come."""
    if not u:  # a window may start between two readings of a sample
        whole = enumerate(read)
        parts = [
            (j, [i for bit, i in enumerate(own) if w >> bit & 1]) for j, own in whole for w in range(2 ** len(own))
        ]
    elif word[3:]:
        parts = [(int(word[0]), [int(i) for i in word[3:]])]
    else:
        j = (int(word[0]) + 1) % len(read)
        parts = [(j, read[j])]
    return [(j, k, tuple(Fraction(i) for i in unread if i != k)) for j, unread in parts for k in unread]


def jitter(family: Jitter, graph: Graph) -> None:
    """Words are the phase, the ends of the last deviation, and which readings of that sample are yet to come."""
    nominal, words = family.nominal, [exact(word) for word in graph.words]
    early, late = [-Fraction(e) for e in family.early], [Fraction(t) for t in family.late]
    lengths, reach = [Fraction(g) for g in nominal.gaps], [Fraction(r) for r in nominal.reach]
    patterns = [family.readings(j) for j in range(nominal.gaps.size)]
    read, what = [list(each) for each in patterns], "reading" if family.apart else "sample of the period"
    need(2 ** max(map(len, read)) <= len(words), 0, "outputs of a sample that are yet to be read")
    for u, word in enumerate(words):
        cells: dict[tuple[int, int, Word], list[tuple[Fraction, Fraction]]] = {
            move: [] for move in orders(read, word, u)
        }
        for edge in graph.leaving(u):
            phase, a, b, *rest = words[edge.target]
            j, left = int(phase), tuple(rest)
            k = next((i for i, outputs in patterns[j].items() if outputs == edge.outputs), -1)
            need((j, k, left) in cells, u, f"the edge to node {edge.target} is no {what} that may follow")
            before = [i for i in read[j] if i not in left and i != k]
            if u:
                gap = Fraction(0) if word[3:] else lengths[j]
                low, high = gap + a - word[2], gap + b - word[1]
            else:  # the reading before it came no earlier than all of these allow
                gap, since = (Fraction(0), before) if before else (reach[j], read[j - 1])
                low, high = Fraction(0), gap + b - max(early[i] for i in since)
            wide = edge.low <= max(low, Fraction(0)) and high <= edge.high
            need(wide, u, f"the edge to node {edge.target} leaves out gaps of that deviation")
            cells[j, k, left].append((a, b))
        for (j, k, left), parts in cells.items():
            low = max(early[i] for i in read[j] if i not in left)
            low = max(low, word[1]) if u and word[3:] else low
            high = min(late[k], *(late[int(i)] for i in left)) if left else late[k]
            which = f"output {k} of sample {j}" if family.apart else f"sample {j}"
            need(high < low or covers(parts, low, high), u, f"deviations of {which} of the period")


COVERED: dict[type[Family], Callable[[Any, Graph], None]] = {
    GapRange: gap_range,
    SpacedWindows: spaced_windows,
    LostSamples: lost_samples,
    Jitter: jitter,
}


def judge(family: Family, graph: Graph) -> None:
    """Refused unless every schedule of the family, from every window start, is a path in the graph."""
    COVERED[type(family)](family, graph)
