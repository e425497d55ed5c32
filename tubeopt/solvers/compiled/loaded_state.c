/* Cross-sections, orientation and work of a loaded arm: what block/transcription/orientation.py and loaded.py do.

   Quaternions multiply from the right along the arm: Q' = Q o u / 2. At the points of a piece that begins with Q_e,
   Q_c = Q_e o s_c, and a right side g_a of the collocated equations makes sum_a g_a o X_ac, X the inverse of a matrix of
   quaternions. The transpose of multiplying by u from the right is multiplying by its conjugate. */

#define WORK (2 * MOST_DEGREE + 4)

typedef struct {
    double inverse[MOST_DEGREE][MOST_DEGREE][4]; /* X */
    double spread[MOST_DEGREE][4], carried[4];   /* s_c, and Q at the end by Q_e */
    double own[MOST_DEGREE][MOST_DEGREE][2][4];  /* dQ_c / du_b */
    double leaving[MOST_DEGREE][2][4];           /* the same of Q at the end */
    double turn[N][MOST_DEGREE][MOST_DEGREE];    /* theta_a by the twist of each tube, whitened */
    double passed[N][MOST_DEGREE];               /* theta at the end */
    int first[N], count[N], bend, rows, whole;   /* twists of each tube, where bending follows, rows to eliminate */
    double work[WORK][WORK];                         /* its second derivative by bending and Q at the beginning */
    double matrix[WIDTH * WIDTH], map[STATE][WIDTH]; /* eliminated; the state at the end by all of it */
} Piece;

typedef struct {
    const Problem *problem;
    const Rule *rule;
    int pieces, degree, points, assembled;
    double enough, chord; /* steps, rad, below which Newton's method ends, or keeps its factors */
    double weight[MOST_POINTS], soft[MOST_POINTS]; /* B, 1 / sqrt(B K) */
    double stiff[MOST_POINTS][N][N], gain[MOST_POINTS][N][2]; /* second derivative by theta, u0' / soft, as factorised */
    double root[N][N], root_spring[N];             /* Cholesky factor where the arm is held; sqrt of `held` */
    Piece piece[MOST_PIECES];
} Stage;

typedef struct {
    double theta[MOST_POINTS][N], q[MOST_POINTS][2], curvature[MOST_POINTS][2];
    double moment[MOST_POINTS][N], slope[MOST_POINTS][N * N];              /* V', V'' */
    double turned[MOST_POINTS][N][2], second[MOST_POINTS][N][2];           /* du0 / dtheta and its derivative */
    double stage[MOST_POINTS][4], begin[MOST_PIECES + 1][4];               /* quaternions */
    double form[MOST_POINTS][4][4];                                        /* second derivative of B n.t by Q */
    double felt[MOST_POINTS][2], multiplier[MOST_POINTS][4], base[4];      /* dW/du, of the equations, dW/dQ there */
    double bending, work;                                                  /* sum B V; W of the whole load */
} State;

/* Loops of a known length are unrolled: one version of a function for each of the two rules. */
#define OF_DEGREE ALWAYS_INLINE
#define BY_DEGREE(of, ...)                                    \
    (s->degree == DEGREE         ? of(__VA_ARGS__, DEGREE)       \
     : s->degree == ROUGH_DEGREE ? of(__VA_ARGS__, ROUGH_DEGREE) \
                                 : of(__VA_ARGS__, CHECK_DEGREE))

/* Of quaternions: by the columns of multiplying from the left, which leave a loop over b. */
ALWAYS_INLINE void product(const double *a, const double *b, double *out) {
    Four whole = {a[0], a[1], a[2], a[3]}, x = {-a[1], a[0], a[3], -a[2]};
    Four y = {-a[2], -a[3], a[0], a[1]}, z = {-a[3], a[2], -a[1], a[0]};
    double b0 = b[0], b1 = b[1], b2 = b[2], b3 = b[3]; /* out may be b */
    EACH(FOUR(out) = OF(whole) * b0 + OF(x) * b1 + OF(y) * b2 + OF(z) * b3);
}

/* out += scale a o b */
ALWAYS_INLINE void add_product(double scale, const double *a, const double *b, double *out) {
    double one[4];
    product(a, b, one);
    EACH(FOUR(out) += scale * FOUR(one));
}

