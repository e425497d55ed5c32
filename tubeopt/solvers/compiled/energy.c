/* The condensed torsion problem of concentric tubes: what block/transcription/reduced.py does.

   Unknowns z by tube, then by point: theta = alpha + L z at the collocation points where a tube is curved and coupled.
   The energy is z'z / 2 + sum of weights times V(theta). */

typedef struct {
    int degree;
    const double *nodes, *weights, *matrix; /* (K), (K), (K, K) by rows */
} Tableau;

static const Tableau COARSE = {COARSE_DEGREE, COARSE_NODES, COARSE_WEIGHTS, COARSE_MATRIX};
static const Tableau FINE = {MOST_DEGREE, FINE_NODES, FINE_WEIGHTS, FINE_MATRIX};

typedef struct {
    const Layout *layout;
    const Tubes *tubes;
    const Tableau *tableau;
    int points, size, first[N], count[N], lead[N];
    int piece[MOST_POINTS], place[MOST_POINTS][N], point[MOST_UNKNOWNS];
    double s[MOST_POINTS], weight[MOST_POINTS];
    double factor[FACTOR_SIZE], *part[N]; /* L of each tube, (count, lead) by rows, 0 above the diagonal */
#if ECCENTRIC
    double compliance[FACTOR_SIZE]; /* L L' of each tube, as `factor` */
#endif
#if GENERAL
    double stiffness[MOST_POINTS][N], moment[MOST_POINTS][N], phase[MOST_POINTS][N], wound[MOST_POINTS][N];
    double rate[MOST_PIECES][MOST_DEGREE][N];                 /* 1 / kt, at the points that all pieces would have */
    double both[MOST_DEGREE][MOST_DEGREE][MOST_DEGREE];       /* A_ik A_jk / b_k of the tableau */
    double reach[MOST_PIECES + 1][N], ahead[MOST_POINTS][N]; /* int ds / kt up to the pieces, and to the points */
#endif
} Unknowns;

typedef struct {
    double z[MOST_UNKNOWNS], gradient[MOST_UNKNOWNS];
    double theta[MOST_POINTS][N], moment[MOST_POINTS][N], slope[MOST_POINTS][N * N];
    double extra[MOST_POINTS][N]; /* (g - 1) w, 0 for concentric tubes */
    double energy;
} State;

/* L L' = (transmission + min(s, r)) / kt, collocated: within an element h A diag(1/b) A' takes the place of min. */
static int factorise(Unknowns *q, int tube) {
    const Tableau *t = q->tableau;
    const Layout *l = q->layout;
    int n = q->count[tube], lead = q->lead[tube], k = t->degree;
    double *a = q->part[tube];
#if !GENERAL
    double scale = 1 / q->tubes->kt[tube], local[MOST_DEGREE][MOST_DEGREE];
    for (int i = 0; i < k; i++)
        for (int j = 0; j < k; j++) {
            local[i][j] = 0;
            for (int m = 0; m < k; m++) local[i][j] += t->matrix[i * k + m] * t->matrix[j * k + m] / t->weights[m];
        }
#endif
    for (int i = 0; i < n; i++) {
        for (int j = i + 1; j < lead; j++) a[i * lead + j] = 0;
        for (int j = 0; j <= i; j++) {
            int x = q->point[q->first[tube] + i], y = q->point[q->first[tube] + j], p = q->piece[x];
#if GENERAL
            double green = q->ahead[y][tube];
            if (p == q->piece[y]) {
                const double *both = q->both[x % k][y % k];
                green = 0;
                for (int o = 0; o < k; o++) green += both[o] * q->rate[p][o][tube];
                green = q->reach[p][tube] + l->length[p] * green;
            }
            a[i * lead + j] = green;
#else
            double green = p == q->piece[y] ? l->start[p] + l->length[p] * local[x % k][y % k] : q->s[y];
            a[i * lead + j] = (l->transmission[tube] + green) * scale;
#endif
#if ECCENTRIC
            double *whole = q->compliance + (a - q->factor);
            whole[i * lead + j] = whole[j * lead + i] = a[i * lead + j];
#endif
        }
    }
    for (int j = 0; j < n; j++) {
        double *row = a + j * lead, pivot = row[j] - dot(row, row, j);
        if (!(pivot > 0)) return 0;
        row[j] = sqrt(pivot);
        for (int i = j + 1; i < n; i++) a[i * lead + j] = (a[i * lead + j] - dot(a + i * lead, row, j)) / row[j];
    }
    return 1;
}

