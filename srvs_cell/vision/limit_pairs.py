"""Limits that come in pairs: a least value above its greatest one excludes everything, and nothing would say so."""

from __future__ import annotations


def check_pairs(parameters: object, *pairs: tuple[str, str], equal: bool = False) -> None:
    """Refuse parameters whose least value is not less than the greatest one.

    Args:
        parameters: what has the limits as attributes.
        pairs: names of a least and a greatest value.
        equal: whether both may be the same.

    Raises:
        ValueError: naming both keys with their values, what that means and what to do.
    """
    for low, high in pairs:
        least, greatest = getattr(parameters, low), getattr(parameters, high)
        if least > greatest or (least == greatest and not equal):
            raise ValueError(
                f"{low} = {least:g} is not {'at most' if equal else 'less than'} {high} = {greatest:g}: nothing lies "
                "between them, "
                f"lower {low} or raise {high}"
            )
