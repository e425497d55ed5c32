/* Newton's method on a loaded arm, its margin, and the continuation from no load: what solvers/newton.py and
   equilibrium/continuation.py do. */

/* The change of q that goes with one of theta (N) at a point and of p. */
static double change_of_q(const Stage *s, int x, int j, const double *theta, double p) {
    for (int i = 0; i < N; i++) p -= s->gain[x][i][j] * theta[i];
    return p;
}

/* Newton's step: theta - alpha itself is unknown, not its change, so that no twists need be kept; p is a change. */
static void newton_step(const Stage *s, const State *state, const double *alpha, double factor, Step *step, int turned) {
    Functional *by = &step->by;
    memset(by->end, 0, sizeof by->end);
    by->has_orientation = by->has_twist = 0;
    for (int x = 0; x < s->points; x++) {
        double pull[2], twist[N];
        for (int i = 0; i < N; i++) twist[i] = state->theta[x][i] - alpha[i];
        for (int j = 0; j < 2; j++) {
            pull[j] = state->q[x][j] - s->soft[x] * factor * state->felt[x][j];
            by->bend[x][j] = pull[j];
            for (int i = 0; i < N; i++) by->bend[x][j] += s->gain[x][i][j] * twist[i];
        }
        for (int i = 0; i < N; i++)
            by->theta[x][i] = s->weight[x] * state->moment[x][i] - factor * dot(state->felt[x], state->turned[x][i], 2) -
                              dot(s->gain[x][i], pull, 2) - dot(s->stiff[x][i], twist, N);
    }
    sweep_back(s, by, step);
    sweep_forth(s, step, turned);
    for (int x = 0; x < s->points; x++)
        for (int i = 0; i < N; i++) step->theta[x][i] += alpha[i];
}

/* The largest change of a rotation that is unknown between theta (points, N) and the state, rad. */
static double largest_turn(const Stage *s, const State *state, const double (*theta)[N]) {
    double out = 0;
    for (int x = 0; x < s->points; x++)
        for (int i = 0; i < N; i++)
            if (s->piece[x / s->degree].count[i] == s->degree) out = fmax(out, fabs(theta[x][i] - state->theta[x][i]));
    return out;
}

/* The largest turn that a step makes, rad: of a tube, or of the arm if curvature changed alike all along it. */
static double size_of(const Stage *s, const State *state, const Step *step) {
    double out = largest_turn(s, state, step->theta);
    for (int x = 0; x < s->points; x++)
        for (int j = 0; j < 2; j++) out = fmax(out, s->problem->whole * s->soft[x] * fabs(step->bend[x][j]));
    return out;
}

/* state += scale of a step; with `whole` it has theta itself. */
static void take(const Stage *s, State *state, const Step *step, double scale, int whole) {
    for (int x = 0; x < s->points; x++) {
        const Piece *piece = &s->piece[x / s->degree];
        double change[N];
        for (int i = 0; i < N; i++)
            change[i] = piece->count[i] == s->degree ? step->theta[x][i] - (whole ? state->theta[x][i] : 0) : 0;
        for (int j = 0; j < 2; j++) state->q[x][j] += scale * change_of_q(s, x, j, change, step->bend[x][j]);
        for (int i = 0; i < N; i++) state->theta[x][i] += scale * change[i];
    }
}

/* Torque and elastic rotation of the tubes by the torque that a state asks for. */
typedef struct {
    double per_length[MOST_POINTS][N], torque[MOST_POINTS][N];
    double twist[MOST_PIECES + 1][N], theta[MOST_PIECES + 1][N];
} Torsion;

static void twist_tubes(const Stage *s, const State *state, const double *alpha, double factor, Torsion *out) {
    const Problem *p = s->problem;
    int k = s->degree;
    for (int x = 0; x < s->points; x++)
        for (int i = 0; i < N; i++)
            out->per_length[x][i] =
                state->moment[x][i] - factor * dot(state->felt[x], state->turned[x][i], 2) / s->weight[x];
    memset(out->twist[s->pieces], 0, sizeof out->twist[0]);
    for (int e = s->pieces - 1; e >= 0; e--)
        for (int i = 0; i < N; i++) {
            out->twist[e][i] = out->twist[e + 1][i];
            for (int b = 0; b < k; b++) out->twist[e][i] -= s->weight[e * k + b] * out->per_length[e * k + b][i];
        }
    for (int i = 0; i < N; i++) out->theta[0][i] = alpha[i] + p->held[i] * out->twist[0][i];
    for (int e = 0; e < s->pieces; e++)
        for (int i = 0; i < N; i++) {
            out->theta[e + 1][i] = out->theta[e][i];
            for (int a = 0; a < k; a++) {
                double torque = out->twist[e][i];
                for (int b = 0; b < k; b++)
                    torque += p->length[e] * s->rule->matrix[a * k + b] * out->per_length[e * k + b][i];
                out->torque[e * k + a][i] = torque;
                out->theta[e + 1][i] += s->weight[e * k + a] * p->at[e * k + a].rate[i] * torque;
            }
        }
}