#if GENERAL
/* Cross-sections at the points, and the compliances up to them. */
static void look_along(Unknowns *q) {
    const Layout *l = q->layout;
    const Tableau *t = q->tableau;
    int x = 0, degree = t->degree;
    for (int i = 0; i < degree; i++)
        for (int j = 0; j < degree; j++)
            for (int k = 0; k < degree; k++)
                q->both[i][j][k] = t->matrix[i * degree + k] * t->matrix[j * degree + k] / t->weights[k];
    memcpy(q->reach[0], l->held, sizeof l->held);
    for (int p = 0; p < l->pieces; p++) {
        double h = l->length[p];
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int k = 0; k < t->degree; k++) {
                Section here = section_on(q->tubes, l, p, i, t->nodes[k]);
                q->rate[p][k][i] = 1 / here.torsional;
                sum += t->weights[k] * q->rate[p][k][i];
                if (!l->collocated[p]) continue;
                q->stiffness[x + k][i] = here.stiffness;
                q->moment[x + k][i] = here.moment;
                q->phase[x + k][i] = here.phase;
                q->wound[x + k][i] = here.wound;
            }
            q->reach[p + 1][i] = q->reach[p][i] + h * sum;
            for (int k = 0; k < t->degree && l->collocated[p]; k++) {
                double part = 0;
                for (int o = 0; o < t->degree; o++) part += t->matrix[k * t->degree + o] * q->rate[p][o][i];
                q->ahead[x + k][i] = q->reach[p][i] + h * part;
            }
        }
        if (l->collocated[p]) x += t->degree;
    }
}
#endif

/* The unknowns are rotations of tubes that are curved; with `all`, of those that are present. */
static int pose_unknowns(Unknowns *q, const Layout *l, const Tubes *tubes, const Tableau *t, int all) {
    q->layout = l;
    q->tubes = tubes;
    q->tableau = t;
    q->points = q->size = 0;
    for (int p = 0; p < l->pieces; p++)
        for (int k = 0; k < t->degree && l->collocated[p]; k++) {
            if (q->points == MOST_POINTS) return 0;
            q->piece[q->points] = p;
            q->s[q->points] = l->start[p] + l->length[p] * t->nodes[k];
            q->weight[q->points++] = l->length[p] * t->weights[k];
        }
#if GENERAL
    look_along(q);
#endif
    size_t used = 0;
    for (int i = 0; i < N; i++) {
        q->first[i] = q->size;
        for (int x = 0; x < q->points; x++) {
            int p = q->piece[x], mine = all ? l->present[p][i] : l->curved[p][i];
            q->place[x][i] = mine ? q->size - q->first[i] : -1;
            if (q->place[x][i] < 0) continue;
            if (q->size == MOST_UNKNOWNS - 4) return 0; /* room to fill up to a multiple of four */
            q->point[q->size++] = x;
        }
        q->count[i] = q->size - q->first[i];
        q->lead[i] = filled_up(q->count[i]);
        q->part[i] = q->factor + used;
        used += (size_t)q->count[i] * q->lead[i];
        if (!factorise(q, i)) return 0;
    }
    return 1;
}

/* out <- L x for all tubes */
static void times_factor(const Unknowns *q, const double *x, double *out) {
    for (int i = 0; i < N; i++)
        for (int a = 0; a < q->count[i]; a++)
            out[q->first[i] + a] = dot(q->part[i] + a * q->lead[i], x + q->first[i], a + 1);
}

