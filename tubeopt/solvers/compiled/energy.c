/* The condensed torsion problem of concentric tubes: what block/transcription/reduced.py does.

   Unknowns z by tube, then by point: theta = alpha + L z at the collocation points where a tube is curved and coupled.
   The energy is z'z / 2 + sum of weights times V(theta). */

#define WIDE ((MOST_DEGREE + 3) / 4 * 4)

typedef struct {
    int degree;
    const double *nodes, *weights, *matrix; /* (K), (K), (K, K) by rows */
    const double *both, *within; /* (K, K, K) A_ik A_jk / b_k; its sum (K, K) */
} Tableau;

static const Tableau COARSE = {COARSE_DEGREE, COARSE_NODES, COARSE_WEIGHTS, COARSE_MATRIX, COARSE_BOTH, COARSE_WITHIN};
static const Tableau FINE = {MOST_DEGREE, FINE_NODES, FINE_WEIGHTS, FINE_MATRIX, FINE_BOTH, FINE_WITHIN};

typedef struct {
    const Layout *layout;
    const Tubes *tubes;
    const Tableau *tableau;
    int points, size, first[N], count[N];
    int piece[MOST_POINTS], place[MOST_POINTS][N], point[MOST_UNKNOWNS];
    double s[MOST_POINTS], weight[MOST_POINTS];
    /* L of each tube within its elements, by rows and by columns, 0 above the diagonal; and one row for all points further
       out. */
    double block[MOST_UNKNOWNS][WIDE], column[MOST_UNKNOWNS][WIDE], beyond[MOST_UNKNOWNS];
    Sections at[MOST_POINTS];
    double rate[MOST_PIECES][MOST_DEGREE][N];                /* 1 / kt, at the points that all pieces would have */
    double reach[MOST_PIECES + 1][N], ahead[MOST_POINTS][N]; /* int ds / kt up to the pieces, and to the points */
} Unknowns;

typedef struct {
    double z[MOST_UNKNOWNS], gradient[MOST_UNKNOWNS];
    double theta[MOST_POINTS][N], moment[MOST_POINTS][N], slope[MOST_POINTS][N * N];
    double extra[MOST_POINTS][N]; /* (g - 1) t / kt, of tubes off the centreline */
    double energy;
} State;

/* L L' = int ds / kt up to the nearer of two points, collocated: within an element h A diag(1/b) A' takes its place. Of a
   point nearer to the base all points of an element see the same, and so do those of all elements further out. */
static int factorise(Unknowns *q, int tube) {
    const Tableau *t = q->tableau;
    const Layout *l = q->layout;
    int k = t->degree;
    double passed = 0; /* the square of that row */
    for (int a = q->first[tube]; a < q->first[tube] + q->count[tube]; a += k) {
        double(*block)[WIDE] = q->block + a, (*column)[WIDE] = q->column + a, *beyond = q->beyond + a;
        int x = q->point[a], p = q->piece[x], even = l->across[p].even[tube];
        double before = q->reach[p][tube] - passed, scale = l->length[p] * l->across[p].tubes.rate[tube];
        memset(block, 0, k * sizeof block[0]);
        memset(column, 0, k * sizeof column[0]);
        for (int i = 0; i < k; i++)
            for (int j = 0; j <= i; j++) {
                double green = scale * t->within[i * k + j];
                if (!even) {
                    green = 0;
                    for (int o = 0; o < k; o++) green += t->both[(i * k + j) * k + o] * q->rate[p][o][tube];
                    green *= l->length[p];
                }
                double rest = before + green - dot(block[i], block[j], j);
                if (i == j && !(rest > 0)) return 0;
                block[i][j] = column[j][i] = i == j ? sqrt(rest) : rest / block[j][j];
            }
        for (int j = 0; j < k; j++) beyond[j] = (q->ahead[x + j][tube] - passed - dot(beyond, block[j], j)) / block[j][j];
        passed += dot(beyond, beyond, k);
    }
    return 1;
}

