"""Formulas of a scene file: arithmetic in named coordinates, as functions for JAX.

A formula is read by Python's own parser and then only walked over: numbers, names,
``+ - * / **`` and a short list of functions. Nothing in it is ever executed as Python.
"""

import ast
import keyword
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import jax.numpy as jnp
from jaxtyping import Array

from ...geometry.rotations import about_axis
from ...geometry.small_linear import matmul
from .problems import suggestion

FUNCTIONS = {
    "sin": jnp.sin,
    "cos": jnp.cos,
    "tan": jnp.tan,
    "exp": jnp.exp,
    "log": jnp.log,
    "sqrt": jnp.sqrt,
    "tanh": jnp.tanh,
    "abs": jnp.abs,
}
CONSTANTS = {"pi": math.pi}
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_WRITTEN_OTHERWISE: dict[type[ast.AST], str] = {
    ast.BitXor: "write a power with **",
    ast.FloorDiv: "write a quotient with /",
    ast.Compare: "a formula has no conditions; write one smooth expression",
    ast.IfExp: "a formula has no conditions; write one smooth expression",
    ast.Attribute: "write functions and names without a dot: sin(x)",
}
_LONGEST = 2000
_COMMENT = re.compile(r"#[^\n]*")  # a formula holds no text in which # could stand
_MOST_NODES = 600  # walked over by recursion, far below Python's limit of its depth


class FormulaError(ValueError):
    """A formula that cannot be read.

    Attributes:
        problem: What is wrong.
        remedy: What to do.
        shift: The character at which it is wrong, counted from 0.
    """

    def __init__(self, problem: str, remedy: str, shift: int):
        """Say what is wrong, what to do, and where."""
        self.problem, self.remedy, self.shift = problem, remedy, shift
        super().__init__(f"{problem} — {remedy}")


@dataclass(frozen=True)
class Formula:
    """Expressions in named coordinates; equal texts are one function to JAX.

    Called with the coordinates one by one (scalars), and then, where there are any,
    a dictionary of parameters. One expression gives a scalar, several an array.

    Attributes:
        texts: The expressions.
        coordinates: Names of the coordinates, in the order of the call.
        parameters: Names of the parameters.
    """

    texts: tuple[str, ...]
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...] = ()

    def __call__(self, *arguments: Any) -> Array:
        """Values at a point."""
        names = dict(CONSTANTS)
        if self.parameters:
            names |= arguments[-1]
        point = arguments[: len(self.coordinates)]
        names |= zip(self.coordinates, point, strict=True)
        values = [
            _evaluated(parse(text, self.coordinates, self.parameters), names)
            for text in self.texts
        ]
        like = jnp.asarray(point[0])  # a constant expression is a Python number
        values = [jnp.asarray(value, like.dtype) for value in values]
        return values[0] if len(values) == 1 else jnp.stack(values)

    def __repr__(self) -> str:
        """The expressions as they were written."""
        return ", ".join(repr(text) for text in self.texts)


@dataclass(frozen=True)
class ArrayFormula:
    """Formulas of one array of coordinates, as an array of any shape.

    Attributes:
        formula: The expressions, in the array's order.
        shape: Of the result.
    """

    formula: Formula
    shape: tuple[int, ...]

    def __call__(self, coordinates: Array, parameters: Any = None) -> Array:
        """Values at a scalar, or at coordinates of shape (n,)."""
        point = coordinates if coordinates.ndim else coordinates[None]
        values = self.formula(*point, parameters)
        return jnp.reshape(values, self.shape)


@dataclass(frozen=True)
class ForceFormula:
    """Generalized forces ``force(t, alpha, alpha_dot)`` by formulas.

    Attributes:
        formula: One expression for each coordinate, in t, coordinates and rates.
    """

    formula: Formula

    def __call__(
        self, t: Array, alpha: Array, alpha_dot: Array, parameters: Any = None
    ) -> Array:
        """Values at a time."""
        values = self.formula(t, *alpha, *alpha_dot, parameters)
        return jnp.reshape(values, (len(self.formula.texts),))


