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

static void copy(int count, const model_real *from, model_real *to)
{
    for (int i = 0; i < count; i++)
        to[i] = from[i];
}

static model_real larger(model_real a, model_real b)
{
    return a >= b || a != a ? a : b;
}

static model_real smaller(model_real a, model_real b)
{
    return a <= b || a != a ? a : b;
}

static model_real sign_of(model_real a)
{
    return a > R(0.0) ? R(1.0) : a < R(0.0) ? R(-1.0) : a;
}
