"""Operations, constants and helper functions in C."""

from collections.abc import Iterable

import numpy as np

from tustinnet.export.words import INFIX

# operations in C; all others are functions of math.h of the same name
FORMS = {
    **INFIX, "abs": "M(fabs)({})", "rem": "M(fmod)({}, {})",
    "max": "larger({}, {})", "min": "smaller({}, {})", "sign": "sign_of({})",
}  # fmt: skip
# functions of the file, each written where it is called
HELPERS = {
    "product": """
/* y = matrix x. The matrix lies column by column, so that the inner loop runs along memory;
   four columns at once read and write y a quarter as often. */
static void product(int rows, int columns, const model_real *restrict matrix,
                    const model_real *restrict x, model_real *restrict y)
{
    int j = 0;
    for (int i = 0; i < rows; i++)
        y[i] = R(0.0);
    for (; j + 4 <= columns; j += 4) {
        const model_real *c0 = matrix + j * rows, *c1 = c0 + rows, *c2 = c1 + rows, *c3 = c2 + rows;
        const model_real x0 = x[j], x1 = x[j + 1], x2 = x[j + 2], x3 = x[j + 3];
        for (int i = 0; i < rows; i++)
            y[i] = y[i] + c0[i] * x0 + c1[i] * x1 + c2[i] * x2 + c3[i] * x3;
    }
    for (; j < columns; j++) {
        const model_real *c = matrix + j * rows, x0 = x[j];
        for (int i = 0; i < rows; i++)
            y[i] += c[i] * x0;
    }
}
""",
    "copy": """
static void copy(int count, const model_real *from, model_real *to)
{
    for (int i = 0; i < count; i++)
        to[i] = from[i];
}
""",
    # unlike fmax and fmin, as in NumPy: NaN stays NaN
    "larger": """
static model_real larger(model_real a, model_real b)
{
    return a >= b || a != a ? a : b;
}
""",
    "smaller": """
static model_real smaller(model_real a, model_real b)
{
    return a <= b || a != a ? a : b;
}
""",
    "sign_of": """
static model_real sign_of(model_real a)
{
    return a > R(0.0) ? R(1.0) : a < R(0.0) ? R(-1.0) : a;
}
""",
}


def literal(value: float) -> str:
    """A constant in the precision of the C file, which defines `R` and `EITHER`."""
    with np.errstate(over="ignore", under="ignore"):
        single = float(np.float32(value))
    if np.isfinite(single) and (single != 0 or value == 0):
        return f"R({float(value)!r})"
    # beyond the range of float, where a suffix would be an error
    return f"EITHER({_plain(value)}, {'0.0f' if single == 0 else _plain(single)})"


def _plain(value: float) -> str:
    if np.isnan(value):
        return "(model_real)NAN"
    if np.isinf(value):
        return "(model_real)INFINITY" if value > 0 else "-(model_real)INFINITY"
    return repr(float(value))


def wrapped(items: Iterable[str]) -> str:
    """Items separated by commas on lines of at most about 100 characters."""
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) > 98:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return "\n".join([*lines, line.rstrip(",")])