@dataclass(frozen=True)
class TurnsFormula:
    """A rotation by turns about x, y or z whose angles [rad] are formulas.

    Attributes:
        axes: Of the turns; their matrices multiply from left to right.
        formula: One angle for each.
    """

    axes: tuple[str, ...]
    formula: Formula

    def __call__(self, coordinates: Array, parameters: Any = None) -> Array:
        """Rotation matrix at a scalar, or at coordinates of shape (n,)."""
        point = coordinates if coordinates.ndim else coordinates[None]
        result = jnp.eye(3, dtype=point.dtype)
        if not self.axes:
            return result
        angles = jnp.reshape(self.formula(*point, parameters), (len(self.axes),))
        for axis, angle in zip(self.axes, angles, strict=True):
            result = matmul(result, about_axis("xyz".index(axis), angle))
        return result


def is_name(text: str) -> bool:
    """Whether a formula can hold a text as the name of a number."""
    return text.isidentifier() and text.isascii() and not keyword.iskeyword(text)


def parse(
    text: str, coordinates: tuple[str, ...], parameters: tuple[str, ...] = ()
) -> ast.expr:
    """Read an expression and refuse everything that is not arithmetic.

    Args:
        text: The expression, for example ``0.3*x**2 + 0.1*sin(y)``, of one line or
            of several; a comment (``#``) goes to the end of its line.
        coordinates: Names that stand for coordinates.
        parameters: Names that stand for parameters.

    Returns:
        Its syntax tree, of numbers, names, operators and known functions only.

    Raises:
        FormulaError: with the place, and what to write instead.
    """
    if len(text) > _LONGEST:
        raise FormulaError(
            f"has more than {_LONGEST} characters", "shorten it", _LONGEST
        )
    # a comment ends at its line, which is lost below; characters keep their places
    bare = _COMMENT.sub(lambda found: " " * len(found[0]), text)
    one_line = bare.replace("\n", " ")
    lead = len(one_line) - len(one_line.lstrip())
    try:
        tree = ast.parse(one_line.strip(), mode="eval").body
    except SyntaxError as error:
        # an expression that ends too early has no offset, or one behind its end
        shift = lead + error.offset - 1 if error.offset else len(text)
        raise FormulaError(
            f"cannot be read ({error.msg})",
            "write arithmetic, for example 0.3*x**2 + 0.1*sin(y)",
            min(shift, max(len(text) - 1, 0)),
        ) from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise FormulaError("cannot be read", "shorten it", 0) from error
    if sum(1 for _ in ast.walk(tree)) > _MOST_NODES:
        raise FormulaError("has too many terms", "shorten it", 0)
    reader = _Reader(one_line, lead, coordinates, parameters)
    reader.check(tree)
    reader.constant(tree)
    return tree


