"""A bound is printed on its own side: rounded to the nearest number it may say more than is proven."""

import ast

import pytest

from sampling_design.records.declarations import BOUNDS
from tests.house.sources import SOURCES, nodes

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs


def named(value):
    """The name of what is printed: that of x in x[k], min(x), x.min() and a.x."""
    while True:
        match value:
            case ast.Subscript(value=inner) | ast.Call(func=ast.Attribute(value=inner, attr="min" | "max"), args=[]):
                value = inner
            case ast.Call(func=ast.Name(id="min" | "max" | "float"), args=[inner]):
                value = inner
            case ast.Attribute(attr=name) | ast.Name(id=name):
                return name
            case _:
                return ""


def nearest(inside):
    """The bounds, by their names, that are printed as the number nearest to them."""
    printed = [
        node.args[0] if type(node) is ast.Call else node.value
        for node in inside
        if (type(node) is ast.FormattedValue and node.format_spec and type(node.value) is not ast.Name)
        or (type(node) is ast.Call and getattr(node.func, "id", "") == "short" and not (node.args[2:] + node.keywords))
    ]
    return [ast.unparse(value) for value in printed if named(value) in BOUNDS]


def test_a_bound_is_found_by_its_name_wherever_it_stands():
    text = "f'{self.lower[k]:.3g} {upper} {x.t:.3g}', short(min(found.upper)), short(lam, 4), short(lam, up=True)"
    assert nearest(ast.walk(ast.parse(text))) == ["min(found.upper)", "lam", "self.lower[k]"]


def test_no_bound_is_printed_as_the_nearest_number():
    found = {str(path): printed for path in SOURCES if (printed := nearest(nodes(path)))}
    assert found == {}, "`above` and `below` print bounds"
