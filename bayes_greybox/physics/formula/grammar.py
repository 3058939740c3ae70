"""The grammar of formulas: Python's own, cut down to a whitelist and turned into SymPy part by part.

Nothing here executes text. `ast` (expression mode) splits a formula into its parts, and every part outside
the whitelist is refused by name.
"""

import ast
import keyword
import math
import operator
import threading
import unicodedata
import warnings
from collections.abc import Iterable
from contextlib import suppress
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache
from itertools import accumulate
from typing import Any, NoReturn

import numpy as np
import sympy

from bayes_greybox.running.errors import InputError

from .functions import ALIASES, CONSTANTS, FUNCTIONS, NODE_CLASSES, Function

MAX_LENGTH, MAX_DEPTH, MAX_EXPONENT, MAX_NUMBER = 2000, 50, 100, 1e300

_MAX_BITS, _MAX_ROOT = 512, 1000
"""Longer exact fractions are replaced by their floating-point values; higher roots are taken in floating point."""

REMEMBERED_FORMULAS = 4096
"""Size of caches: a study reads the same formulas along every path, and each takes milliseconds."""

FUNCTION_LIST = ", ".join(FUNCTIONS)
"""The known functions, for messages."""

_QUIET = threading.Lock()
"""Lock of the filters of warnings, which all threads share, while a formula is parsed."""

_BINARY = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
_REFUSED = {
    ast.Attribute: "a dot after a name is not allowed; write functions without a prefix, such as sin(y)",
    ast.Subscript: "indexing is not allowed; give the column a name of its own",
    ast.Compare: "comparisons are not allowed; use heaviside(...), which is 1 above zero and 0 below",
    ast.BoolOp: "'and' and 'or' are not allowed; use products of heaviside(...)",
    ast.IfExp: "'if' is not allowed; use heaviside(...), min(...) or max(...)",
    ast.Lambda: "'lambda' is not allowed; write the formula itself",
    ast.NamedExpr: "assignment is not allowed; write the formula itself",
    ast.Tuple: "a comma is allowed only between the arguments of a function; write a decimal point as '.'",
    ast.Starred: "'*' must stand between two factors",
    ast.JoinedStr: "text in quotes is not allowed; write column names without quotes",
}


@lru_cache(REMEMBERED_FORMULAS)
def read(text: str, names: tuple[str, ...] | None) -> sympy.Expr:
    """Read a formula; see `expressions.parse_expression`."""
    text = _clean(text)
    expr = _Builder(text, names).build(_syntax_tree(text), 0)
    if expr.has(sympy.zoo, sympy.nan):
        # Its parts may be finite one by one, as 0**(y**y) and its inverse.
        raise InputError(f"{_shown(text)} contains a number that is not finite; check its constants.")
    if expr.has(sympy.I):
        # SymPy may notice it only when it takes a root apart that is within another one.
        raise InputError(f"{_shown(text)} contains the root of a negative number; take abs(...) of it.")
    return expr


def symbol(name: str) -> sympy.Symbol:
    """Return the SymPy symbol that stands for a column: real, so that sqrt(y**2) is |y|."""
    return sympy.Symbol(name, real=True)


def check_name(name: str) -> str:
    """Return a column name unchanged, or refuse one that formulas cannot use."""
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"{name!r} cannot be used as a column name in formulas; rename it to letters, digits and '_', "
            "starting with a letter, such as 'tank_1'."
        )
    if unicodedata.normalize("NFKC", name) != name:
        raise InputError(
            f"The column name {name!r} has characters that formulas cannot tell apart from others; "
            f"rename it to {unicodedata.normalize('NFKC', name)!r}."
        )
    if name in FUNCTIONS or name in CONSTANTS:
        raise InputError(f"The column name {name!r} is taken by a function or constant; rename the column.")
    return name


