/* Least squares with linear inequalities in few variables: by a triangle a quadratic program of least distance, and that
   by the dual method of Goldfarb and Idnani, Math. Programming 27 (1983), with the active rows factored anew at each change:
   of few variables that costs less than to update factors, and rounding does not add up. */

#define MOST_VARIABLES (2 * N)
#define MOST_EXCHANGES 100
#define FEASIBLE 1e-9       /* by which a row that is 0 may miss its bound */
#define ROUND_OFF_ROW 1e-14 /* of the longest row: a shorter one is 0 */

/* rows x >= bounds, (count, n) and (count), with what each is pushed by; numbers of the rows that are active. */
typedef struct {
    double *rows, *bounds, *multipliers;
    int n, count, active[MOST_VARIABLES], actives;
} Quadratic;

/* matrix (count, n) = Q R by reflections: R in its upper triangle, the first n of Q' right in `right`; 0 where columns
   depend on each other. */
static int triangle(int n, int count, double *matrix, double *right) {
    for (int k = 0; k < n; k++) {
        double square = 0, head = matrix[k * n + k], length;
        for (int r = k; r < count; r++) square += matrix[r * n + k] * matrix[r * n + k];
        length = head > 0 ? -sqrt(square) : sqrt(square);
        if (!(square > 0)) return 0;
        matrix[k * n + k] = head - length; /* v, for which v'v / 2 = length (length - head) */
        for (int c = k + 1; c <= n; c++) {
            double *column = c < n ? matrix + c : right, part = 0;
            int stride = c < n ? n : 1;
            for (int r = k; r < count; r++) part += matrix[r * n + k] * column[r * stride];
            part /= length * (length - head);
            for (int r = k; r < count; r++) column[r * stride] -= part * matrix[r * n + k];
        }
        matrix[k * n + k] = length;
    }
    return 1;
}

/* x <- R^-1 y, R the upper triangle of `matrix` in rows of n. */
static void solve_upper(int n, const double *matrix, const double *y, double *x) {
    for (int i = n - 1; i >= 0; i--) {
        x[i] = y[i];
        for (int j = i + 1; j < n; j++) x[i] -= matrix[i * n + j] * x[j];
        x[i] /= matrix[i * n + i];
    }
}

/* Of a row: what the active rows leave of it, `along` (n), and its coefficients `by` in them, by least squares. */
static void split_row(const Quadratic *q, const double *row, double *along, double *by) {
    double columns[MOST_VARIABLES * MOST_VARIABLES], right[MOST_VARIABLES];
    int n = q->n, m = q->actives;
    for (int k = 0; k < m; k++)
        for (int c = 0; c < n; c++) columns[c * m + k] = q->rows[n * q->active[k] + c];
    memcpy(right, row, n * sizeof(double));
    memcpy(along, row, n * sizeof(double));
    triangle(m, n, columns, right); /* active rows are independent */
    solve_upper(m, columns, right, by);
    for (int k = 0; k < m; k++)
        for (int c = 0; c < n; c++) along[c] -= by[k] * q->rows[n * q->active[k] + c];
}

/* The row that is violated most, of unit length, by more than `most`; -1 where none is. */
static int worst_row(const Quadratic *q, const double *x, double most) {
    int worst = -1;
    for (int r = 0; r < q->count; r++) {
        double missed = q->bounds[r] - dot(q->rows + q->n * r, x, q->n);
        if (missed <= most) continue;
        most = missed;
        worst = r;
    }
    return worst;
}

/* The rows made of unit length; those that are 0 but for round-off say nothing of x: 0 where x = 0 does not keep them. */
static int unit_rows(Quadratic *q) {
    double longest = 0;
    for (int r = 0; r < q->count; r++) {
        double *own = q->rows + q->n * r;
        q->multipliers[r] = sqrt(dot(own, own, q->n)); /* until the multipliers are known */
        longest = fmax(longest, q->multipliers[r]);
    }
    for (int r = 0; r < q->count; r++) {
        double length = q->multipliers[r];
        int idle = length <= ROUND_OFF_ROW * longest;
        if (idle && q->bounds[r] > FEASIBLE) return 0;
        for (int c = 0; c < q->n; c++) q->rows[q->n * r + c] *= idle ? 0 : 1 / length;
        q->bounds[r] = idle ? -INFINITY : q->bounds[r] / length;
        q->multipliers[r] = 0;
    }
    return 1;
}

/* min |x - a|^2 subject to the rows; 0 where no x keeps them. */
static int least_distance(Quadratic *q, const double *a, double *x) {
    int n = q->n, row;
    if (!unit_rows(q)) return 0;
    memcpy(x, a, n * sizeof(double));
    q->actives = 0;
    row = worst_row(q, x, 0);
    /* Round-off grows with the violation and with the distance from 0. */
    double within = row < 0 ? 0 : 1e-12 * (q->bounds[row] - dot(q->rows + n * row, x, n)) + 1e-14 * sqrt(dot(a, a, n));
    for (int change = 0; row >= 0; change++) {
        double along[MOST_VARIABLES], by[MOST_VARIABLES], whole, shortest = INFINITY;
        int leaving = -1;
        if (change == MOST_EXCHANGES) return 0;
        split_row(q, q->rows + n * row, along, by);
        whole = dot(along, along, n);
        for (int k = 0; k < q->actives; k++)
            if (by[k] > 1e-14 && q->multipliers[q->active[k]] / by[k] < shortest) {
                shortest = q->multipliers[q->active[k]] / by[k];
                leaving = k;
            }
        int independent = whole > 1e-20 && q->actives < n;
        double missed = q->bounds[row] - dot(q->rows + n * row, x, n);
        double full = independent ? missed / whole : INFINITY, step = fmin(full, shortest);
        if (!isfinite(step)) return 0;
        for (int c = 0; c < n && independent; c++) x[c] += step * along[c];
        for (int k = 0; k < q->actives; k++) q->multipliers[q->active[k]] -= step * by[k];
        q->multipliers[row] += step;
        if (full <= shortest) {
            q->active[q->actives++] = row;
            row = worst_row(q, x, within);
        } else {
            q->multipliers[q->active[leaving]] = 0;
            q->actives--;
            for (int k = leaving; k < q->actives; k++) q->active[k] = q->active[k + 1];
        }
    }
    return 1;
}

/* min |matrix x - right| subject to the rows, of a matrix (count, n) of full rank; 0 where no x keeps the rows. All is
   written over. */
static int least_squares(Quadratic *q, int count, double *matrix, double *right, double *x) {
    int n = q->n;
    double y[MOST_VARIABLES];
    if (count < n || !triangle(n, count, matrix, right)) return 0;
    for (int r = 0; r < q->count; r++) { /* y = R x: rows R^-1 */
        double *v = q->rows + n * r;
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < i; j++) v[i] -= matrix[j * n + i] * v[j];
            v[i] /= matrix[i * n + i];
        }
    }
    if (!least_distance(q, right, y)) return 0;
    solve_upper(n, matrix, y, x);
    return 1;
}
