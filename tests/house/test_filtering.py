"""A covariance steps by `numerics/filtering.py` and by nothing else in floats: nobody writes F Y F' + W by hand.

Joseph's form is two such products, the variance of an innovation is one. The room `numerics` builds on it, and the
checkers repeat on purpose what the rest computes.
"""

import ast

import pytest

from tests.house.sources import PACKAGE, SOURCES, nodes


def transposed(node):
    """What a node is the transpose of, None if it is none."""
    if isinstance(node, ast.Attribute) and node.attr in ("T", "mT"):
        return node.value
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ("swapaxes", "transpose")
    ):
        return node.args[0] if isinstance(node.func.value, ast.Name) and node.func.value.id == "np" else node.func.value
    return None


def factors(node):
    """A product of matrices, cut into its factors."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        return [*factors(node.left), *factors(node.right)]
    return [node]


def is_congruence(node):
    """Whether it is F Y F', perhaps with a factor in front."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        return is_congruence(node.left) or is_congruence(node.right)
    parts = factors(node)
    first = parts[0].right if isinstance(parts[0], ast.BinOp) and isinstance(parts[0].op, ast.Mult) else parts[0]
    last = transposed(parts[-1])
    return len(parts) >= 3 and last is not None and ast.dump(last) == ast.dump(first)


def steps(tree):
    """Lines on which something is added to a congruence."""
    found = []
    for node in tree:
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            found += [node.lineno] * (is_congruence(node.left) or is_congruence(node.right))
        if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add) and is_congruence(node.value):
            found.append(node.lineno)
    return found


@pytest.mark.long
def test_covariances_step_in_one_place():
    own = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] not in ("checkers", "numerics")]
    assert [f"{path.relative_to(PACKAGE)}:{line}" for path in own for line in steps(nodes(path))] == []


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("F @ Y @ F.T + W", True),
        ("keep @ X @ keep.T + K @ K.T", True),
        ("W + F[i] @ Y @ np.swapaxes(F[i], 1, 2)", True),
        ("np.exp(h) * F @ Y @ F.transpose(0, 2, 1) + W", True),
        ("V += take @ M @ take.T", True),
        ("F @ Y @ G.T + W", False),
        ("L @ L.T + W", False),
        ("A.T @ P + P @ A", False),
    ],
)
def test_what_is_written_by_hand_is_found(line, found):
    assert bool(steps(ast.walk(ast.parse(line)))) == found
