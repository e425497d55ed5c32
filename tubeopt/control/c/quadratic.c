/* min |x|^2 / 2 - a'x subject to rows x >= bounds, in few variables: the dual method of Goldfarb and Idnani, Math.
   Programming 27 (1983), with the active rows orthogonalised anew at each change. */

#define MOST_CHANGES 100

typedef struct {
    double rows[MOST_ROWS][JOINTS], bounds[MOST_ROWS], multipliers[MOST_ROWS];
    int count, active[JOINTS], actives;
} Quadratic;

/* Of a row: what the active rows leave of it, `along` (n), and its coefficients `by` in them. */
static void split_row(const Quadratic *q, const double *row, double *along, double *by) {
    double base[JOINTS][JOINTS], part[JOINTS][JOINTS], gain[JOINTS];
    memcpy(along, row, JOINTS * sizeof(double));
    for (int k = 0; k < q->actives; k++) { /* modified Gram-Schmidt, R in `part` */
        memcpy(base[k], q->rows[q->active[k]], sizeof base[k]);
        for (int j = 0; j < k; j++) {
            part[j][k] = dot(base[j], base[k], JOINTS);
            for (int c = 0; c < JOINTS; c++) base[k][c] -= part[j][k] * base[j][c];
        }
        part[k][k] = sqrt(dot(base[k], base[k], JOINTS));
        for (int c = 0; c < JOINTS; c++) base[k][c] /= part[k][k];
        gain[k] = dot(base[k], along, JOINTS);
        for (int c = 0; c < JOINTS; c++) along[c] -= gain[k] * base[k][c];
    }
    for (int k = q->actives - 1; k >= 0; k--) {
        by[k] = gain[k];
        for (int j = k + 1; j < q->actives; j++) by[k] -= part[k][j] * by[j];
        by[k] /= part[k][k];
    }
}

static void drop_row(Quadratic *q, int which) {
    q->multipliers[q->active[which]] = 0;
    for (int k = which; k + 1 < q->actives; k++) q->active[k] = q->active[k + 1];
    q->actives--;
}

/* The row that is violated most, of unit length; -1 where none is. */
static int worst_row(const Quadratic *q, const double *x) {
    int worst = -1;
    double most = 1e-12;
    for (int r = 0; r < q->count; r++) {
        double missed = q->bounds[r] - dot(q->rows[r], x, JOINTS);
        if (missed <= most) continue;
        most = missed;
        worst = r;
    }
    return worst;
}

/* x (n) from a; 0 where no x keeps the rows. Rows are made of unit length, those without length are left out. */
static int least_quadratic(Quadratic *q, const double *a, double *x) {
    for (int r = 0; r < q->count; r++) {
        double length = sqrt(dot(q->rows[r], q->rows[r], JOINTS)), scale = length > 0 ? 1 / length : 0;
        for (int c = 0; c < JOINTS; c++) q->rows[r][c] *= scale;
        q->bounds[r] = length > 0 ? q->bounds[r] * scale : -1;
        q->multipliers[r] = 0;
    }
    memcpy(x, a, JOINTS * sizeof(double));
    q->actives = 0;
    int row = worst_row(q, x);
    for (int change = 0; row >= 0; change++) {
        double along[JOINTS], by[JOINTS], whole, shortest = INFINITY;
        int leaving = -1;
        if (change == MOST_CHANGES) return 0;
        split_row(q, q->rows[row], along, by);
        whole = dot(along, along, JOINTS);
        for (int k = 0; k < q->actives; k++)
            if (by[k] > 1e-14 && q->multipliers[q->active[k]] / by[k] < shortest) {
                shortest = q->multipliers[q->active[k]] / by[k];
                leaving = k;
            }
        int independent = whole > 1e-20 && q->actives < JOINTS;
        double missed = q->bounds[row] - dot(q->rows[row], x, JOINTS);
        double full = independent ? missed / whole : INFINITY, step = fmin(full, shortest);
        if (!isfinite(step)) return 0;
        for (int c = 0; c < JOINTS && independent; c++) x[c] += step * along[c];
        for (int k = 0; k < q->actives; k++) q->multipliers[q->active[k]] -= step * by[k];
        q->multipliers[row] += step;
        if (full <= shortest) {
            q->active[q->actives++] = row;
            row = worst_row(q, x);
        } else {
            drop_row(q, leaving);
        }
    }
    return 1;
}
