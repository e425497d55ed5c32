/* Tubes off the centreline: theta' = g w. No energy has the residual as its gradient, so Newton solves

       theta = alpha - L L' B M + P [(g - 1) w],   w = -W M / kt,   P, W: integration from the base, and to the tip.  */

typedef struct {
    double stretch[MOST_POINTS][N], stretch_slope[MOST_POINTS][N * N], twist[MOST_POINTS][N];
    double up_to[MOST_POINTS][MOST_POINTS], beyond[MOST_POINTS][MOST_POINTS], residual[MOST_UNKNOWNS];
    double compliance[N][MOST_POINTS][MOST_POINTS]; /* L L': int ds / kt up to the nearer of two points, collocated */
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
            for (int i = 0; i < N; i++) {
                double own = q->layout->length[q->piece[x]] * q->tableau->within[(x % k) * k + y % k] / q->tubes->kt[i];
                e->compliance[i][x][y] = same ? q->reach[q->piece[x]][i] + own : q->ahead[before ? y : x][i];
            }
        }
}

/* Moments, stretch, their slopes, and the residual of each unknown, rad; `energy` is that of bending. */
static void evaluate_stretched(const Unknowns *q, const double *alpha, State *state, Stretch *e) {
    const Tubes *t = q->tubes;
    turn_points(q, alpha, state);
    state->energy = 0;
    for (int x = 0; x < q->points; x++) {
        double bending;
        const double *in[5] = {state->theta[x], q->at[x].stiffness, q->at[x].moment, t->offset, t->angle};
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
        for (int a = 0; a < q->count[i]; a++) {
            int x = q->point[q->first[i] + a];
            double sum = state->theta[x][i] - alpha[i];
            for (int c = 0; c < q->count[i]; c++) {
                int y = q->point[q->first[i] + c];
                sum += e->compliance[i][x][y] * q->weight[y] * state->moment[y][i];
            }
            for (int y = 0; y < q->points; y++) sum -= e->up_to[x][y] * state->extra[y][i];
            e->residual[q->first[i] + a] = sum;
        }
    }
}

/* Derivative of the residual with respect to theta at the points, moments taken `soft` times as steep. */
static void stretched_jacobian(const Unknowns *q, const State *state, const Stretch *e, double soft,
                               double *restrict h) {
    for (int i = 0; i < N; i++) {
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
                through[y] += e->compliance[i][x][y] * q->weight[y];
            }
            for (int j = 0; j < N; j++)
                for (int c = 0; c < q->count[j]; c++) {
                    int y = q->point[q->first[j] + c];
                    row[q->first[j] + c] += soft * through[y] * state->slope[y][j * N + i] -
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
            stretched_jacobian(q, state, e, 1, h);
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

#define FAR_BELOW 0.05 /* how far below 0 the margin on the centreline may be: several times by how much the two differ */
#define STRETCHED_ERROR 3e-9 /* residual, as a fraction of 1 / margin, at which Arnoldi steps end */

/* What 1 - mu of the margin mu cannot exceed, at most 1, and is not far below: FAR_BELOW more than what, by the coarse
   points, the same rotations have on the centreline. -1 where mu there is not above -FAR_BELOW. */
static double most_softening(const Unknowns *all, const Unknowns *coarse, const double *alpha, const Profile *arm,
                             State *rough, Chain *h) {
    double theta[MOST_POINTS][N], z[MOST_UNKNOWNS];
    interpolate(all, arm, coarse, TO_COARSE, theta);
    to_unknowns(coarse, alpha, theta, rough->z);
    evaluate(coarse, alpha, rough);
    if (!factor_variation(coarse, rough, 1 + FAR_BELOW, h)) return -1;
    if (!coarse->size) return FAR_BELOW;
    anywhere(z, coarse->size);
    double least = least_eigenvalue((Factored){coarse, h, NULL, NULL}, SOFTENING_ERROR, SOFTENING_ERROR, 0, z);
    double most = fmax((1 + SOFTENING_ERROR) * (1 + FAR_BELOW - least), SOFTENING_ERROR);
    while (most + FAR_BELOW < 1 && !factor_variation(coarse, rough, most, h)) most *= 2;
    return fmin(most + FAR_BELOW, 1);
}

typedef struct {
    const Unknowns *q;
    const Stretch *stretch;
    const double *jacobian;
} Softness;

/* z <- (1 - soft K)^-1 z = J^-1 (1 - P w g') z, with the factors of J, the Jacobian of the residual of moments `soft`
   times as steep: K is the matrix of the margin in block/transcription/second_variation.py. */
static void stiffness_left(const void *of, double *z) {
    const Softness *given = of;
    const Unknowns *q = given->q;
    const Stretch *e = given->stretch;
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
    lu_solve(given->jacobian, q->size, STRIDE, e->pivots, z);
}

/* Factors of J of moments `soft` times as steep; 0 where it is singular or has a negative determinant. */
static int factorised(const Unknowns *q, const State *state, Stretch *e, double soft, double *h) {
    int sign = 1;
    stretched_jacobian(q, state, e, soft, h);
    if (!lu(h, q->size, STRIDE, e->pivots)) return 0;
    for (int k = 0; k < q->size; k++) sign *= (h[(size_t)k * STRIDE + k] < 0) != (e->pivots[k] != k) ? -1 : 1;
    return sign > 0;
}

/* Whether the margin is 1, but for COUPLING_FLOOR: a mode of (1 - mu) y = K y has

       (1 - mu) y' A^-1 (1 - P w g') y = -y' M' y,   A = (|beta| + P g W) / kt,

   y' A^-1 y >= y'y / most, and what w g' takes away is at most a fraction f of it, since A >= P P' thin / kt: the root of
   turned most / thin. So 1 - mu of every mode is at most excess most / (1 - f) where M' > -excess at every point: none
   passed infinity either. */
static int never_stretched(const Unknowns *q, const State *state, const Stretch *e) {
    double most = 0, thick = 1, thin = 1, turned = 0;
    for (int i = 0; i < N; i++) {
        double sum = 0;
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++)
            sum += e->compliance[i][q->point[a]][q->point[a]] * q->weight[q->point[a]];
        most = fmax(most, sum);
    }
    for (int x = 0; x < q->points; x++) {
        double sum = 0;
        for (int i = 0; i < N; i++) {
            thick = fmax(thick, e->stretch[x][i]);
            thin = fmin(thin, e->stretch[x][i]);
            double twist = q->tubes->kt[i] * e->twist[x][i] * e->twist[x][i];
            for (int j = 0; j < N; j++) sum += twist * e->stretch_slope[x][j * N + i] * e->stretch_slope[x][j * N + i];
        }
        turned = fmax(turned, sum);
    }
    most *= thick;
    double excess = COUPLING_FLOOR * (1 - sqrt(turned * most / thin)) / most, m[N][N];
    if (!(thin > 0 && excess > 0)) return 0;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++)
            for (int j = i; j < N; j++) {
                double sum = (state->slope[x][j * N + i] + state->slope[x][i * N + j]) / 2 + (i == j) * excess;
                for (int k = 0; k < i; k++) sum -= m[k][i] * m[k][j];
                if (i == j && !(sum > 0)) return 0;
                m[i][j] = i == j ? sqrt(sum) : sum / m[i][i];
            }
    return 1;
}