/* The largest turn that a step in z makes, rad. */
static double turn_of(const Unknowns *q, const double *step) {
    double turned[MOST_UNKNOWNS];
    times_factor(q, step, turned);
    return largest(turned, q->size);
}

static void to_unknowns(const Unknowns *q, const double *alpha, double theta[][N], double *z) {
    for (int i = 0; i < N; i++) {
        double *x = z + q->first[i];
        for (int a = 0; a < q->count[i]; a++) {
            const double *row = q->part[i] + a * q->lead[i];
            x[a] = (theta[q->point[q->first[i] + a]][i] - alpha[i] - dot(row, x, a)) / row[a];
        }
    }
}

/* theta at all points from state->z. */
static void turn_points(const Unknowns *q, const double *alpha, State *state) {
    double turned[MOST_UNKNOWNS];
    times_factor(q, state->z, turned);
    for (int x = 0; x < q->points; x++) memcpy(state->theta[x], alpha, N * sizeof(double));
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) state->theta[q->point[a]][i] += turned[a];
}

/* theta, moments, their slopes, energy and gradient at state->z. */
static void evaluate(const Unknowns *q, const double *alpha, State *state) {
    turn_points(q, alpha, state);
    state->energy = 0.5 * dot(state->z, state->z, q->size);
    for (int x = 0; x < q->points; x++) {
        double bending;
#if GENERAL
        double direction[N];
        for (int i = 0; i < N; i++) direction[i] = state->theta[x][i] + q->phase[x][i];
        const double *in[3] = {direction, q->stiffness[x], q->moment[x]};
#else
        int p = q->piece[x];
        const double *in[3] = {state->theta[x], q->layout->stiffness[p], q->layout->moment[p]};
#endif
        double *out[3] = {state->moment[x], state->slope[x], &bending};
        balance(in, out, 0, 0, 0);
        state->energy += q->weight[x] * bending;
    }
    memcpy(state->gradient, state->z, q->size * sizeof(double));
    for (int i = 0; i < N; i++) {
        double *g = state->gradient + q->first[i];
        for (int a = 0; a < q->count[i]; a++) {
            const double *row = q->part[i] + a * q->lead[i];
            int x = q->point[q->first[i] + a];
            double load = q->weight[x] * state->moment[x][i];
            for (int r = 0; r <= a; r++) g[r] += row[r] * load;
        }
    }
}

/* Upper triangle of 1 + L' B V'' L, rows of length STRIDE, in squares of four by four: each is laid over what the one
   before it has too much. */
static void second_variation(const Unknowns *q, const State *state, double *h) {
    for (int i = 0; i < N; i++)
        for (int j = i; j < N; j++) {
            double value[MOST_POINTS];
            int place[MOST_POINTS];
            for (int a = 0; a < q->count[i]; a++) {
                int x = q->point[q->first[i] + a], c = q->place[x][j];
                value[a] = c < 0 ? 0 : q->weight[x] * state->slope[x][j * N + i];
                place[a] = c < 0 ? 0 : c;
            }
            for (int r = 0; r < q->count[i]; r += 4)
                for (int k = i == j ? r : 0, from = r; k < q->count[j]; k += 4) {
                    Four sum[4] = {{0}};
                    while (from < q->count[i] && place[from] < k) from++; /* L is 0 above its diagonal */
                    for (int a = from; a < q->count[i]; a++) {
                        const double *left = q->part[i] + a * q->lead[i] + r, *right = q->part[j] + place[a] * q->lead[j] + k;
                        for (int v = 0; v < 4; v++) EACH(OF(sum[v]) += value[a] * left[v] * FOUR(right));
                    }
                    double *square = h + (size_t)(q->first[i] + r) * STRIDE + q->first[j] + k;
                    for (int v = 0; v < 4; v++) EACH(FOUR(square + (size_t)v * STRIDE) = OF(sum[v]));
                }
        }
    for (int r = 0; r < q->size; r++) h[(size_t)r * STRIDE + r] += 1;
}

/* The largest violation of the collocation equations, rad. */
static double residual_of(const Unknowns *q, const State *state) { return turn_of(q, state->gradient); }
