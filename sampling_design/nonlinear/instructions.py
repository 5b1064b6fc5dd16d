"""A casadi expression as a list of instructions: plain data that anybody can evaluate, in any arithmetic."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.records.record import Plain

if TYPE_CHECKING:
    from casadi import Function

_ONE = {
    "OP_NEG": "neg",
    "OP_EXP": "exp",
    "OP_LOG": "log",
    "OP_SQRT": "sqrt",
    "OP_SQ": "square",
    "OP_TWICE": "twice",
    "OP_INV": "inverse",
    "OP_SIN": "sin",
    "OP_COS": "cos",
    "OP_TAN": "tan",
    "OP_ATAN": "atan",
    "OP_TANH": "tanh",
    "OP_SINH": "sinh",
    "OP_COSH": "cosh",
    "OP_FABS": "abs",
}
_TWO = {"OP_ADD": "add", "OP_SUB": "sub", "OP_MUL": "mul", "OP_DIV": "div"}


def instructions(function: Function, names: tuple[str, ...]) -> dict[str, Plain]:
    """Return `{"code": [[word, arguments...], ...], "outputs": [...]}` of a casadi SX Function.

    Raises ArgumentError if it holds an operation for which no interval is known, such as a comparison.

    Parameters
    ----------
    function : casadi Function
        Of SX, with one dense output.
    names : tuple of str
        Of its inputs, as the instructions call them.

    Examples
    --------
    >>> import casadi
    >>> x = casadi.SX.sym("x", 1)
    >>> instructions(casadi.Function("f", [x], [casadi.sin(x) * 2]), ("x",))["code"]
    [['x', 0], ['sin', 0], ['twice', 1]]
    """
    ca = casadi()
    known = {getattr(ca, key): word for key, word in (_ONE | _TWO).items()}
    code: list[list[str | int | float]] = []
    slots: dict[int, int] = {}
    outputs: dict[int, int] = {}

    def put(*entry: str | int | float) -> int:
        code.append(list(entry))
        return len(code) - 1

    for k in range(function.n_instructions()):
        op, into, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_CONST:
            slots[out[0]] = put("constant", float(function.instruction_constant(k)))
        elif op == ca.OP_INPUT:
            slots[out[0]] = put(names[into[0]], int(into[1]))
        elif op == ca.OP_OUTPUT:
            outputs[int(out[1])] = slots[into[0]]
        elif op == ca.OP_ASSIGN:
            slots[out[0]] = slots[into[0]]
        elif op in (ca.OP_POW, ca.OP_CONSTPOW):
            base, exponent = slots[into[0]], slots[into[1]]
            if code[exponent][0] == "constant":
                slots[out[0]] = put("power", base, code[exponent][1])
            else:
                slots[out[0]] = put("exp", put("mul", exponent, put("log", base)))
        elif op in known:
            word = known[op]
            slots[out[0]] = put(word, *(slots[i] for i in into[: 2 if word in _TWO.values() else 1]))
        else:
            raise ArgumentError(
                f"`{function.name()}` must be made of arithmetic, powers, exp, log, sqrt and trigonometric functions "
                f"for a certificate, got operation number {op} of casadi."
            )
    return {"code": code, "outputs": [outputs[k] for k in sorted(outputs)]}
