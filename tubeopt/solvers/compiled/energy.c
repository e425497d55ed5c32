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
    const Layout *layout; /* of robots side by side that of the first: all have the same but for these numbers */
    const Tubes *tubes;
    const Tableau *tableau;
    Real start[MOST_PIECES], length[MOST_PIECES], held[N];
#if ABREAST
    SectionsAbreast even[MOST_PIECES];
#endif
    int points, size, first[N], count[N];
    int piece[MOST_POINTS], place[MOST_POINTS][N], point[MOST_UNKNOWNS];
    Real s[MOST_POINTS], weight[MOST_POINTS];
    /* L of each tube within its elements, by rows and by columns, 0 above the diagonal; and one row for all points further
       out. */
    Real block[MOST_UNKNOWNS][WIDE], column[MOST_UNKNOWNS][WIDE], beyond[MOST_UNKNOWNS];
    SectionsAbreast at[MOST_POINTS];
    Real rate[MOST_PIECES][MOST_DEGREE][N];                /* 1 / kt, at the points that all pieces would have */
    Real reach[MOST_PIECES + 1][N], ahead[MOST_POINTS][N]; /* int ds / kt up to the pieces, and to the points */
} Unknowns;

typedef struct {
    Real z[MOST_UNKNOWNS], gradient[MOST_UNKNOWNS];
    Real theta[MOST_POINTS][N], moment[MOST_POINTS][N], slope[MOST_POINTS][N * N];
    Real extra[MOST_POINTS][N]; /* (g - 1) t / kt, of tubes off the centreline */
    Real energy;
} State;

/* L L' = int ds / kt up to the nearer of two points, collocated: within an element h A diag(1/b) A' takes its place. Of a
   point nearer to the base all points of an element see the same, and so do those of all elements further out. */
static int factorise(Unknowns *q, int tube) {
    const Tableau *t = q->tableau;
    const Layout *l = q->layout;
    int k = t->degree;
    Real passed = {0}; /* the square of that row */
    for (int a = q->first[tube]; a < q->first[tube] + q->count[tube]; a += k) {
        Real(*block)[WIDE] = q->block + a, (*column)[WIDE] = q->column + a, *beyond = q->beyond + a;
        int x = q->point[a], p = q->piece[x], even = l->across[p].even[tube];
        Real before = q->reach[p][tube] - passed, scale = q->length[p] * q->rate[p][0][tube];
        memset(block, 0, k * sizeof block[0]);
        memset(column, 0, k * sizeof column[0]);
        for (int i = 0; i < k; i++)
            for (int j = 0; j <= i; j++) {
                Real green = scale * t->within[i * k + j];
                if (!even) {
                    green = REAL(0.0);
                    for (int o = 0; o < k; o++) green += t->both[(i * k + j) * k + o] * q->rate[p][o][tube];
                    green *= q->length[p];
                }
                Real rest = before + green - dot(block[i], block[j], j);
                if (i == j && !ALL(rest > 0)) return 0;
                block[i][j] = column[j][i] = i == j ? sqrt(rest) : rest / block[j][j];
            }
        for (int j = 0; j < k; j++) beyond[j] = (q->ahead[x + j][tube] - passed - dot(beyond, block[j], j)) / block[j][j];
        passed += dot(beyond, beyond, k);
    }
    return 1;
}

/* A tube at fraction x of a piece. */
static inline SectionAbreast section_here(const Unknowns *q, int p, int i, double x) {
#if ABREAST
    const SectionsAbreast *at = &q->even[p];
    return (SectionAbreast){at->stiffness[i], at->moment[i], at->phase[i], at->rate[i], at->twist_angle[i]};
#else
    return section_on(q->tubes, q->layout, p, i, x);
#endif
}

static inline void put_here(SectionsAbreast *at, int i, SectionAbreast one) {
    at->stiffness[i] = one.stiffness;
    at->moment[i] = one.moment;
    at->phase[i] = one.phase;
    at->rate[i] = one.rate;
    at->twist_angle[i] = one.twist_angle;
}

