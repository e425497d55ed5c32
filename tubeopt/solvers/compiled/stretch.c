/* Tubes off the centreline: theta' = g w. No energy has the residual as its gradient, so Newton solves

       theta = alpha - L L' B M + P [(g - 1) w],   w = -W M / kt,   P, W: integration from the base, and to the tip.  */

typedef struct {
    double stretch[MOST_POINTS][N], stretch_slope[MOST_POINTS][N * N], twist[MOST_POINTS][N];
    double up_to[MOST_POINTS][MOST_POINTS], beyond[MOST_POINTS][MOST_POINTS], residual[MOST_UNKNOWNS];
    int pivots[MOST_UNKNOWNS];
} Stretch;

static void pose_integrals(const Unknowns *q, Stretch *e) {
    int k = q->tableau->degree;
    for (int x = 0; x < q->points; x++)
        for (int y = 0; y < q->points; y++) {
            int before = q->piece[y] < q->piece[x], same = q->piece[y] == q->piece[x];
            double within = q->layout->length[q->piece[x]] * q->tableau->matrix[(x % k) * k + y % k];
            e->up_to[x][y] = before ? q->weight[y] : same ? within : 0;
            e->beyond[x][y] = q->weight[y] - e->up_to[x][y];
        }
}

/* Moments, stretch, their slopes, and the residual of each unknown, rad; `energy` is that of bending. */
static void evaluate_stretched(const Unknowns *q, const double *alpha, State *state, Stretch *e) {
    const Tubes *t = q->tubes;
    turn_points(q, alpha, state);
    state->energy = 0;
    for (int x = 0; x < q->points; x++) {
        int p = q->piece[x];
        double bending;
        const double *in[5] = {state->theta[x], q->layout->stiffness[p], q->layout->moment[p], t->offset, t->angle};
        double *out[5] = {state->moment[x], state->slope[x], &bending, e->stretch[x], e->stretch_slope[x]};
        stretched(in, out, 0, 0, 0);
        state->energy += q->weight[x] * bending;
    }
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int y = 0; y < q->points; y++) sum += e->beyond[x][y] * state->moment[y][i];
            e->twist[x][i] = -sum / t->kt[i];
            state->extra[x][i] = (e->stretch[x][i] - 1) * e->twist[x][i];
        }
    for (int i = 0; i < N; i++) {
        const double *compliance = q->compliance + (q->part[i] - q->factor);
        for (int a = 0; a < q->count[i]; a++) {
            int x = q->point[q->first[i] + a];
            double sum = state->theta[x][i] - alpha[i];
            for (int c = 0; c < q->count[i]; c++) {
                int y = q->point[q->first[i] + c];
                sum += compliance[a * q->lead[i] + c] * q->weight[y] * state->moment[y][i];
            }
            for (int y = 0; y < q->points; y++) sum -= e->up_to[x][y] * state->extra[y][i];
            e->residual[q->first[i] + a] = sum;
        }
    }
}

/* Derivative of the residual with respect to theta at the points. */
static void stretched_jacobian(const Unknowns *q, const State *state, const Stretch *e, double *restrict h) {
    for (int i = 0; i < N; i++) {
        const double *compliance = q->compliance + (q->part[i] - q->factor);
        for (int a = 0; a < q->count[i]; a++) {
            int x = q->point[q->first[i] + a];
            double *restrict row = h + (size_t)(q->first[i] + a) * STRIDE, through[MOST_POINTS] = {0};
            memset(row, 0, q->size * sizeof(double));
            row[q->first[i] + a] = 1;
            for (int y = 0; y < q->points; y++) {
                double scale = e->up_to[x][y] * (e->stretch[y][i] - 1) / q->tubes->kt[i];
                for (int v = 0; v < q->points; v++) through[v] += scale * e->beyond[y][v];
            }
            for (int c = 0; c < q->count[i]; c++) {
                int y = q->point[q->first[i] + c];
                through[y] += compliance[a * q->lead[i] + c] * q->weight[y];
            }
            for (int j = 0; j < N; j++)
                for (int c = 0; c < q->count[j]; c++) {
                    int y = q->point[q->first[j] + c];
                    row[q->first[j] + c] += through[y] * state->slope[y][j * N + i] -
                                            e->up_to[x][y] * e->stretch_slope[y][j * N + i] * e->twist[y][i];
                }
        }
    }
}

/* Newton from state->z, as `newton` for concentric tubes. */
static int newton_stretched(const Unknowns *q, const double *alpha, State *state, Stretch *e, double *h, int most,
                            int *iterations, double *contraction) {
    double step[MOST_UNKNOWNS], theta[MOST_POINTS][N], last = INFINITY;
    int fresh = 1;
    *contraction = 0;
    pose_integrals(q, e);
    evaluate_stretched(q, alpha, state, e);
    for (int k = 0; k < most; k++) {
        ++*iterations;
        if (fresh) {
            stretched_jacobian(q, state, e, h);
            if (!lu(h, q->size, STRIDE, e->pivots)) return DECLINED;
        }
        for (int r = 0; r < q->size; r++) step[r] = -e->residual[r];
        lu_solve(h, q->size, STRIDE, e->pivots, step);
        double size = largest(step, q->size);
        if (!isfinite(size) || (size > 2 * last && size > 3.2)) return DECLINED;
        memcpy(theta, state->theta, q->points * sizeof theta[0]);
        for (int i = 0; i < N; i++)
            for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) theta[q->point[a]][i] += step[a];
        to_unknowns(q, alpha, theta, state->z);
        evaluate_stretched(q, alpha, state, e);
        if (size > LAST_STEP) *contraction = fmax(*contraction, size / last);
        if (size <= LAST_STEP && (size <= ROUND_OFF || largest(e->residual, q->size) <= ROUND_OFF)) return SOLVED;
        fresh = size > CHORD_STEP;
        last = size;
    }
    return DECLINED;
}

/* Torsional energy in front of the plate and of the transmissions, J. */
static double stretched_torsion(const Unknowns *q, const State *state, const Stretch *e, const Profile *arm) {
    double sum = 0;
    for (int i = 0; i < N; i++) {
        double inside = 0, held = q->layout->pieces ? arm->twist[0][i] : 0;
        for (int x = 0; x < q->points; x++)
            inside += q->weight[x] * e->twist[x][i] * (e->twist[x][i] + state->extra[x][i]);
        for (int p = 0; p < q->layout->pieces; p++)
            if (!q->layout->collocated[p]) inside += q->layout->length[p] * arm->twist[p][i] * arm->twist[p][i];
        sum += q->tubes->kt[i] * (inside + q->layout->transmission[i] * held * held);
    }
    return sum / 2;
}
