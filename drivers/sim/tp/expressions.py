"""Reads operands, conditions and arithmetic from tokens, as strictly as the controller's editor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.sim.tp.syntax import Argument, Binary, Constant, Element, Expression, Not, Register, Signal, Variable

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.sim.tp.lexer import Token

SIGNALS: Final = frozenset({"DO", "DI", "RO", "RI", "SI", "SO", "UI", "UO", "F"})
COMPARISONS: Final = frozenset({"=", "<>", "<", ">", "<=", ">="})
_SUMS: Final = frozenset({"+", "-"})
_PRODUCTS: Final = frozenset({"*", "/", "DIV", "MOD"})
_STATES: Final = {"ON": True, "OFF": False}
_ELEMENTS: Final = 6


class Reader:
    """Walks through the tokens of one statement; every refusal is a ValueError that says why."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens, self._at = tokens, 0

    @property
    def next(self) -> Token:
        """The token that comes."""
        return self._tokens[self._at]

    @property
    def following(self) -> Token:
        """The token after that."""
        return self._tokens[min(self._at + 1, len(self._tokens) - 1)]

    def take(self) -> Token:
        """Return the token that comes and go past it."""
        token = self.next
        self._at = min(self._at + 1, len(self._tokens) - 1)
        return token

    def has(self, text: str) -> bool:
        """Go past a token with this text, if it comes; return whether it did."""
        found = self.next.text == text
        if found:
            self.take()
        return found

    def expect(self, text: str) -> None:
        """Go past a token with this text."""
        if not self.has(text):
            raise ValueError(f"expected {text!r}, found {self.next.text!r}")

    def index(self) -> int:
        """Go past ``[n]`` and return n."""
        token = self.take()
        if len(token.numbers) != 1:
            raise ValueError(f"expected a number in brackets, found {token.text!r}")
        return token.numbers[0]

    def element(self) -> Element:
        """Go past ``[n,m]`` of a position register and return it."""
        token = self.take()
        if len(token.numbers) != 2 or not 1 <= token.numbers[1] <= _ELEMENTS:  # noqa: PLR2004 - index and element
            raise ValueError(f"PR{token.text} is no element of a position register")
        return Element(*token.numbers)

    def word(self) -> str:
        """Go past a word and return it."""
        token = self.take()
        if token.kind != "word":
            raise ValueError(f"expected a name, found {token.text!r}")
        return token.text

    def number(self) -> float:
        """Go past a number and return it."""
        token = self.take()
        if token.kind != "number":
            raise ValueError(f"expected a number, found {token.text!r}")
        return float(token.text) if "." in token.text else int(token.text)

    def end(self) -> None:
        """Nothing may follow."""
        if self.next.kind != "end":
            raise ValueError(f"{self.next.text!r} is not understood here")

    def operand(self) -> Expression:
        """Read a constant, register, argument, signal, position element or system variable."""
        if self.next.kind == "number":
            return Constant(self.number())
        if self.has("("):  # only as a negative number
            self.expect("-")
            value = self.number()
            self.expect(")")
            return Constant(-value)
        word = self.word()
        if word in _STATES:
            return Constant(_STATES[word])
        if word.startswith("$"):
            return Variable(word + (self.take().text if self.next.kind == "index" else ""))
        if word == "PR":
            return self.element()
        if word == "R":
            return Register(self.index())
        if word == "AR":
            return Argument(self.index())
        if word in SIGNALS:
            return Signal(word, self.index())
        raise ValueError(f"{word!r} is no value that the interpreter knows")

    def value(self) -> Expression:
        """Read what is assigned: mixed logic in parentheses, or one operand, or two with one operator."""
        if self._mixed_begins():
            return self._mixed()
        left = self.operand()
        if self.next.text in _SUMS | _PRODUCTS:
            return Binary(self.take().text, left, self.operand())
        return left

    def condition(self) -> Expression:
        """Read a condition: mixed logic in parentheses, or one comparison."""
        if self._mixed_begins():
            return self._mixed()
        left = self.operand()
        if self.next.text not in COMPARISONS:
            raise ValueError(f"expected a comparison, found {self.next.text!r}")
        condition = Binary(self.take().text, left, self.operand())
        if self.next.text in {"AND", "OR"}:
            raise ValueError("several conditions are written in parentheses here (mixed logic)")
        return condition

    def _mixed_begins(self) -> bool:
        return self.next.text == "(" and self.following.text != "-"

    def _mixed(self) -> Expression:
        self.expect("(")
        expression = self._chain({"OR"}, lambda: self._chain({"AND"}, self._comparison))
        self.expect(")")
        return expression

    def _comparison(self) -> Expression:
        left = self._sum()
        return Binary(self.take().text, left, self._sum()) if self.next.text in COMPARISONS else left

    def _sum(self) -> Expression:
        return self._chain(_SUMS, lambda: self._chain(_PRODUCTS, self._factor))

    def _factor(self) -> Expression:
        if self.has("!"):
            return Not(self._factor())
        return self._mixed() if self._mixed_begins() else self.operand()

    def _chain(self, operators: frozenset[str] | set[str], part: Callable[[], Expression]) -> Expression:
        left = part()
        while self.next.text in operators:
            left = Binary(self.take().text, left, part())
        return left
