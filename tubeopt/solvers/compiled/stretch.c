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

/* Whether the same rotations have a margin above -FAR_BELOW on the centreline, by the coarse points. */
static int stable_on_centreline(const Method *method, const Unknowns *all, const Unknowns *coarse, const double *alpha,
                                const Profile *arm, State *rough, double *h) {
    double theta[MOST_POINTS][N];
    interpolate(all, arm, coarse, method->twice_back, theta);
    to_unknowns(coarse, alpha, theta, rough->z);
    evaluate(coarse, alpha, rough);
    second_variation(coarse, rough, h);
    for (int r = 0; r < coarse->size; r++) h[(size_t)r * STRIDE + r] += FAR_BELOW;
    return cholesky(h, coarse->size, STRIDE);
}

/* z <- (1 - K)^-1 z = J^-1 (1 - P w g') z, with the factors of J, the Jacobian of the residual: K is what
   transcription/offset_margin.py tells the margin by. */
static void stiffness_left(const Unknowns *q, const Stretch *e, const double *jacobian, double *z) {
    double gain[MOST_POINTS][N] = {{0}};
    for (int y = 0; y < q->points; y++)
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++)
                if (q->place[y][j] >= 0) gain[y][i] += e->stretch_slope[y][j * N + i] * z[q->first[j] + q->place[y][j]];
    for (int y = 0; y < q->points; y++)
        for (int i = 0; i < N; i++) gain[y][i] *= e->twist[y][i];
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++)
            for (int y = 0; y < q->points; y++) z[a] -= e->up_to[q->point[a]][y] * gain[y][i];
    lu_solve(jacobian, q->size, STRIDE, e->pivots, z);
}

/* The margin of tubes off the centreline at a solved state, at most 1; -1 where it is not sure to be positive, which
   is left to the general solver. 1 / margin is the largest eigenvalue of (1 - K)^-1, by Arnoldi's method; it cannot see
   an eigenvalue that passed infinity, a margin below 0: that the tubes on the centreline are stable by -FAR_BELOW and the
   sign of the determinant exclude it. */
static double stretched_margin(const Unknowns *q, const State *state, Stretch *e, double *h) {
    double basis[LANCZOS + 1][MOST_UNKNOWNS], small[LANCZOS * LANCZOS], y[LANCZOS], value = 1;
    int n = q->size, steps = n < LANCZOS ? n : LANCZOS, sign = 1, check = 5;
    if (!n) return 1;
    stretched_jacobian(q, state, e, h);
    if (!lu(h, n, STRIDE, e->pivots)) return -1;
    for (int k = 0; k < n; k++) sign *= (h[(size_t)k * STRIDE + k] < 0) != (e->pivots[k] != k) ? -1 : 1;
    if (sign < 0) return -1;
    anywhere(basis[0], n);
    double norm = sqrt(dot(basis[0], basis[0], n));
    for (int k = 0; k < n; k++) basis[0][k] /= norm;
    memset(small, 0, sizeof small);
    for (int m = 0; m < steps; m++) {
        double *restrict next = basis[m + 1];
        memcpy(next, basis[m], n * sizeof(double));
        stiffness_left(q, e, h, next);
        double beside, whole;
        do { /* Twice is enough: again only where most of the vector went away. */
            whole = dot(next, next, n);
            for (int j = 0; j <= m; j++) {
                double along = dot(next, basis[j], n);
                small[j * LANCZOS + m] += along;
                for (int k = 0; k < n; k++) next[k] -= along * basis[j][k];
            }
            beside = sqrt(dot(next, next, n));
        } while (beside * beside < 1e-2 * whole && beside > 1e-13);
        int last = m + 1 == steps || beside < 1e-13;
        if (last || m == check) {
            check += 3;
            value = largest_of_hessenberg(small, m + 1, LANCZOS, y);
            if (!(value > 0)) return -1;
            double residual = beside * fabs(y[m]);
            /* Close to 1, where eigenvalues gather, the square of the residual over the distance from 1 is what is off. */
            int gathered = value < 1.01 && residual * residual < 1e-3 * STRETCHED_ERROR * fmax(value - 1, 1e-6);
            if (last || gathered || residual < STRETCHED_ERROR * value) break;
        }
        small[(m + 1) * LANCZOS + m] = beside;
        for (int k = 0; k < n; k++) next[k] /= beside;
    }
    return fmin(1, 1 / value);
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
