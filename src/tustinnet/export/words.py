"""Operations of programs in languages with the operators of C."""

from collections.abc import Sequence

INFIX = {
    "add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "neg": "-{}",
    "lt": "{} < {}", "le": "{} <= {}", "gt": "{} > {}", "ge": "{} >= {}", "eq": "{} == {}",
    "ne": "{} != {}", "and": "{} && {}", "or": "{} || {}", "not": "!{}", "select": "{} ? {} : {}",
}  # fmt: skip


def apply_form(form: str | None, function: str, operands: Sequence[str]) -> str:
    """An operation as text: its form with the operands in it, or the call of a function."""
    return f"{function}({', '.join(operands)})" if form is None else form.format(*operands)