/* Cross-sections at the points, and the compliances up to them. */
static void look_along(Unknowns *q) {
    const Layout *l = q->layout;
    const Tableau *t = q->tableau;
    int x = 0, degree = t->degree;
    memcpy(q->reach[0], l->held, sizeof l->held);
    for (int p = 0; p < l->pieces; p++) {
        double h = l->length[p];
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int k = 0; k < degree; k++) {
                Section here = section_on(q->tubes, l, p, i, t->nodes[k]);
                q->rate[p][k][i] = here.rate;
                sum += t->weights[k] * here.rate;
                if (l->collocated[p]) put_section(&q->at[x + k], i, here);
            }
            q->reach[p + 1][i] = q->reach[p][i] + h * sum;
            for (int k = 0; k < degree && l->collocated[p]; k++) {
                double part = t->nodes[k] * l->across[p].tubes.rate[i];
                if (!l->across[p].even[i]) {
                    part = 0;
                    for (int o = 0; o < degree; o++) part += t->matrix[k * degree + o] * q->rate[p][o][i];
                }
                q->ahead[x + k][i] = q->reach[p][i] + h * part;
            }
        }
        if (l->collocated[p]) x += degree;
    }
}

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
    look_along(q);
    for (int i = 0; i < N; i++) {
        q->first[i] = q->size;
        for (int x = 0; x < q->points; x++) {
            int p = q->piece[x], mine = all ? l->across[p].present[i] : l->across[p].curved[i];
            q->place[x][i] = mine ? q->size - q->first[i] : -1;
            if (q->place[x][i] < 0) continue;
            if (q->size == MOST_UNKNOWNS - 4) return 0; /* room to fill up to a multiple of four */
            q->point[q->size++] = x;
        }
        q->count[i] = q->size - q->first[i];
        if (!factorise(q, i)) return 0;
    }
    return 1;
}

/* out <- L x for all tubes */
static void times_factor(const Unknowns *q, const double *x, double *out) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        double nearer = 0;
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a += k) {
            for (int w = 0; w < k; w += 4) { /* what is too much is laid over by the next */
                Four sum;
                EACH(OF(sum) = x[a] * FOUR(q->column[a] + w) + nearer);
                for (int b = 1; b < k; b++) EACH(OF(sum) += x[a + b] * FOUR(q->column[a + b] + w));
                EACH(FOUR(out + a + w) = OF(sum));
            }
            nearer += dot(q->beyond + a, x + a, k);
        }
    }
}

/* x <- x + L' y for all tubes */
static void add_by_factor(const Unknowns *q, const double *y, double *x) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        double further = 0;
        for (int a = q->first[i] + q->count[i] - k; a >= q->first[i]; a -= k) {
            for (int w = 0; w < k; w += 4) {
                Four sum = {0};
                for (int b = 0; b < k; b++) EACH(OF(sum) += y[a + b] * FOUR(q->block[a + b] + w));
                EACH(FOUR(x + a + w) += OF(sum));
            }
            for (int b = 0; b < k; b++) {
                x[a + b] += q->beyond[a + b] * further;
            }
            for (int b = 0; b < k; b++) further += y[a + b];
        }
    }
}

/* The largest turn that a step in z makes, rad. */
static double turn_of(const Unknowns *q, const double *step) {
    double turned[MOST_UNKNOWNS];
    times_factor(q, step, turned);
    return largest(turned, q->size);
}

static void to_unknowns(const Unknowns *q, const double *alpha, double theta[][N], double *z) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        double nearer = alpha[i];
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a += k) {
            for (int b = 0; b < k; b++) {
                const double *row = q->block[a + b];
                z[a + b] = (theta[q->point[a + b]][i] - nearer - dot(row, z + a, b)) / row[b];
            }
            nearer += dot(q->beyond + a, z + a, k);
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
        double bending, direction[N];
        for (int i = 0; i < N; i++) direction[i] = state->theta[x][i] + q->at[x].phase[i];
        const double *in[3] = {direction, q->at[x].stiffness, q->at[x].moment};
        double *out[3] = {state->moment[x], state->slope[x], &bending};
        balance(in, out, 0, 0, 0);
        state->energy += q->weight[x] * bending;
    }
    double load[MOST_UNKNOWNS];
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++)
            load[a] = q->weight[q->point[a]] * state->moment[q->point[a]][i];
    memcpy(state->gradient, state->z, q->size * sizeof(double));
    add_by_factor(q, load, state->gradient);
}