/* out += scale a o conj(b): the transpose of multiplying by b */
ALWAYS_INLINE void add_transposed(double scale, const double *a, const double *b, double *out) {
    double other[4] = {b[0], -b[1], -b[2], -b[3]};
    add_product(scale, a, other, out);
}

/* Curvature without load where tubes are rotated by theta. */
static void bend_freely(const Sections *at, const double *theta, double *out) {
    double direction[N];
    for (int i = 0; i < N; i++) direction[i] = theta[i] + at->phase[i];
    const double *in[3] = {direction, at->stiffness, at->moment};
    double *res[6] = {0, 0, 0, out, 0, 0};
    bending(in, res, 0, 0, 0);
}

#define ROUGH_STEP 1e-2     /* of Newton's method, rad: the last on few points, which are no better */
#define ROUGH_CHORD_STEP 0.1 /* CHORD_STEP there */

/* Weights, softness and the twist of the tubes: what rotations and load do not change. */
static void prepare(Stage *s, const Problem *p, const Rule *rule) {
    int k = s->degree = rule->degree;
    s->problem = p;
    s->rule = rule;
    s->pieces = (int)p->pieces;
    s->points = s->pieces * k;
    s->enough = k == ROUGH_DEGREE ? ROUGH_STEP : 0;
    s->chord = k == ROUGH_DEGREE ? ROUGH_CHORD_STEP : CHORD_STEP;
    for (int x = 0; x < s->points; x++) {
        double total = 0;
        for (int i = 0; i < N; i++) total += p->at[x].stiffness[i];
        s->weight[x] = p->length[x / k] * rule->weights[x % k];
        s->soft[x] = 1 / sqrt(s->weight[x] * total);
    }
    for (int i = 0; i < N; i++) s->root_spring[i] = sqrt(p->held[i]);
    for (int e = 0; e < s->pieces; e++) {
        Piece *piece = &s->piece[e];
        double h = p->length[e];
        int rows = 0;
        for (int i = 0; i < N; i++) {
            int bent = p->bent[e * N + i] > 0;
            piece->first[i] = rows;
            piece->count[i] = bent ? k : p->felt[e * N + i] > 0;
            rows += piece->count[i];
            double whole = 0;
            for (int b = 0; b < k; b++) {
                double rate = p->at[e * k + b].rate[i], root = sqrt(rate * h / rule->weights[b]);
                whole += h * rule->weights[b] * rate;
                for (int a = 0; a < k && bent; a++) piece->turn[i][a][b] = rule->matrix[a * k + b] * root;
                piece->passed[i][b] = rule->weights[b] * root;
            }
            if (!bent) piece->passed[i][0] = sqrt(whole);
        }
        piece->bend = rows;
        piece->rows = filled_up(rows + 2 * k);
        piece->whole = piece->rows + filled_up(STATE);
    }
}

/* X of a piece by elimination without pivots: its matrix is close to 1, since pieces bend little. */
OF_DEGREE void invert(const Stage *s, const State *state, int e, Piece *piece, int k) {
    double half = s->problem->length[e] / 2;
    double(*m)[MOST_DEGREE][4] = piece->inverse;
    for (int b = 0; b < k; b++)
        for (int a = 0; a < k; a++) {
            const double *u = state->curvature[e * k + b];
            double scale = -half * s->rule->matrix[a * k + b];
            double entry[4] = {a == b, scale * u[0], scale * u[1], 0};
            memcpy(m[b][a], entry, sizeof entry);
        }
    for (int p = 0; p < k; p++) {
        double pivot[4], square = dot(m[p][p], m[p][p], 4), row[4];
        for (int r = 0; r < 4; r++) pivot[r] = (r ? -1 : 1) * m[p][p][r] / square;
        for (int c = 0; c < k; c++) {
            if (c == p) continue;
            product(pivot, m[p][c], row);
            memcpy(m[p][c], row, sizeof row);
        }
        memcpy(m[p][p], pivot, sizeof pivot);
        for (int b = 0; b < k; b++) {
            if (b == p) continue;
            double factor[4];
            memcpy(factor, m[b][p], sizeof factor);
            memset(m[b][p], 0, sizeof factor);
            for (int c = 0; c < k; c++) add_product(-1, factor, m[p][c], m[b][c]);
        }
    }
}

