"""A function as a list of instructions, its values and first derivatives over cells in intervals. Nothing is executed.

    [["x", 0], ["constant", 9.81], ["sin", 0], ["mul", 1, 2]]

Each entry is an input, a constant, or what it does to earlier entries.

Derivatives go along with the values (forward mode); one that is exactly zero is left out, one that is one and the same
double everywhere stays that double.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from . import intervals as iv
from .intervals import Interval
from .strict import Reader, count, is_list, is_text, list_of, number, refuse, table

MOST_INSTRUCTIONS = 20_000
INPUTS = ("x", "u", "w")
Slopes = dict[tuple[str, int], Interval]
Both = tuple[Interval, Slopes]


@dataclass(frozen=True)
class Instruction:
    """A word, the places of its arguments (of an input its number), and a constant or an exponent."""

    word: str
    places: tuple[int, ...]
    value: float = 0.0


@dataclass(frozen=True)
class Program:
    """Instructions in order, and the places of the results."""

    code: tuple[Instruction, ...]
    outputs: tuple[int, ...]


def read(value: object, place: str, sizes: Mapping[str, int]) -> Program:
    """The program in plain data; `sizes` says how many x, u, w there are."""
    shape: Reader = table({"code": list_of(lambda item, where: item), "outputs": list_of(count)})
    data = shape(value, place)
    if len(data["code"]) > MOST_INSTRUCTIONS:
        raise refuse(f"{place}.code", f"must have at most {MOST_INSTRUCTIONS} instructions")
    code = [instruction(item, f"{place}.code[{k}]", k, sizes) for k, item in enumerate(data["code"])]
    if any(k >= len(code) for k in data["outputs"]):
        raise refuse(f"{place}.outputs", f"must be places among {len(code)} instructions")
    return Program(tuple(code), tuple(data["outputs"]))


def instruction(value: object, place: str, at: int, sizes: Mapping[str, int]) -> Instruction:
    """One instruction: known, with as many earlier places as it takes."""
    if not is_list(value) or not value or not is_text(value[0]):
        raise refuse(place, "must be a list of a word and numbers")
    name, rest = value[0], value[1:]
    wanted = 1 if name in (*INPUTS, "constant") else 2 if name in (*TWO, "power") else 1 if name in ONE else 0
    if not wanted or len(rest) != wanted:
        raise refuse(place, f"must be a known instruction with its arguments, got {name!r:.40} with {len(rest)}")
    if name == "constant":
        return Instruction(name, (), number(rest[0], place))
    if name in INPUTS:
        k = count(rest[0], place)
        if k >= sizes.get(name, 0):
            raise refuse(place, f"must be one of {sizes.get(name, 0)} inputs {name}, got number {k}")
        return Instruction(name, (k,))
    if name == "power":
        return Instruction(name, (earlier(rest[0], place, at),), number(rest[1], place))
    return Instruction(name, tuple(earlier(k, place, at) for k in rest))


def earlier(value: object, place: str, at: int) -> int:
    """The place of an instruction before this one."""
    k = count(value, place)
    if k >= at:
        raise refuse(place, "must use earlier results only")
    return k


def every(program: Program, inputs: Mapping[str, list[Interval]], along: tuple[str, ...]) -> list[Both]:
    """Values and derivatives with respect to the inputs in `along`, of every instruction."""
    done: list[Both] = []
    like = next(item for items in inputs.values() for item in items)
    for each in program.code:
        name, places = each.word, each.places
        if name == "constant":
            found: Both = (iv.number(each.value, like), {})
        elif name in INPUTS:
            k = places[0]
            found = inputs[name][k], ({(name, k): iv.number(1.0, like)} if name in along else {})
        elif name == "power":
            found = chained(*powered(done[places[0]][0], each.value), done[places[0]][1])
        elif name in ONE:
            found = chained(*ONE[name](done[places[0]][0]), done[places[0]][1])
        else:
            found = TWO[name](done[places[0]], done[places[1]])
        done.append(found)
    return done


Form = dict[tuple[str, int], Interval]


def forms(program: Program, done: list[Both]) -> list[Form]:
    """Every output as a sum of constants times inputs and "atoms": instructions that are not linear in earlier ones.

    So an atom that occurs in several outputs has the same derivatives in all of them. What is constant is left out.
    """
    found: list[Form] = []
    for at, each in enumerate(program.code):
        parts = [found[k] for k in each.places] if each.word not in INPUTS else []
        unit: Form = {("atom", at): one(done[at][0])}
        if each.word in INPUTS:
            form: Form = {(each.word, each.places[0]): one(done[at][0])}
        elif not any(parts):
            form = {}
        elif each.word == "neg":
            form = {key: -part for key, part in parts[0].items()}
        elif each.word == "twice":
            form = {key: times(part, two(part)) for key, part in parts[0].items()}
        elif each.word in ("add", "sub"):
            form = added(parts[0], parts[1], 1 if each.word == "add" else -1)
        elif each.word == "mul" and not all(parts):
            whole, factor = (0, 1) if parts[0] else (1, 0)
            form = {key: times(part, done[each.places[factor]][0]) for key, part in parts[whole].items()}
        elif each.word == "div" and not parts[1]:
            form = {key: times(part, iv.inverse(done[each.places[1]][0])) for key, part in parts[0].items()}
        else:
            form = unit
        found.append(form)
    return [found[k] for k in program.outputs]


def relative(program: Program, done: list[Both]) -> list[Slopes]:
    """Derivatives of log|value| of every instruction; all numbers where a value may be 0.

    A product's is a sum: that of exp(a) b/c is a' + b'/b - c'/c, as narrow as these are however far the value ranges.
    """
    found: list[Slopes] = []
    for at, each in enumerate(program.code):
        name, (value, slopes) = each.word, done[at]
        parts = [found[k] for k in each.places] if name not in INPUTS else []
        direct = {key: times(part, iv.inverse(value)) for key, part in slopes.items()}
        if name == "exp":
            form = dict(done[each.places[0]][1])
        elif name in SCALED:
            form = {key: iv.number(SCALED[name], value) * part for key, part in parts[0].items()}
        elif name == "power":
            form = {key: iv.number(each.value, value) * part for key, part in parts[0].items()}
        elif name in ("mul", "div"):
            form = added(parts[0], parts[1], 1 if name == "mul" else -1)
        elif name in ("add", "sub"):
            form = weighed(done[each.places[0]][0], done[each.places[1]][0], parts, 1 if name == "add" else -1)
        else:
            form = direct
        found.append({key: common(form[key], part) if key in form else part for key, part in direct.items()})
    return found


SCALED = {"neg": 1.0, "twice": 1.0, "square": 2.0, "inverse": -1.0, "sqrt": 0.5}


def weighed(a: Interval, b: Interval, parts: list[Slopes], sign: int) -> Slopes:
    """(a' + s b')/(a + s b) = (a'/a)/(1 + s b/a) + (b'/b)/(1 + s a/b)."""
    shares = []
    for over, under in ((b, a), (a, b)):
        ratio = over * iv.inverse(under)
        shares.append(iv.inverse(one(a) + (ratio if sign > 0 else -ratio)))
    weighted = [{key: part * share for key, part in form.items()} for form, share in zip(parts, shares, strict=True)]
    return added(weighted[0], weighted[1], 1)


def common(a: Interval, b: Interval) -> Interval:
    """What both hold of one number."""
    low, high = np.maximum(a.low, b.low), np.minimum(a.high, b.high)
    return Interval(np.minimum(low, high), np.maximum(low, high))


def chained(value: Interval, slope: Interval, inner: Slopes) -> Both:
    """The chain rule."""
    return value, {key: times(slope, part) for key, part in inner.items()}


def times(a: Interval, b: Interval) -> Interval:
    """A product in which a factor that is exactly 1, -1 or 0 costs no rounding."""
    for one, other in ((a, b), (b, a)):
        if one.known() and one.low[0] in (1.0, -1.0, 0.0):
            s = one.low[0]
            return iv.number(0.0, other) if s == 0 else (other if s > 0 else -other)
    if a.known() and b.known() and float(a.low[0] * b.low[0]) == exact_product(float(a.low[0]), float(b.low[0])):
        return iv.number(float(a.low[0] * b.low[0]), a)
    return a * b


def exact_product(a: float, b: float) -> float:
    """The product if a double holds it, else not a number."""
    from fractions import Fraction

    product = Fraction(a) * Fraction(b) if np.isfinite([a, b]).all() else Fraction(0)
    return a * b if np.isfinite([a, b, a * b]).all() and Fraction(a * b) == product else float("nan")


def added(a: Slopes, b: Slopes, sign: int) -> Slopes:
    """Sums of derivatives."""
    found = dict(a)
    for key, part in b.items():
        signed = part if sign > 0 else -part
        found[key] = found[key] + signed if key in found else signed
    return found


def add(a: Both, b: Both) -> Both:
    """a + b."""
    return a[0] + b[0], added(a[1], b[1], 1)


def sub(a: Both, b: Both) -> Both:
    """a - b."""
    return a[0] - b[0], added(a[1], b[1], -1)


def mul(a: Both, b: Both) -> Both:
    """a b."""
    left = {key: times(part, b[0]) for key, part in a[1].items()}
    right = {key: times(part, a[0]) for key, part in b[1].items()}
    return times(a[0], b[0]), added(left, right, 1)


def div(a: Both, b: Both) -> Both:
    """a / b, its derivative (a' - (a/b) b') / b."""
    value, over = a[0] / b[0], iv.inverse(b[0])
    left = {key: times(part, over) for key, part in a[1].items()}
    right = {key: times(part, value * over) for key, part in b[1].items()}
    return value, added(left, right, -1)


TWO: dict[str, Callable[[Both, Both], Both]] = {"add": add, "sub": sub, "mul": mul, "div": div}


def one(x: Interval) -> Interval:
    """The number 1."""
    return iv.number(1.0, x)


def two(x: Interval) -> Interval:
    """The number 2."""
    return iv.number(2.0, x)


def exp(x: Interval) -> tuple[Interval, Interval]:
    """e^x."""
    value = iv.exponential(x)
    return value, value


def root(x: Interval) -> tuple[Interval, Interval]:
    """Square root."""
    value = iv.root(x)
    return value, iv.inverse(two(x) * value)


def tan(x: Interval) -> tuple[Interval, Interval]:
    """Tangent."""
    value = iv.sine(x) / iv.cosine(x)
    return value, one(x) + iv.square(value)


def tanh(x: Interval) -> tuple[Interval, Interval]:
    """Hyperbolic tangent."""
    value = iv.tangent_hyperbolic(x)
    slope = one(x) - iv.square(value)
    return value, Interval(np.maximum(slope.low, 0.0), slope.high)


def hyperbolic(x: Interval) -> tuple[Interval, Interval]:
    """sinh and cosh."""
    up, down = iv.exponential(x), iv.exponential(-x)
    half = iv.number(0.5, x)
    cosh = (up + down) * half
    return (up - down) * half, Interval(np.maximum(cosh.low, 1.0), cosh.high)


def absolute(x: Interval) -> tuple[Interval, Interval]:
    """|x|, whose slope at 0 is anything between -1 and 1."""
    low, high = np.where(x.low >= 0, 1.0, -1.0), np.where(x.high <= 0, -1.0, 1.0)
    return iv.size(x), Interval(low, high)


def powered(x: Interval, exponent: float) -> tuple[Interval, Interval]:
    """x to a constant."""
    if exponent == int(exponent) and abs(exponent) < 100:
        k = int(exponent)
        return iv.power(x, k), iv.number(exponent, x) * iv.power(x, k - 1)
    value = iv.exponential(iv.number(exponent, x) * iv.logarithm(x))
    return value, iv.number(exponent, x) * value * iv.inverse(x)


ONE: dict[str, Callable[[Interval], tuple[Interval, Interval]]] = {
    "neg": lambda x: (-x, iv.number(-1.0, x)),
    "twice": lambda x: (iv.number(2.0, x) * x, two(x)),
    "square": lambda x: (iv.square(x), two(x) * x),
    "inverse": lambda x: (iv.inverse(x), -iv.square(iv.inverse(x))),
    "sqrt": root,
    "exp": exp,
    "log": lambda x: (iv.logarithm(x), iv.where(x.low > 0, iv.inverse(x), iv.nothing(x))),
    "sin": lambda x: (iv.sine(x), iv.cosine(x)),
    "cos": lambda x: (iv.cosine(x), -iv.sine(x)),
    "tan": tan,
    "atan": lambda x: (iv.arctangent(x), iv.inverse(one(x) + iv.square(x))),
    "tanh": tanh,
    "sinh": hyperbolic,
    "cosh": lambda x: hyperbolic(x)[::-1],
    "abs": absolute,
}