/* The largest violation of the equations, as an error of theta at the points or of the arm's direction, rad. */
static double residual_of(const Stage *s, const State *state, const double *alpha, double factor, Torsion *torsion) {
    const Problem *p = s->problem;
    int k = s->degree;
    double out = 0;
    twist_tubes(s, state, alpha, factor, torsion);
    for (int x = 0; x < s->points; x++) {
        int e = x / k;
        for (int i = 0; i < N; i++) {
            if (s->piece[e].count[i] < k) continue;
            double theta = torsion->theta[e][i];
            for (int b = 0; b < k; b++)
                theta += p->length[e] * s->rule->matrix[x % k * k + b] * p->at[e * k + b].rate[i] *
                         torsion->torque[e * k + b][i];
            out = fmax(out, fabs(theta - state->theta[x][i]));
        }
        for (int j = 0; j < 2; j++) {
            double bent = state->q[x][j] - s->soft[x] * factor * state->felt[x][j];
            out = fmax(out, p->whole * s->soft[x] * fabs(bent));
        }
    }
    return out;
}

/* Whether Newton's method is at ease at the factor, where successive steps shrink to LARGEST_RATIO of one another, and ends
   at a stable equilibrium, whose factors are left: on few points, which only lead to an answer, the last that it made. The
   factors of a step that is small serve for the next. */
static int at_ease(Stage *s, State *state, const double *alpha, double factor, Step *step, Answer *out) {
    Torsion torsion;
    double last = INFINITY;
    int fresh = 1;
    evaluate(s, state, factor);
    for (int n = 0; n < MOST_ITERATIONS; n++) {
        out->iterations++;
        if (fresh && !factorise(s, state, factor, 1)) return 0;
        newton_step(s, state, alpha, factor, step, 0);
        double size = size_of(s, state, step);
        /* Where steps shrink by less, the end may be another branch: it is for the continuation to come closer. */
        if (!isfinite(size) || size > 1e3 || (size > LAST_STEP && size > LARGEST_RATIO * last)) return 0;
        take(s, state, step, 1, 1);
        evaluate(s, state, factor);
        if (s->enough > 0 && size <= s->enough) return 1;
        if (size <= LAST_STEP && (size <= ROUND_OFF || residual_of(s, state, alpha, factor, &torsion) <= ROUND_OFF))
            return factorise(s, state, factor, 1);
        fresh = size > s->chord;
        last = size;
    }
    return 0;
}

typedef struct {
    const Stage *stage;
    Step *step;
} Softness;

/* What Lanczos' method works in, and the whitened direction where it ends. */
typedef struct {
    double basis[LANCZOS + 1][MOST_UNKNOWNS], vector[MOST_UNKNOWNS];
} Room;

/* x <- H^-1 x in the whitened unknowns: twists where the tubes are held and along them, then bending q. */
static void soften(const void *of, double *x) {
    const Softness *given = of;
    const Stage *s = given->stage;
    Functional *by = &given->step->by;
    double *at = x;
    memset(by->end, 0, sizeof by->end);
    by->has_orientation = 0;
    by->has_twist = 1;
    memcpy(by->held, at, sizeof by->held);
    at += N;
    for (int e = 0; e < s->pieces; e++)
        for (int i = 0; i < N; at += s->piece[e].count[i++])
            memcpy(by->twist[e] + i * MOST_DEGREE, at, s->piece[e].count[i] * sizeof(double));
    for (int y = 0; y < s->points; y++, at += 2) {
        memcpy(by->bend[y], at, sizeof by->bend[y]);
        for (int i = 0; i < N; i++) {
            by->theta[y][i] = 0;
            for (int j = 0; j < 2; j++) by->theta[y][i] -= s->gain[y][i][j] * at[j];
        }
    }
    sweep_back(s, by, given->step);
    sweep_forth(s, given->step, 0);
    at = x;
    for (int i = 0; i < N; i++) *at++ = -given->step->held[i];
    for (int e = 0; e < s->pieces; e++)
        for (int i = 0; i < N; i++)
            for (int b = 0; b < s->piece[e].count[i]; b++) *at++ = -given->step->twist[e][i * MOST_DEGREE + b];
    for (int y = 0; y < s->points; y++)
        for (int j = 0; j < 2; j++)
            *at++ = -change_of_q(s, y, j, given->step->theta[y], given->step->bend[y][j]);
}