/* Upper triangle of 1 + L' B V'' L, rows of length STRIDE: from the tip, the elements of tube i against all of tube j.
   All points further out see an element alike (`beyond`), so that they enter by a sum and one row: the products cost the
   square of the unknowns, not the cube, and less than the elimination that follows.
   Fours that have too much are laid over by what comes after them. */
ALWAYS_INLINE void vary(const Unknowns *q, const State *state, int k, double *h) {
    for (int i = 0; i < N; i++)
        for (int j = i; j < N; j++) {
            const double *nearer = q->beyond + q->first[j];
            double further = 0, outwards[MOST_UNKNOWNS]; /* of elements further out: B V'', and B V'' L of tube j */
            int count = q->count[j], from = count, to;
            for (int x = q->points - k; x >= 0; x -= k) {
                int a = q->place[x][i], c = q->place[x][j], both = a >= 0 && c >= 0;
                const double(*left)[WIDE] = (const double(*)[WIDE])q->block + q->first[i] + a;
                const double(*right)[WIDE] = (const double(*)[WIDE])q->block + q->first[j] + c;
                const double *beyond = q->beyond + q->first[i] + a;
                double value[MOST_DEGREE], sum = 0;
                for (int b = 0; b < k && both; b++)
                    sum += value[b] = q->weight[x + b] * state->slope[x + b][j * N + i];
                to = from;
                if (c >= 0) from = c;
                for (int r = 0; r < k && a >= 0; r++) {
                    double *row = h + (size_t)(q->first[i] + a + r) * STRIDE + q->first[j], all = beyond[r] * further;
                    Four here[WIDE / 4] = {{0}}; /* all that is read is written; compilers cannot know */
                    for (int w = 0; w < k && c >= 0; w += 4) EACH(OF(here[w / 4]) = all * FOUR(nearer + c + w));
                    for (int b = r; b < k && both; b++) {
                        double part = left[b][r] * value[b];
                        all += part;
                        for (int w = 0; w < k; w += 4) EACH(OF(here[w / 4]) += part * FOUR(right[b] + w));
                    }
                    for (int s = 0; s < from && i != j; s += 4) EACH(FOUR(row + s) = all * FOUR(nearer + s));
                    for (int w = 0; w < k && c >= 0; w += 4) EACH(FOUR(row + c + w) = OF(here[w / 4]));
                    for (int s = to; s < count; s += 4) EACH(FOUR(row + s) = beyond[r] * FOUR(outwards + s));
                }
                for (int w = 0; w < k && c >= 0; w += 4) {
                    Four here;
                    EACH(OF(here) = further * FOUR(nearer + c + w));
                    for (int b = 0; b < k && both; b++) EACH(OF(here) += value[b] * FOUR(right[b] + w));
                    for (int s = w; s < w + 4 && s < k; s++) outwards[c + s] = here[s - w];
                }
                further += sum;
            }
        }
    for (int r = 0; r < q->size; r++) h[(size_t)r * STRIDE + r] += 1;
}

static void second_variation(const Unknowns *q, const State *state, double *h) {
    if (q->tableau->degree == MOST_DEGREE)
        vary(q, state, MOST_DEGREE, h);
    else
        vary(q, state, COARSE_DEGREE, h);
}

/* Factors of the second variation; 0 where it is not positive definite, and so the state not stable. */
static int factor_variation(const Unknowns *q, const State *state, double *h) {
    second_variation(q, state, h);
    return cholesky(h, q->size, STRIDE);
}

/* The largest violation of the collocation equations, rad. */
static double residual_of(const Unknowns *q, const State *state) { return turn_of(q, state->gradient); }
