/* What sticks and what slips: the descent of `stick_or_slip` in solvers/friction_increment.py. From what slipped before it takes few changes, each a
   small elimination; the energy falls with each of them, so that no state comes back and it ends.

   A (count, count) by rows is positive definite, `free` what would slip without friction, `most` the capacities. */

typedef struct {
    int count;
    const double *compliance, *free, *most;
    double *torque;
    signed char *sign; /* of the slip, 0 where a row sticks */
} Sticking;

typedef struct {
    double matrix[MOST_UNKNOWNS * STRIDE], right[MOST_UNKNOWNS];
    int rows[MOST_UNKNOWNS];
} Exchange;

/* right <- the inverse of A's part of `rows` times right; 0 where it has none. */
static int solve_part(const Sticking *s, int rows, Exchange *w) {
    for (int a = 0; a < rows; a++)
        for (int b = a; b < rows; b++)
            w->matrix[(size_t)a * STRIDE + b] = s->compliance[(size_t)w->rows[a] * s->count + w->rows[b]];
    if (!cholesky(w->matrix, rows, STRIDE)) return 0;
    cholesky_solve(w->matrix, rows, STRIDE, w->right);
    return 1;
}

/* Torques and signs, from the signs that are there as a first guess; 0 where round-off has won. Down with every step: what
   is inside goes to its least, up to the first bound, then the row is freed that gains most. */
static int stick_or_slip(const Sticking *s, Exchange *w) {
    int inside[MOST_UNKNOWNS];
    for (int r = 0; r < s->count; r++) {
        s->torque[r] = s->most[r] * s->sign[r];
        inside[r] = !s->sign[r];
    }
    for (int change = 0; change < MOST_CHANGES * (s->count + 1); change++) {
        int rows = 0, worst = -1, first = -1;
        double gain = HARDLY, room = 1;
        for (int r = 0; r < s->count; r++)
            if (inside[r]) w->rows[rows++] = r;
        for (int a = 0; a < rows; a++) {
            const double *row = s->compliance + (size_t)w->rows[a] * s->count;
            w->right[a] = s->free[w->rows[a]];
            for (int r = 0; r < s->count; r++)
                if (!inside[r]) w->right[a] -= row[r] * s->torque[r];
        }
        if (rows && !solve_part(s, rows, w)) return 0;
        for (int a = 0; a < rows; a++) {
            int r = w->rows[a];
            double move = w->right[a] - s->torque[r];
            if (move == 0) continue;
            double share = (copysign(s->most[r], move) - s->torque[r]) / move;
            if (!(share < room)) continue;
            room = share;
            first = a;
        }
        for (int a = 0; a < rows; a++) s->torque[w->rows[a]] += (first < 0 ? 1 : room) * (w->right[a] - s->torque[w->rows[a]]);
        if (first >= 0) {
            int r = w->rows[first];
            s->torque[r] = copysign(s->most[r], w->right[first]);
            inside[r] = 0;
            continue;
        }
        for (int r = 0; r < s->count; r++) {
            double slip = s->free[r] - dot(s->compliance + (size_t)r * s->count, s->torque, s->count);
            double wrong = inside[r] ? 0 : -copysign(1, s->torque[r]) * slip;
            if (!(wrong > gain)) continue;
            gain = wrong;
            worst = r;
        }
        if (worst < 0) {
            for (int r = 0; r < s->count; r++) s->sign[r] = inside[r] ? 0 : s->torque[r] > 0 ? 1 : -1;
            return 1;
        }
        inside[worst] = 1;
    }
    return 0;
}