/* Number of whitened unknowns. */
static int unknowns_of(const Stage *s) {
    int n = N + 2 * s->points;
    for (int e = 0; e < s->pieces; e++) n += s->piece[e].bend;
    return n;
}

/* theta and q at the points of another rule on the same pieces, `basis` being the Lagrange basis of this one there. */
static void carry_over(const Stage *from, const State *state, const Stage *to, const double *basis, State *out) {
    int k = from->degree, m = to->degree;
    for (int x = 0; x < to->points; x++) {
        const double *row = basis + (x % m) * k;
        int first = x / m * k;
        for (int i = 0; i < N; i++) {
            out->theta[x][i] = 0;
            for (int b = 0; b < k; b++) out->theta[x][i] += row[b] * state->theta[first + b][i];
        }
        for (int j = 0; j < 2; j++) {
            double bend = 0;
            for (int b = 0; b < k; b++) bend += row[b] * from->soft[first + b] * state->q[first + b][j];
            out->q[x][j] = bend / to->soft[x];
        }
    }
}

/* The same of a direction in the whitened unknowns. */
static void carry_direction(const Stage *stage, const double *from, const Stage *other, const double *basis, double *to) {
    const Problem *p = stage->problem, *there = other->problem;
    int k = stage->degree, m = other->degree;
    memcpy(to, from, N * sizeof(double));
    from += N;
    to += N;
    for (int e = 0; e < stage->pieces; e++)
        for (int i = 0; i < N; i++) {
            int bent = stage->piece[e].count[i] == k;
            for (int a = 0; a < m && bent; a++) {
                to[a] = 0;
                for (int b = 0; b < k; b++)
                    to[a] += basis[a * k + b] * from[b] * sqrt(p->at[e * k + b].rate[i] / stage->rule->weights[b]);
                to[a] *= sqrt(other->rule->weights[a] / there->at[e * m + a].rate[i]);
            }
            if (!bent && stage->piece[e].count[i]) *to = *from;
            from += stage->piece[e].count[i];
            to += other->piece[e].count[i];
        }
    for (int x = 0; x < other->points; x++, to += 2)
        for (int j = 0; j < 2; j++) {
            to[j] = 0;
            for (int b = 0; b < k; b++) {
                int y = x / m * k + b;
                to[j] += basis[x % m * k + b] * stage->soft[y] * from[2 * y + j] / other->soft[x];
            }
        }
}

/* Least eigenvalue of what is factorised, with its vector; `settled` where it is sure to `small`, see Lanczos. */
static double least_factorised(const Stage *s, double small, double apart, int most, Step *step, Room *room, int *settled) {
    Softness of = {s, step};
    Krylov inverse = {soften, &of, 1, unknowns_of(s), most, MOST_UNKNOWNS, 0, small, apart, 1, room->basis[0], 0};
    double largest = largest_of(&inverse, room->vector);
    *settled = inverse.settled;
    return 1 / largest;
}

#define FIRST_LANCZOS 12     /* steps after which Lanczos' method searches a better start: */
#define BEYOND 1.2           /* so many times as far below 1 as the margin expected, */
#define LEAST_SOFTENING 1e-6 /* but at least so far */
#define MARGIN_APART 0.1     /* margins closer to 1 do not shorten the steps of a load, whatever they are */
#define PREDICTED_PART 0.9   /* of the largest change in one step of a load, what the first derivative may make */

/* About the margin, where the second variation is factorised; of margins closer to 1 than `apart` no more than that. */
static double rough_margin(const Stage *s, double apart, Step *step, Room *room) {
    int settled;
    anywhere(room->vector, unknowns_of(s));
    return fmin(1, least_factorised(s, SOFTENING_ERROR, apart, FIRST_LANCZOS, step, room, &settled));
}

/* The margin of a stable state under the whole load, at most 1, with its vector, for which there is a guess; `near` is
   about what to expect, NaN if that is not known. Eigenvalues gather at 1, and the least may be close to them: of the
   second variation less mu, mu not far below the least, it is far away from all others. Takes factors of the second
   variation, and leaves others. */