def check_known(used: Iterable[str], names: Iterable[str], formula: str | sympy.Expr) -> None:
    """Refuse names in a formula that are not columns."""
    known = tuple(names)
    for name in sorted(set(used) - set(known)):
        odd = [c for c in name if ord(c) > 127]
        shown = f"{name!r}" + (f", with {_named(odd[0])}" if odd else "")
        hint = _did_you_mean(get_close_matches(name, (*known, *CONSTANTS), n=3, cutoff=0.6))
        listed = ", ".join(known) or "none"
        raise InputError(f"{_shown(str(formula))} uses the unknown name {shown}; known names: {listed}.{hint}")


def check_size(expr: sympy.Expr, text: str) -> None:
    """Refuse powers and numbers beyond the limits in the outermost part of an expression."""
    parts: tuple[Any, ...] = (expr, *expr.args)
    for node in parts:
        if isinstance(node, sympy.Pow) and node.exp.is_Number and abs(float(node.exp)) > MAX_EXPONENT:
            raise InputError(f"{_shown(text)} reaches a power of {node.exp}; exponents go up to {MAX_EXPONENT}.")
        if node.is_Number and not _finite(float(node)) or node in (sympy.zoo, sympy.nan):
            raise InputError(f"{_shown(text)} contains a number that is not finite; check its constants.")
        if node.is_Number and not node.is_zero and float(node) == 0.0:
            # SymPy's numbers go on where those of the computer end, and would be printed as zero.
            raise InputError(f"{_shown(text)} contains a number too small to tell from zero; check its constants.")


def _clean(text: str) -> str:
    """Refuse text that is too long, too deep or would be misread, before any parsing."""
    if len(text) > MAX_LENGTH:
        raise InputError(
            f"A formula has {len(text)} characters, starting with {text[:30]!r}; {MAX_LENGTH} is the limit: "
            "split it into several terms."
        )
    text = unicodedata.normalize("NFC", " ".join(text.split()))
    if not text:
        raise InputError("A formula is empty; write for example 'y**2'.")
    for position, char in enumerate(text):
        plain = unicodedata.normalize("NFKC", char)
        if char in "'\"`":
            raise InputError(f"{_shown(text)}: {_REFUSED[ast.JoinedStr]}.")
        if plain != char:
            power = unicodedata.category(char) == "No" and plain.isdigit()
            remedy = f"**{plain}" if power else plain
            raise InputError(f"{_shown(text)}: {_named(char)} cannot be read; write {remedy!r}.")
        if char in "#\\\0;" or not (char.isprintable()):
            raise InputError(f"{_shown(text)}: {_named(char)} at position {position + 1} must be removed.")
    if max(accumulate((char in "([{") - (char in ")]}") for char in text)) > MAX_DEPTH:
        raise InputError(f"{_shown(text)} is nested more than {MAX_DEPTH} levels deep; simplify it.")
    return text


def _syntax_tree(text: str) -> ast.expr:
    try:
        with _QUIET, warnings.catch_warnings(record=True):
            return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        position = min(max(error.offset or 1, 1), len(text))
        raise InputError(
            f"{_shown(text)} is not a complete formula: it cannot be read at position {position}, "
            f"at {text[position - 1 : position + 19]!r}; check operators ('2*y', not '2y') and parentheses."
        ) from None
    except (RecursionError, MemoryError, ValueError):
        raise InputError(f"{_shown(text)} is too deeply nested; simplify it.") from None