/* Cross-sections at the points, and the compliances up to them. */
static void look_along(Unknowns *q) {
    const Layout *l = q->layout;
    const Tableau *t = q->tableau;
    int x = 0, degree = t->degree;
    memcpy(q->reach[0], q->held, sizeof q->held);
    for (int p = 0; p < l->pieces; p++) {
        Real h = q->length[p];
        for (int i = 0; i < N; i++) {
            Real sum = {0};
            for (int k = 0; k < degree; k++) {
                SectionAbreast here = section_here(q, p, i, t->nodes[k]);
                q->rate[p][k][i] = here.rate;
                sum += t->weights[k] * here.rate;
                if (l->collocated[p]) put_here(&q->at[x + k], i, here);
            }
            q->reach[p + 1][i] = q->reach[p][i] + h * sum;
            for (int k = 0; k < degree && l->collocated[p]; k++) {
                Real part = t->nodes[k] * q->rate[p][0][i];
                if (!l->across[p].even[i]) {
                    part = REAL(0.0);
                    for (int o = 0; o < degree; o++) part += t->matrix[k * degree + o] * q->rate[p][o][i];
                }
                q->ahead[x + k][i] = q->reach[p][i] + h * part;
            }
        }
        if (l->collocated[p]) x += degree;
    }
}

/* The numbers of a mesh, or of the meshes of robots side by side, which have the same pieces. */
static void take_layouts(Unknowns *q, const Layout *layouts) {
    for (int which = 0; which < ROBOTS; which++) {
        const Layout *l = layouts + which;
        for (int i = 0; i < N; i++) OF_ROBOT(q->held[i], which) = l->held[i];
        for (int p = 0; p < l->pieces; p++) {
            OF_ROBOT(q->start[p], which) = l->start[p];
            OF_ROBOT(q->length[p], which) = l->length[p];
#if ABREAST
            for (int i = 0; i < N; i++) {
                q->even[p].stiffness[i][which] = l->across[p].tubes.stiffness[i];
                q->even[p].moment[i][which] = l->across[p].tubes.moment[i];
                q->even[p].phase[i][which] = l->across[p].tubes.phase[i];
                q->even[p].rate[i][which] = l->across[p].tubes.rate[i];
                q->even[p].twist_angle[i][which] = l->across[p].tubes.twist_angle[i];
            }
#endif
        }
    }
}

/* The unknowns are rotations of tubes that are curved; with `all`, of those that are present. */
static int pose_unknowns(Unknowns *q, const Layout *l, const Tubes *tubes, const Tableau *t, int all) {
    q->layout = l;
    q->tubes = tubes;
    q->tableau = t;
    q->points = q->size = 0;
    take_layouts(q, l);
    for (int p = 0; p < l->pieces; p++)
        for (int k = 0; k < t->degree && l->collocated[p]; k++) {
            if (q->points == MOST_POINTS) return 0;
            q->piece[q->points] = p;
            q->s[q->points] = q->start[p] + q->length[p] * t->nodes[k];
            q->weight[q->points++] = q->length[p] * t->weights[k];
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
static void times_factor(const Unknowns *q, const Real *x, Real *out) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        Real nearer = {0};
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
static void add_by_factor(const Unknowns *q, const Real *y, Real *x) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        Real further = {0};
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
static Real turn_of(const Unknowns *q, const Real *step) {
    Real turned[MOST_UNKNOWNS];
    times_factor(q, step, turned);
    return largest(turned, q->size);
}

static void to_unknowns(const Unknowns *q, const Real *alpha, Real theta[][N], Real *z) {
    int k = q->tableau->degree;
    for (int i = 0; i < N; i++) {
        Real nearer = alpha[i];
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a += k) {
            for (int b = 0; b < k; b++) {
                const Real *row = q->block[a + b];
                z[a + b] = (theta[q->point[a + b]][i] - nearer - dot(row, z + a, b)) / row[b];
            }
            nearer += dot(q->beyond + a, z + a, k);
        }
    }
}

/* theta at all points from state->z. */
static void turn_points(const Unknowns *q, const Real *alpha, State *state) {
    Real turned[MOST_UNKNOWNS];
    times_factor(q, state->z, turned);
    for (int x = 0; x < q->points; x++) memcpy(state->theta[x], alpha, N * sizeof(Real));
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) state->theta[q->point[a]][i] += turned[a];
}