static double margin_of(Stage *s, const State *state, double near, double small, Step *step, Room *room) {
    double elastic = isnan(near) ? 1 : fmin(1, fmax(BEYOND * (1 - near), LEAST_SOFTENING)), margin = 1;
    int settled = 0, ready = elastic == 1; /* factors of the second variation itself are there */
    for (int tries = 0; tries < 6 && !settled; tries++, ready = 0) {
        while (!ready && !factorise(s, state, 1, elastic)) {
            if (elastic == 1) return -1;
            elastic = fmin(1, 3 * elastic);
        }
        margin = 1 - elastic + least_factorised(s, small, 0, tries < 5 ? FIRST_LANCZOS : LANCZOS, step, room, &settled);
        elastic = fmin(1, fmax(BEYOND * (1 - margin), LEAST_SOFTENING));
    }
    return fmin(1, margin);
}

/* From no load, where the margin is `near`, to the whole: predicted along the tangent of the branch, corrected, and
   shortened where that fails. */
static int grow(Stage *s, const double *alpha, double near, Room *room, State *grown, State *trial, Step *step,
                Answer *out) {
    double longest = 1;
    State *state = grown;
    evaluate(s, state, 0);
    if (!factorise(s, state, 0, 1)) return DECLINED;
    for (double t = 0; t < 1;) {
        double moved = 0, rate = 0;
        Functional *by = &step->by;
        memset(by, 0, sizeof *by);
        for (int x = 0; x < s->points; x++)
            for (int j = 0; j < 2; j++) by->bend[x][j] = -s->soft[x] * state->felt[x][j];
        sweep_back(s, by, step);
        sweep_forth(s, step, 1);
        for (int x = 0; x < s->points; x++) {
            rate = fmax(rate, 2 * sqrt(dot(step->orientation[x], step->orientation[x], 4)));
            for (int i = 0; i < N; i++) rate = fmax(rate, s->piece[x / s->degree].count[i] == s->degree ? fabs(step->theta[x][i]) : 0);
        }
        longest = fmin(longest, PREDICTED_PART * LONGEST_TWIST(near) / fmax(rate, 1e-300));
        double goal = t + longest >= 1 - 1e-12 ? 1 : t + longest;
        memcpy(trial->theta, state->theta, s->points * sizeof trial->theta[0]);
        memcpy(trial->q, state->q, s->points * sizeof trial->q[0]);
        take(s, trial, step, goal - t, 0);
        int done = at_ease(s, trial, alpha, goal, step, out);
        for (int x = 0; x < s->points && done; x++) {
            double square = 0;
            for (int r = 0; r < 4; r++) square += pow(trial->stage[x][r] - state->stage[x][r], 2);
            moved = fmax(moved, 2 * sqrt(square));
        }
        if (done && fmax(moved, largest_turn(s, trial, (const double(*)[N])state->theta)) <= LONGEST_TWIST(near)) {
            State *last = state;
            state = trial;
            trial = last;
            t = goal;
            longest = fmin(2 * longest, 1);
            if (t < 1) near = rough_margin(s, MARGIN_APART, step, room);
            continue;
        }
        longest /= 3; /* tangents are of first order: what is off falls to a ninth */
        if (longest < SHORTEST_LOAD_STEP) return DECLINED;
        evaluate(s, state, t); /* the factors are those of another state now */
        if (!factorise(s, state, t, 1)) return DECLINED;
    }
    if (state != grown) *grown = *state;
    return SOLVED;
}

/* The equilibrium close to that from which `state` comes, of this margin. */
static int settle(Stage *s, const double *alpha, double margin, State *state, State *start, Step *step, Answer *out) {
    memcpy(start->theta, state->theta, s->points * sizeof start->theta[0]);
    memcpy(start->q, state->q, s->points * sizeof start->q[0]);
    if (!at_ease(s, state, alpha, 1, step, out)) return DECLINED;
    double moved = largest_turn(s, state, (const double(*)[N])start->theta);
    for (int x = 0; x < s->points; x++)
        for (int j = 0; j < 2; j++) {
            double bent = s->soft[x] * (state->q[x][j] - start->q[x][j]);
            for (int i = 0; i < N; i++)
                if (s->piece[x / s->degree].count[i] == s->degree)
                    bent += state->turned[x][i][j] * (state->theta[x][i] - start->theta[x][i]);
            moved = fmax(moved, s->problem->whole * fabs(bent));
        }
    return moved <= LONGEST_TWIST(margin) ? SOLVED : DECLINED;
}