class _Builder:
    """Turns the parts of one formula into SymPy, refusing every part that is not on the list."""

    def __init__(self, text: str, names: tuple[str, ...] | None):
        self.text = text
        self.names = names

    def build(self, node: ast.expr, depth: int) -> sympy.Expr:
        if depth > MAX_DEPTH:
            self.refuse(f"is nested more than {MAX_DEPTH} levels deep; simplify it")
        if isinstance(node, ast.Constant):
            return self.number(node)
        if isinstance(node, ast.Name):
            return self.name(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
            inner = self.build(node.operand, depth + 1)
            return -inner if isinstance(node.op, ast.USub) else inner
        if isinstance(node, ast.BinOp):
            return self.binary(node, depth)
        if isinstance(node, ast.Call):
            return self.call(node, depth)
        reason = _REFUSED.get(type(node), f"only formulas are allowed: numbers, columns, {FUNCTION_LIST}")
        self.refuse(f"contains {self.piece(node)}: {reason}")

    def number(self, node: ast.Constant) -> sympy.Expr:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(f"contains {str(value)[:60]!r}, which is not a real number")
        if not _finite(value):
            self.refuse("contains a number that is too large; change the unit of a column")
        return sympy.Integer(value) if isinstance(value, int) else _from_float(value)

    def name(self, name: str) -> sympy.Expr:
        if name in CONSTANTS:
            return CONSTANTS[name]
        if name in FUNCTIONS:
            self.refuse(f"uses the function {name!r} without an argument; write {name}(...)")
        if self.names is None:
            return symbol(check_name(name))
        check_known([name], self.names, self.text)
        return symbol(name)

    def binary(self, node: ast.BinOp, depth: int) -> sympy.Expr:
        # A long sum leans to the left: walk down that side in a loop, so that only nesting counts as depth.
        spine: list[ast.BinOp] = []
        left: ast.expr = node
        while isinstance(left, ast.BinOp):
            if type(left.op) not in (*_BINARY, ast.Pow):
                remedy = "write powers with '**'" if isinstance(left.op, ast.BitXor) else "use + - * / **"
                self.refuse(f"contains {self.piece(left)} with an operator that is not available; {remedy}")
            spine.append(left)
            left = left.left
        result = self.build(left, depth + 1)
        for part in reversed(spine):
            result = self.combine(type(part.op), result, self.build(part.right, depth + 1))
        return result

    def combine(self, kind: type[ast.operator], a: sympy.Expr, b: sympy.Expr) -> sympy.Expr:
        if kind is ast.Pow:
            return self.power(a, b)
        if kind is ast.Div and _number_value(b) == 0.0:
            self.refuse("divides by zero")
        return self.checked(_BINARY[kind](a, b))

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
        value_base, value = _number_value(base), _number_value(exponent)
        if value is None:
            if any(not power.exp.is_number for power in exponent.atoms(sympy.Pow)):
                # SymPy looks long for the signs of such towers, and no law has them.
                self.refuse("has columns in the exponent of an exponent; write exp(...) for a law that is one")
            return self.real(base**exponent)
        if abs(value) > MAX_EXPONENT:
            self.refuse(f"has an exponent of {value:g}; exponents go up to {MAX_EXPONENT}")
        if isinstance(exponent, sympy.Float):
            exact = sympy.Rational(*Fraction(value).limit_denominator(_MAX_ROOT).as_integer_ratio())
            exponent = exact if float(exact) == value else exponent
        elif exponent.is_Rational and sympy.fraction(exponent)[1] > _MAX_ROOT:
            # SymPy looks for exact roots, for the 29²⁰th one until there is no memory left.
            exponent = _from_float(value)
        if value_base is None:
            whole: Any = base
            if base.atoms(sympy.Float):
                # SymPy takes roots of numbers apart, and beside a tiny or huge decimal never finishes.
                roots = {root: _from_float(float(root)) for root in base.atoms(sympy.Pow) if root.is_number}
                whole = base.xreplace(roots)
            return self.real(whole**exponent)
        try:
            result = value_base**value
        except (OverflowError, ZeroDivisionError):
            result = math.inf
        if isinstance(result, complex) or not _finite(result):
            self.refuse(f"contains a power ({value_base:g})**({value:g}) that is not a finite real number")
        if result == 0 and value_base != 0:
            self.refuse("contains a number too small to tell from zero; check its constants")
        # Beside roots SymPy would look for common factors of a decimal, and may never finish. Each further storey of a
        # tower of powers would be evaluated with all those below it, again and again.
        decimal_beside_roots = base.atoms(sympy.Float) and not base.is_Float
        bits = max(int(part).bit_length() for part in sympy.fraction(base)) if base.is_Rational else 0
        too_long = bits * max(abs(value), 1.0) > _MAX_BITS
        if decimal_beside_roots or exponent.atoms(sympy.Pow) or too_long:
            return _from_float(result)
        return self.checked(base**exponent)

    def real(self, power: sympy.Expr) -> sympy.Expr:
        # SymPy takes factors out of a power, and the root of a negative one has an imaginary part, or is one that it
        # leaves as it stands, as (-1)**(3/250).
        roots = (root for root in power.atoms(sympy.Pow) if root.is_number)
        if power.has(sympy.I) or any(root.is_extended_real is False for root in roots):
            self.refuse("raises a negative number to a power that is not whole; take abs(...) of it")
        return self.checked(power)

    def call(self, node: ast.Call, depth: int) -> sympy.Expr:
        if not isinstance(node.func, ast.Name):
            self.build(node.func, depth + 1)
            self.refuse("has a parenthesis right after another; write '*' between the factors")
        name = node.func.id
        if name not in FUNCTIONS:
            if name in CONSTANTS or (self.names is not None and name in self.names):
                self.refuse(f"uses {name!r} as a function; write {name}*(...) for a product")
            near = [ALIASES[name]] if name in ALIASES else get_close_matches(name, FUNCTIONS, n=2, cutoff=0.6)
            self.refuse(f"calls the unknown function {name!r}; known: {FUNCTION_LIST}", _did_you_mean(near))
        if node.keywords:
            self.refuse(f"names an argument of {name}; write {name}(...) with plain arguments")
        function = FUNCTIONS[name]
        low, high = function.arity
        if not low <= len(node.args) <= high:
            wanted = f"{low}" if low == high else f"{low} to {high}"
            self.refuse(f"gives {name} {len(node.args)} arguments; it takes {wanted}")
        args = [self.build(arg, depth + 1) for arg in node.args]
        numbers = [value for arg in args if (value := _number_value(arg)) is not None]
        if len(numbers) == len(args):
            with np.errstate(all="ignore"):
                result = float(function.array(np, *numbers))
            if not _finite(result):
                shown = ", ".join(f"{v:g}" for v in numbers)
                self.refuse(f"contains {name}({shown}), which is not a finite real number")
        return self.checked(_apply(function, args))

    def piece(self, node: ast.expr) -> str:
        return repr((ast.get_source_segment(self.text, node) or self.text)[:60])

    def checked(self, expr: sympy.Expr) -> sympy.Expr:
        check_size(expr, self.text)
        return expr

    def refuse(self, reason: str, hint: str = "") -> NoReturn:
        raise InputError(f"{_shown(self.text)} {reason}.{hint}")


def _apply(function: Function, args: list[sympy.Expr]) -> sympy.Expr:
    """Let SymPy simplify the call, unless its answer leaves the whitelist."""
    with suppress(ValueError, TypeError):
        result = function.symbolic(*args, evaluate=True)
        if all(isinstance(n, NODE_CLASSES) for n in sympy.preorder_traversal(result)):
            return result
    return function.symbolic(*args, evaluate=False)


def _number_value(expr: sympy.Expr) -> float | None:
    """Return the value of an expression without symbols, None for the others."""
    if expr.is_Number:
        return float(expr)
    return float(expr.evalf()) if expr.is_number else None


def _from_float(value: float) -> sympy.Expr:
    # Whole numbers stay whole, so that y**2.0 is y**2.
    return sympy.Integer(int(value)) if value.is_integer() and abs(value) < 2**53 else sympy.Float(value)


def _finite(value: float | int) -> bool:
    return abs(value) <= MAX_NUMBER


def _shown(text: str) -> str:
    return f"The formula {text if len(text) <= 80 else text[:77] + '...'!r}"


def _named(char: str) -> str:
    return f"the character {char!r} (U+{ord(char):04X} {unicodedata.name(char, 'unnamed')})"


def _did_you_mean(near: list[str]) -> str:
    return f" Did you mean {' or '.join(near)}?" if near else ""