/* theta, moments, their slopes, energy and gradient at state->z. */
static void evaluate(const Unknowns *q, const Real *alpha, State *state) {
    turn_points(q, alpha, state);
    state->energy = 0.5 * dot(state->z, state->z, q->size);
    for (int x = 0; x < q->points; x++) {
        Real bending, direction[N];
        for (int i = 0; i < N; i++) direction[i] = state->theta[x][i] + q->at[x].phase[i];
        const Real *in[3] = {direction, q->at[x].stiffness, q->at[x].moment};
        Real *out[3] = {state->moment[x], state->slope[x], &bending};
        balance(in, out, 0, 0, 0);
        state->energy += q->weight[x] * bending;
    }
    Real load[MOST_UNKNOWNS];
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++)
            load[a] = q->weight[q->point[a]] * state->moment[q->point[a]][i];
    memcpy(state->gradient, state->z, q->size * sizeof(Real));
    add_by_factor(q, load, state->gradient);
}

#define FILLED(n) (((n) + 3) / 4 * 4)
#define TAIL FILLED(N)
#define BROAD (FILLED(N * MOST_DEGREE) + TAIL) /* of the matrix of an element */

/* The second variation 1 + L' B V'' L, eliminated element by element from the tip to the plate. All points further out see an
   element alike, by `beyond`: so what lies ahead of it costs a quadratic form of the turns (n) with which it passes the arm on.
   An element has rows of its unknowns, filled up to a multiple of four, then those of the turns with which it begins. */
typedef struct {
    Real matrix[MOST_PIECES][BROAD * BROAD];
} Chain;

/* Rows of the unknowns of an element, from its first point: where those of tubes begin, -1 of tubes without; their number. */
static int rows_of(const Unknowns *q, int x, int *row) {
    int rows = 0;
    for (int i = 0; i < N; i++) {
        row[i] = q->place[x][i] < 0 ? -1 : rows;
        rows += row[i] < 0 ? 0 : q->tableau->degree;
    }
    return rows;
}

/* The matrix of an element, upper triangle, with `diagonal` in place of 1. Fours that have too much are laid over by what
   comes after them. */
ALWAYS_INLINE void lay_element(const Unknowns *q, const State *state, int x, int k, Real diagonal, Real ahead[N][N], Real *h) {
    int row[N], rows = rows_of(q, x, row), from = FILLED(rows);
    for (int i = 0; i < N; i++) {
        Real value[N][MOST_DEGREE], all[N];
        int own = q->first[i] + q->place[x][i];
        const Real(*left)[WIDE] = (const Real(*)[WIDE])q->block + own, *nearer = q->beyond + own;
        for (int j = 0; j < N; j++) {
            all[j] = ahead[i][j];
            for (int b = 0; b < k && row[i] >= 0 && row[j] >= 0; b++)
                all[j] += value[j][b] = q->weight[x + b] * state->slope[x + b][j * N + i];
        }
        for (int r = 0; r < k && row[i] >= 0; r++) {
            Real *to = h + (row[i] + r) * BROAD;
            for (int j = i; j < N; j++) {
                if (row[j] < 0) continue;
                int other = q->first[j] + q->place[x][j];
                const Real(*right)[WIDE] = (const Real(*)[WIDE])q->block + other, *further = q->beyond + other;
                Real passed = nearer[r] * ahead[i][j];
                Four here[WIDE / 4];
                for (int w = 0; w < k; w += 4) EACH(OF(here[w / 4]) = passed * FOUR(further + w));
                for (int b = r; b < k; b++) {
                    Real part = left[b][r] * value[j][b];
                    for (int w = 0; w < k; w += 4) EACH(OF(here[w / 4]) += part * FOUR(right[b] + w));
                }
                for (int w = 0; w < k; w += 4) EACH(FOUR(to + row[j] + w) = OF(here[w / 4]));
            }
            to[row[i] + r] += diagonal;
            for (int j = rows; j < from + TAIL; j++) to[j] = REAL(0.0);
            for (int j = 0; j < N; j++) {
                Real sum = nearer[r] * ahead[i][j];
                for (int b = r; b < k && row[j] >= 0; b++) sum += left[b][r] * value[j][b];
                to[from + j] = sum;
            }
        }
        for (int j = 0; j < TAIL; j++) h[(from + i) * BROAD + from + j] = j < N ? all[j] : REAL(0.0);
    }
    for (int r = rows; r < from; r++)
        for (int j = r; j < from + TAIL; j++) h[r * BROAD + j] = REAL((double)(r == j));
    for (int r = from + N; r < from + TAIL; r++)
        for (int j = from; j < from + TAIL; j++) h[r * BROAD + j] = REAL(0.0);
}