/* Quaternions along the arm. */
static void orient(Stage *s, State *state) {
    int k = s->degree;
    memset(state->begin[0], 0, sizeof state->begin[0]);
    state->begin[0][0] = 1;
    for (int e = 0; e < s->pieces; e++) {
        Piece *piece = &s->piece[e];
        double half = s->problem->length[e] / 2;
        BY_DEGREE(invert, s, state, e, piece);
        memset(piece->carried, 0, sizeof piece->carried);
        piece->carried[0] = 1;
        for (int c = 0; c < k; c++) {
            const double *u = state->curvature[e * k + c];
            double rate[4] = {0, u[0], u[1], 0};
            for (int r = 0; r < 4; r++) {
                piece->spread[c][r] = 0;
                for (int a = 0; a < k; a++) piece->spread[c][r] += piece->inverse[a][c][r];
            }
            add_product(half * s->rule->weights[c], piece->spread[c], rate, piece->carried);
            product(state->begin[e], piece->spread[c], state->stage[e * k + c]);
        }
        product(state->begin[e], piece->carried, state->begin[e + 1]);
    }
}

/* dW/du, the multipliers of the equations and dW/dQ at the plate, from dW/dQ_c = form Q_c and nothing at the tip. */
OF_DEGREE void feel(const Stage *s, State *state, int k) {
    double ahead[4] = {0};
    for (int e = s->pieces - 1; e >= 0; e--) {
        const Piece *piece = &s->piece[e];
        double half = s->problem->length[e] / 2, multiplier[MOST_DEGREE][4] = {{0}}, before[4] = {0};
        add_transposed(1, ahead, piece->carried, before);
        for (int c = 0; c < k; c++) {
            int x = e * k + c;
            double right[4], rate[4] = {0, state->curvature[x][0], state->curvature[x][1], 0};
            for (int r = 0; r < 4; r++) right[r] = dot(state->form[x][r], state->stage[x], 4);
            add_transposed(1, right, piece->spread[c], before);
            add_transposed(half * s->rule->weights[c], ahead, rate, right);
            for (int a = 0; a < k; a++) add_transposed(1, right, piece->inverse[a][c], multiplier[a]);
        }
        for (int b = 0; b < k; b++) {
            int x = e * k + b;
            for (int r = 0; r < 4; r++) {
                double sum = s->rule->weights[b] * ahead[r];
                for (int a = 0; a < k; a++) sum += s->rule->matrix[a * k + b] * multiplier[a][r];
                state->multiplier[x][r] = half * sum;
            }
            for (int j = 0; j < 2; j++) {
                double axis[4] = {0, j == 0, j == 1, 0}, moved[4];
                product(state->stage[x], axis, moved);
                state->felt[x][j] = dot(state->multiplier[x], moved, 4);
            }
        }
        memcpy(ahead, before, sizeof ahead);
    }
    memcpy(state->base, ahead, sizeof ahead);
}

/* All of `state` from its theta and q. */
static void evaluate(Stage *s, State *state, double factor) {
    const Problem *p = s->problem;
    state->bending = state->work = s->assembled = 0;
    for (int x = 0; x < s->points; x++) {
        double direction[N], energy, natural[2];
        for (int i = 0; i < N; i++) direction[i] = state->theta[x][i] + p->at[x].phase[i];
        const double *in[3] = {direction, p->at[x].stiffness, p->at[x].moment};
        double *out[6] = {&energy,   state->moment[x],    state->slope[x],
                          natural, state->turned[x][0], state->second[x][0]};
        bending(in, out, 0, 0, 0);
        state->bending += s->weight[x] * energy;
        for (int j = 0; j < 2; j++) state->curvature[x][j] = natural[j] + s->soft[x] * state->q[x][j];
        for (int r = 0; r < 4; r++)
            for (int c = 0; c < 4; c++) {
                double sum = 0;
                for (int i = 0; i < 3; i++) sum += p->force[3 * x + i] * TANGENT[i][r][c];
                state->form[x][r][c] = 2 * s->weight[x] * sum;
            }
    }
    orient(s, state);
    BY_DEGREE(feel, s, state);
    for (int x = 0; x < s->points; x++)
        for (int r = 0; r < 4; r++)
            state->work += factor * state->stage[x][r] * dot(state->form[x][r], state->stage[x], 4) / 2;
}
