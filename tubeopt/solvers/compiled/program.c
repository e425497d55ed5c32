/* Least squares with linear inequalities as a shared library, for Python. */
#include <stdlib.h>
#include <string.h>
#include "quadratic.c"

/* Of n variables with `rows` inequalities: `memory` has a matrix (count, n), what it is to be closest to (count), rows
   (rows, n), their bounds (rows), and room for as many numbers. x (n) and the numbers of the active rows, of which there
   are as many as it returns; -1 where no x keeps the rows. */
CASADI_SYMBOL_EXPORT int constrained(long long n, long long count, long long rows, double *memory, double *x,
                                     long long *active) {
    double *right = memory + n * count, *first = right + count, *bounds = first + n * rows;
    Quadratic q = {first, bounds, bounds + rows, (int)n, (int)rows, {0}, 0};
    if (!least_squares(&q, (int)count, memory, right, x)) return -1;
    for (int k = 0; k < q.actives; k++) active[k] = q.active[k];
    return q.actives;
}