/* Factors of the second variation, with `diagonal` in place of 1, of tubes whose ends springs (N) hold, or NULL; 0 where it
   is not positive definite. */
static Truth factor_held(const Unknowns *q, const State *state, Real diagonal, const double *springs, Chain *chain) {
    Real ahead[N][N];
    Truth positive = YES;
    int k = q->tableau->degree, row[N];
    memset(ahead, 0, sizeof ahead);
    for (int i = 0; i < N && springs; i++) ahead[i][i] = REAL(springs[i]);
    for (int x = q->points - k; x >= 0 && ANY(positive); x -= k) {
        Real *h = chain->matrix[x / k];
        int from = FILLED(rows_of(q, x, row));
        if (k == MOST_DEGREE)
            lay_element(q, state, x, MOST_DEGREE, diagonal, ahead, h);
        else
            lay_element(q, state, x, COARSE_DEGREE, diagonal, ahead, h);
        positive &= eliminate(h, from, from + TAIL, BROAD);
        for (int i = 0; i < N; i++)
            for (int j = i; j < N; j++) ahead[i][j] = ahead[j][i] = h[(from + i) * BROAD + from + j];
    }
    return positive;
}

/* The same of free tubes: with 1, not positive definite is not stable. */
static Truth factor_variation(const Unknowns *q, const State *state, Real diagonal, Chain *chain) {
    return factor_held(q, state, diagonal, NULL, chain);
}

/* x <- (1 + L' B V'' L)^-1 x */
static void solve_variation(const Unknowns *q, const Chain *chain, Real *x) {
    Real local[BROAD], turn[N];
    int k = q->tableau->degree, row[N];
    for (int back = 0; back < 2; back++) {
        memset(turn, 0, sizeof turn);
        for (int e = 0; e < q->points / k; e++) {
            int p = back ? e * k : q->points - k - e * k, from = FILLED(rows_of(q, p, row));
            const Real *h = chain->matrix[p / k];
            memset(local, 0, sizeof local);
            memcpy(local + from, turn, sizeof turn);
            for (int i = 0; i < N; i++) {
                int own = q->first[i] + q->place[p][i];
                for (int b = 0; b < k && row[i] >= 0; b++)
                    local[row[i] + b] = back ? x[own + b] : x[own + b] + q->beyond[own + b] * turn[i];
            }
            if (back)
                eliminate_backwards(h, from, from + TAIL, BROAD, local);
            else
                eliminate_forwards(h, from, from + TAIL, BROAD, local);
            for (int i = 0; i < N; i++) {
                int own = q->first[i] + q->place[p][i];
                if (!back) turn[i] = local[from + i];
                if (row[i] < 0) continue;
                memcpy(x + own, local + row[i], k * sizeof(Real));
                if (back) turn[i] += dot(q->beyond + own, x + own, k);
            }
        }
    }
}

/* What is factorised, and where not NULL a vector r (with solved = H^-1 r): then it is H + r r'. */
typedef struct {
    const Unknowns *q;
    const Chain *chain;
    const Real *raised, *solved;
} Factored;

static void by_factors(const void *of, Real *x) {
    const Factored *f = of;
    int n = f->q->size;
    solve_variation(f->q, f->chain, x);
    if (!f->raised) return;
    Real along = dot(f->raised, x, n) / (1 + dot(f->raised, f->solved, n));
    for (int r = 0; r < n; r++) x[r] -= along * f->solved[r];
}

/* Least eigenvalue of what is factorised, the largest of its inverse. */
static Real least_eigenvalue(Factored of, double small, double apart, Truth skipped, Real *vector) {
    Real basis[LANCZOS + 1][MOST_UNKNOWNS];
    Krylov inverse = {by_factors, &of, 1, of.q->size, LANCZOS, MOST_UNKNOWNS, NOT(YES), small, apart, 1, basis[0], skipped};
    return 1 / largest_of(&inverse, vector);
}

/* The largest violation of the collocation equations, rad. */
static Real residual_of(const Unknowns *q, const State *state) { return turn_of(q, state->gradient); }