@dataclass(frozen=True)
class _Reader:
    """Refuses, with its place, every node that is not arithmetic."""

    text: str
    lead: int
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]

    def refuse(self, node: ast.AST, problem: str, remedy: str) -> NoReturn:
        """Raise, pointing at a node."""
        # the parser counts bytes of UTF-8, a caret needs characters
        encoded = self.text.strip().encode()[: getattr(node, "col_offset", 0)]
        shift = self.lead + len(encoded.decode(errors="ignore"))
        raise FormulaError(problem, remedy, shift)

    def check(self, node: ast.AST) -> None:
        """Refuse a node, or anything below it, that is not arithmetic."""
        match node:
            case ast.Constant():
                self.check_number(node)
            case ast.Name():
                self.check_name(node)
            case ast.BinOp() if type(node.op) in _OPERATORS:
                self.check(node.left)
                self.check(node.right)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                self.check(node.operand)
            case ast.Call():
                self.check_call(node)
            case _:
                odd = node.op if isinstance(node, ast.BinOp) else node
                remedy = _WRITTEN_OTHERWISE.get(
                    type(odd),
                    "use numbers, names, + - * / ** and the functions "
                    + ", ".join(FUNCTIONS),
                )
                self.refuse(node, "holds something that is not arithmetic", remedy)

    def check_number(self, node: ast.Constant) -> None:
        """Refuse text, truth values, complex and infinite numbers."""
        value = node.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.refuse(node, f"holds {value!r}, not a number", "write a real number")
        try:
            finite = math.isfinite(float(value))
        except OverflowError:
            finite = False
        if not finite:
            self.refuse(node, "holds a number too large", "write a smaller one")

    def check_name(self, node: ast.Name) -> None:
        """Refuse names that stand for nothing."""
        known = (*self.coordinates, *self.parameters, *CONSTANTS)
        if node.id in FUNCTIONS:
            remedy = f"write its argument: {node.id}(...)"
            self.refuse(node, f"names the function {node.id} alone", remedy)
        if node.id not in known:
            self.refuse(
                node,
                f"holds an unknown name {node.id}",
                suggestion(node.id, known)
                + "; a parameter of your own goes into parameters = {...}",
            )

    def check_call(self, node: ast.Call) -> None:
        """Refuse all calls but those of a known function with one argument."""
        name = node.func.id if isinstance(node.func, ast.Name) else None
        if name is None:
            self.refuse(
                node,
                "calls something that is not a function",
                "write products with *, and functions without a dot: sin(x)",
            )
        if name not in FUNCTIONS:
            known = name in (*self.coordinates, *self.parameters, *CONSTANTS)
            self.refuse(
                node,
                f"calls {name}, which is not a known function",
                "write a product with *" if known else suggestion(name, FUNCTIONS),
            )
        alone = len(node.args) == 1 and not node.keywords
        if not alone or isinstance(node.args[0], ast.Starred):
            self.refuse(
                node, f"gives {name} other than one argument", f"write {name}(...)"
            )
        self.check(node.args[0])

    def constant(self, node: ast.AST) -> float | None:
        """The value of a checked part that is the same everywhere; None: it is not.

        Refuses what is not a finite real number: a root of a negative number, a
        quotient by zero. (Of other parts JAX makes NaN at run time.)
        """
        match node:
            case ast.Constant(value=int() | float() as value):
                return float(value)
            case ast.Name(id=name):
                return CONSTANTS.get(name) if name not in self.parameters else None
            case ast.UnaryOp():
                parts = [node.operand]
            case ast.BinOp():
                parts = [node.left, node.right]
            case ast.Call():
                parts = list(node.args)
            case _:
                raise AssertionError(f"unchecked formula node {type(node).__name__}")
        values = [x for x in map(self.constant, parts) if x is not None]
        if len(values) < len(parts):
            return None
        try:
            value = _of_constants(node, values)
        except (ArithmeticError, ValueError):
            value = math.nan
        if isinstance(value, complex) or not math.isfinite(value):
            text = ast.unparse(node)
            self.refuse(
                node,
                f"holds {text}, which is not a finite real number",
                "leave it out, or check its signs and brackets",
            )
        return value


def _of_constants(node: ast.AST, values: list[float]) -> Any:
    """An operation on numbers, as Python does it."""
    if isinstance(node, ast.UnaryOp):
        return -values[0] if isinstance(node.op, ast.USub) else values[0]
    if isinstance(node, ast.BinOp):
        return _OPERATORS[type(node.op)](*values)
    assert isinstance(node, ast.Call)
    name = getattr(node.func, "id", "")
    return abs(values[0]) if name == "abs" else getattr(math, name)(values[0])


def _evaluated(node: ast.AST, names: dict[str, Any]) -> Any:
    match node:
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name():
            return names[node.id]
        case ast.UnaryOp():
            value = _evaluated(node.operand, names)
            return -value if isinstance(node.op, ast.USub) else value
        case ast.BinOp():
            left = _evaluated(node.left, names)
            right = _evaluated(node.right, names)
            if isinstance(node.op, ast.Pow) and isinstance(right, float):
                # a whole power is a product, defined and smooth at negative bases too
                right = int(right) if right.is_integer() and abs(right) < 64 else right
            return _OPERATORS[type(node.op)](left, right)
        case ast.Call(func=ast.Name(id=name)):
            return FUNCTIONS[name](_evaluated(node.args[0], names))
        case _:
            raise AssertionError(f"unchecked formula node {type(node).__name__}")