/* The margin mu of tubes off the centreline at a solved state, at most 1; -1 where it is not sure to be positive, which
   is left to the general solver. `most`: a bound of 1 - mu.

   With moments 1 / most times as steep, 1 / (1 - (1 - mu) / most) is the largest eigenvalue of (1 - K / most)^-1, which is
   not symmetric: by Arnoldi's method. It cannot see an eigenvalue that passed infinity, a mu below 1 - most: that the tubes
   on the centreline have none by far, and the sign of the determinant, exclude it. */
static double stretched_margin(const Unknowns *q, const State *state, Stretch *e, double most, double *h) {
    double basis[LANCZOS + 1][MOST_UNKNOWNS], vector[MOST_UNKNOWNS];
    if (!factorised(q, state, e, 1 / most, h)) {
        if (most == 1 || !factorised(q, state, e, 1, h)) return -1;
        most = 1;
    }
    Softness of = {q, e, h};
    Krylov inverse = {stiffness_left, &of, 0, q->size, LANCZOS, MOST_UNKNOWNS, 0, STRETCHED_ERROR, 0, most, basis[0], 0};
    anywhere(vector, q->size);
    double value = largest_of(&inverse, vector);
    return value > 0 ? fmin(1, 1 - most * (1 - 1 / value)) : -1;
}

/* Torsional energy in front of the plate and of the transmissions, J. */
static double stretched_torsion(const Unknowns *q, const State *state, const Stretch *e, const Profile *arm) {
    double sum = 0;
    for (int i = 0; i < N; i++) {
        double kt = q->tubes->kt[i], inside = 0, held = q->layout->pieces ? arm->torque[0][i] / kt : 0;
        for (int x = 0; x < q->points; x++)
            inside += q->weight[x] * e->twist[x][i] * (e->twist[x][i] + state->extra[x][i]);
        for (int p = 0; p < q->layout->pieces; p++)
            if (!q->layout->collocated[p]) inside += q->layout->length[p] * arm->torque[p][i] * arm->torque[p][i] / (kt * kt);
        sum += kt * (inside + q->layout->transmission[i] * held * held);
    }
    return sum / 2;
}
