/* What joint values, and a small wrench at the tip, change at a solved equilibrium of concentric tubes: the linear algebra
   of equilibrium/derivatives.py and margin.py on the condensed unknowns.

   At fixed arc lengths theta = alpha - C W M(theta), C the torsional compliance, W the weights. Where e is what changes on
   the right-hand side with theta held, d theta = L H^-1 L^-1 e, with C = L L' and H the second variation. A breakpoint
   that moves uncovers a stretch of another cross-section, which kicks the twist there and bends the arm. */

#define FLAT (1 - 1e-9)   /* margin above which nothing softens */
#define MODE_ERROR 1e-22 /* square of how far off its direction may be */
#define ONE_VALUE 1e-9   /* between eigenvalues that are one */

typedef struct {
    double position[3][2 * N], turn[3][2 * N]; /* of the tip by rotations, then translations: per rad and per m */
    double tip_rotations[N][2 * N], margin[2 * N], energy[2 * N];
    double compliance[6][6]; /* force and moment -> translation and turn of the tip, world axes, at no load */
} Slopes;

/* What is asked of them. Tubes of one carriage move together, and share its slope; where breakpoints coincide, it is that
   towards the carriage's side, 1 or -1. The compliance, half of the work, where it is not 0; of a margin that two modes
   share, no slope (NAN) where `either` is 0, else that of one of them. */
typedef struct {
    long long carriage[N], side[N], compliance, either;
} Asked;

/* The solved arm at the points of all pieces, and how the margin leans on them. */
typedef struct {
    double theta[MOST_POINTS][N], bend_slope[MOST_POINTS][2 * N]; /* u_theta by columns */
    double frame[MOST_POINTS][9], position[MOST_POINTS][3];
    double lean[MOST_POINTS][N], form; /* gradient of y'V''y by theta, weighted, at the collocated points; its integral */
    Profile mode, change;              /* y times 1 - margin */
    double moments[MOST_PIECES][MOST_DEGREE * N], kicks[MOST_PIECES + 1][N];
    double shift[MOST_SHAPE][3]; /* of the shape points by a joint */
} Around;

/* (m, 3, 2 N) of the shape points by joints, as the tip's. */
typedef double Along[3][2 * N];

/* A breakpoint that a carriage moves: the piece that begins there; tubes that are there, and those that bend, on the
   stretch that it uncovers and on what was there. */
typedef struct {
    int piece, present[2][N], curved[2][N];
} Jump;

static void add_cross(const double *a, const double *b, double *out) {
    for (int r = 0; r < 3; r++) out[r] += a[(r + 1) % 3] * b[(r + 2) % 3] - a[(r + 2) % 3] * b[(r + 1) % 3];
}

/* Tubes that are there, and those that bend, at arc length s, with those of a carriage moved on by `moved`. */
static void tubes_at(const Unknowns *q, const long long *carriage, long long own, double moved, double s, int *present,
                     int *curved) {
    for (int i = 0; i < N; i++) {
        double by = carriage[i] == own ? moved : 0, end = q->layout->end[i] + by;
        present[i] = s < end;
        curved[i] = present[i] && q->tubes->straight[i] - q->layout->transmission[i] + by < s;
    }
}

/* The breakpoints in front of the plate that a carriage moves towards `side`, each place once. */
static int jumps_of(const Unknowns *q, const long long *carriage, long long own, int side, Jump *jumps) {
    const Layout *l = q->layout;
    double places[2 * N], nudge = side * ROUND_OFF_LENGTH;
    int count = 0, kept = 0;
    for (int i = 0; i < N; i++) {
        double begin = q->tubes->straight[i] - l->transmission[i];
        if (carriage[i] != own) continue;
        places[count++] = l->end[i];
        if (l->end[i] - begin > ROUND_OFF_LENGTH) places[count++] = begin;
    }
    qsort(places, count, sizeof(double), compare);
    for (int k = 0; k < count; k++) {
        Jump *jump = jumps + kept;
        double s = places[k];
        if (!(s > -nudge) || (k && s - places[k - 1] <= ROUND_OFF_LENGTH)) continue;
        tubes_at(q, carriage, own, 2 * nudge, s + nudge, jump->present[0], jump->curved[0]);
        tubes_at(q, carriage, own, 0, s + nudge, jump->present[1], jump->curved[1]);
        if (!memcmp(jump->present[0], jump->present[1], sizeof jump->present[0]) &&
            !memcmp(jump->curved[0], jump->curved[1], sizeof jump->curved[0]))
            continue;
        jump->piece = 0;
        while (jump->piece < l->pieces && l->start[jump->piece] < s - 2 * ROUND_OFF_LENGTH) jump->piece++;
        kept++;
    }
    return kept;
}

/* Cross-section on what a jump uncovers (0) or what was there (1); 0 where there is no tube. */
static int section_at(const Tubes *t, const Jump *jump, int which, double *kb, double *m) {
    int any = 0;
    for (int i = 0; i < N; i++) {
        kb[i] = jump->present[which][i] ? t->kb[i] : 0;
        m[i] = jump->curved[which][i] ? t->kb[i] * t->curvature[i] : 0;
        any |= jump->present[which][i];
    }
    return any;
}

/* What w' (n), u (2), the energy per length and, with a mode y, y'V''y gain at a jump with rotations theta. */
static double gains_of(const Tubes *t, const Jump *jump, int side, const double *theta, const double *y, double *kick,
                       double *bend, double *stored) {
    double form = 0;
    memset(kick, 0, N * sizeof(double));
    bend[0] = bend[1] = *stored = 0;
    for (int which = 0; which < 2; which++) {
        double kb[N], m[N], moment[N], slope[N * N], gradient[3 * N], energy, u[2], part, sign = which ? -side : side;
        if (!section_at(t, jump, which, kb, m)) continue;
        const double *in[4] = {theta, kb, m, y};
        double *balanced[3] = {moment, slope, &energy}, *bent[1] = {u}, *varied[2] = {&part, gradient};
        balance(in, balanced, 0, 0, 0);
        curvature(in, bent, 0, 0, 0);
        variation(in, varied, 0, 0, 0);
        for (int i = 0; i < N; i++) kick[i] += sign * moment[i] / t->kt[i];
        for (int j = 0; j < 2; j++) bend[j] += sign * u[j];
        *stored += sign * energy;
        form += sign * part;
    }
    return form;
}

/* theta of a tube at point b of piece p. */
static double inside(const Unknowns *q, const Profile *arm, int p, int b, int i) {
    double h = q->layout->length[p], bent = 0;
    int k = q->tableau->degree;
    for (int c = 0; c < k; c++) bent += TWICE_INSIDE[b * k + c] * arm->moment[p][c * N + i];
    return arm->rotation[p][i] + h * (q->tableau->nodes[b] * arm->twist[p][i] + h * bent);
}

/* Frame and position at point b of piece p: polynomials through the shape points with the slopes R hat(u), R e3 there. */
static void pose_inside(const Answer *out, double h, int p, int b, double *frame, double *position) {
    const double *row = POSE_INSIDE + b * (2 * STEPS + 1);
    memset(frame, 0, 9 * sizeof(double));
    memset(position, 0, 3 * sizeof(double));
    for (int e = 0; e < 2 * STEPS + 1; e++) {
        int at = p * STEPS + (e <= STEPS ? e : e - STEPS);
        const double *f = out->frame[at], *u = out->curvature[at];
        for (int r = 0; r < 3; r++, f += 3) {
            double turned[3] = {-u[1] * f[2], u[0] * f[2], u[1] * f[0] - u[0] * f[1]};
            for (int c = 0; c < 3; c++) frame[3 * r + c] += row[e] * (e <= STEPS ? f[c] : h * turned[c]);
            position[r] += row[e] * (e <= STEPS ? out->position[at][r] : h * f[2]);
        }
    }
}

/* The arm at the points of all pieces. */
static void look_around(const Unknowns *q, const Profile *arm, const Answer *out, Around *a) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    for (int p = 0; p < l->pieces; p++)
        for (int b = 0; b < k; b++) {
            int x = p * k + b;
            for (int i = 0; i < N; i++) a->theta[x][i] = inside(q, arm, p, b, i);
            const double *in[3] = {a->theta[x], l->stiffness[p], l->moment[p]};
            double *res[1] = {a->bend_slope[x]};
            curvature_slope(in, res, 0, 0, 0);
            pose_inside(out, l->length[p], p, b, a->frame[x], a->position[x]);
        }
}

/* V''y over kt at the collocated points, from y of the unknowns, added to a->moments. */
static void add_stiffness(const Unknowns *q, const State *state, const double *y, Around *a) {
    int k = q->tableau->degree;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int j = 0; j < N; j++)
                if (q->place[x][j] >= 0) sum += state->slope[x][j * N + i] * y[q->first[j] + q->place[x][j]];
            a->moments[q->piece[x]][x % k * N + i] += sum / q->tubes->kt[i];
        }
}

/* a->change by base rotations and what is in a->moments and a->kicks, and by what theta answers to these; H factorised. */
static void respond(const Unknowns *q, const State *state, const double *h, const double *base, Around *a) {
    static const double none[N];
    double theta[MOST_POINTS][N], e[MOST_UNKNOWNS], change[MOST_UNKNOWNS];
    int k = q->tableau->degree;
    memcpy(a->change.moment, a->moments, sizeof a->moments);
    turn_along(q, base, a->kicks, &a->change);
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) theta[x][i] = inside(q, &a->change, q->piece[x], x % k, i);
    to_unknowns(q, none, theta, e);
    cholesky_solve(h, q->size, STRIDE, e);
    times_factor(q, e, change);
    add_stiffness(q, state, change, a);
    memcpy(a->change.moment, a->moments, sizeof a->moments);
    turn_along(q, base, a->kicks, &a->change);
}

/* The mode of the margin along the arm, and how y'V''y leans on theta. */
static void lean_of_margin(const Unknowns *q, const State *state, const double *z, double released, Around *a) {
    static const double none[N];
    double y[MOST_UNKNOWNS];
    times_factor(q, z, y);
    memset(a->moments, 0, sizeof a->moments);
    add_stiffness(q, state, y, a);
    memcpy(a->mode.moment, a->moments, sizeof a->moments);
    turn_along(q, none, NULL, &a->mode);
    a->form = 0;
    for (int x = 0; x < q->points; x++) {
        double at[N] = {0}, form, gradient[3 * N], *res[2] = {&form, gradient};
        const double *in[4] = {state->theta[x], q->layout->stiffness[q->piece[x]], q->layout->moment[q->piece[x]], at};
        for (int j = 0; j < N; j++)
            if (q->place[x][j] >= 0) at[j] = released * y[q->first[j] + q->place[x][j]];
        variation(in, res, 0, 0, 0);
        a->form += q->weight[x] * form;
        for (int i = 0; i < N; i++) a->lean[x][i] = q->weight[x] * gradient[i];
    }
}

/* Shift and turn of the tip (6: position, turn) by a->change, and by bends of `sway` (or NULL) beside it at the points;
   into `shift` (or NULL) that of the shape points, at fixed arc lengths. Up to s the arm turns by int R du, and a point
   there moves by that turn x p(s) less int R du x p. */
static void tip_change(const Unknowns *q, const Answer *out, const Around *a, const double (*sway)[2], double *tip,
                       double (*shift)[3]) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    double turned[6] = {0}; /* int R du x p, int R du */
    for (int r = 0; r < 3 && shift; r++) shift[0][r] = 0;
    for (int p = 0; p < l->pieces; p++) {
        double rate[MOST_DEGREE][6] = {{0}}, begun[6];
        memcpy(begun, turned, sizeof begun);
        for (int b = 0; b < k; b++) {
            int x = p * k + b;
            double u[2] = {sway ? sway[x][0] : 0, sway ? sway[x][1] : 0};
            for (int i = 0; i < N; i++) {
                double by = inside(q, &a->change, p, b, i);
                for (int j = 0; j < 2; j++) u[j] += a->bend_slope[x][2 * i + j] * by;
            }
            for (int r = 0; r < 3; r++)
                rate[b][3 + r] = l->length[p] * (a->frame[x][3 * r] * u[0] + a->frame[x][3 * r + 1] * u[1]);
            add_cross(rate[b] + 3, a->position[x], rate[b]);
            for (int r = 0; r < 6; r++) turned[r] += q->tableau->weights[b] * rate[b][r];
        }
        for (int e = 1; e <= STEPS && shift; e++) {
            int at = p * STEPS + e;
            double up_to[6];
            memcpy(up_to, begun, sizeof begun);
            for (int b = 0; b < k; b++)
                for (int r = 0; r < 6; r++) up_to[r] += ONCE_UP_TO[e * k + b] * rate[b][r];
            for (int r = 0; r < 3; r++) shift[at][r] = -up_to[r];
            add_cross(up_to + 3, out->position[at], shift[at]);
        }
    }
    for (int r = 0; r < 3; r++) {
        tip[r] = -turned[r];
        tip[3 + r] = turned[3 + r];
    }
    add_cross(turned + 3, out->position[l->pieces * STEPS], tip);
}

/* Whether a carriage that moves towards `side` takes the end of the arm along. */
static int pushes(const Unknowns *q, const Answer *out, const long long *carriage, long long own, int side) {
    int mine = 0, others = 0;
    for (int i = 0; i < N; i++) {
        if (fabs(q->layout->end[i] - out->arc_length[q->layout->pieces * STEPS]) > ROUND_OFF_LENGTH) continue;
        if (carriage[i] == own)
            mine = 1;
        else
            others = 1;
    }
    return mine && (side > 0 || !others);
}

/* Where a tube ends: the piece that begins there. */
static int ending(const Layout *l, int tube) {
    int p = 0;
    while (p < l->pieces && l->start[p] < fmax(l->end[tube], 0) - ROUND_OFF_LENGTH) p++;
    return p;
}

/* The change a->change and `tip` (6) as column c of all slopes; `formed`: what y'V''y gains beside theta. */
static void put_column(const Unknowns *q, const Answer *out, const Around *a, const double *tip, double formed, int c,
                       double share, Slopes *slopes, Along *along) {
    int k = q->tableau->degree, last = q->layout->pieces * STEPS;
    for (int at = 0; at <= last && along; at++)
        for (int r = 0; r < 3; r++) along[at][r][c] = share * (at < last ? a->shift[at][r] : tip[r]);
    for (int r = 0; r < 3; r++) {
        slopes->position[r][c] = share * tip[r];
        slopes->turn[r][c] = share * tip[3 + r];
    }
    for (int i = 0; i < N; i++) slopes->tip_rotations[i][c] = share * a->change.rotation[ending(q->layout, i)][i];
    slopes->margin[c] = 0;
    if (out->margin >= FLAT) return;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) formed += a->lean[x][i] * inside(q, &a->change, q->piece[x], x % k, i);
    slopes->margin[c] = -share * (1 - out->margin) / a->form * formed;
}

/* What a turn of the arm beyond shape point `from` shifts the point `at` by, added to `shift`. */
static void swing(const Answer *out, const double *turn, int from, int at, double *shift) {
    double lever[3];
    for (int r = 0; r < 3; r++) lever[r] = out->position[at][r] - out->position[from][r];
    add_cross(turn, lever, shift);
}

static void by_carriage(const Unknowns *q, const State *state, const Profile *arm, const Answer *out, const double *h,
                        const long long *carriage, long long own, int side, Around *a, Slopes *slopes, Along *along) {
    const Layout *l = q->layout;
    const Tubes *t = q->tubes;
    Jump jumps[2 * N];
    double base[N], tip[6], turn[2 * N][3], formed = 0, energy = 0, released = 1 - out->margin;
    int count = jumps_of(q, carriage, own, side, jumps), last = l->pieces * STEPS, size = 0;
    memset(a->moments, 0, sizeof a->moments);
    memset(a->kicks, 0, sizeof a->kicks);
    for (int k = 0; k < count; k++) {
        double kick[N], u[2], stored;
        int p = jumps[k].piece, at = p * STEPS;
        formed += gains_of(t, jumps + k, side, out->rotation[at], a->mode.rotation[p], kick, u, &stored);
        energy += stored;
        for (int i = 0; i < N; i++) a->kicks[p][i] += kick[i];
        for (int r = 0; r < 3; r++) turn[k][r] = out->frame[at][3 * r] * u[0] + out->frame[at][3 * r + 1] * u[1];
    }
    for (int i = 0; i < N; i++) {
        int mine = carriage[i] == own;
        base[i] = mine ? -arm->twist[0][i] : 0;
        size += mine;
        /* At a fixed shape a shorter transmission is a stiffer spring, kt / |beta|. */
        if (mine) energy += t->kt[i] * arm->twist[0][i] * arm->twist[0][i] / 2;
        if (mine) formed += t->kt[i] * a->mode.twist[0][i] * a->mode.twist[0][i] * released;
    }
    respond(q, state, h, base, a);
    tip_change(q, out, a, NULL, tip, along ? a->shift : NULL);
    for (int k = 0; k < count; k++) {
        int from = jumps[k].piece * STEPS;
        for (int r = 0; r < 3; r++) tip[3 + r] += turn[k][r];
        swing(out, turn[k], from, last, tip);
        for (int at = from; at < last && along; at++) swing(out, turn[k], from, at, a->shift[at]);
    }
    for (int r = 0; r < 3 && pushes(q, out, carriage, own, side); r++) tip[r] += out->frame[last][3 * r + 2];
    for (int i = 0; i < N; i++) {
        if (carriage[i] != own) continue;
        put_column(q, out, a, tip, formed, N + i, 1.0 / size, slopes, along);
        slopes->energy[N + i] = energy / size;
    }
}

/* Column v of the compliance: a unit force (v < 3) or moment at the tip. */
static void by_wrench(const Unknowns *q, const State *state, const Answer *out, const double *h, int v, Around *a,
                      double (*sway)[2], Slopes *slopes) {
    static const double none[N];
    const Layout *l = q->layout;
    int k = q->tableau->degree, last = l->pieces * STEPS, held = 0;
    double unit[3] = {v % 3 == 0, v % 3 == 1, v % 3 == 2}, tip[6];
    while (held + 1 < N && fabs(l->end[held] - out->arc_length[last]) > ROUND_OFF_LENGTH) held++;
    memset(a->moments, 0, sizeof a->moments);
    memset(a->kicks, 0, sizeof a->kicks);
    for (int x = 0; x < l->pieces * k; x++) {
        double moment[3] = {0}, lever[3], stiffness = 0;
        for (int r = 0; r < 3; r++) lever[r] = out->position[last][r] - a->position[x][r];
        if (v < 3)
            add_cross(lever, unit, moment);
        else
            memcpy(moment, unit, sizeof moment);
        for (int i = 0; i < N; i++) stiffness += l->stiffness[x / k][i];
        for (int j = 0; j < 2; j++) {
            double pull = 0;
            for (int r = 0; r < 3; r++) pull += a->frame[x][3 * r + j] * moment[r];
            for (int i = 0; i < N; i++)
                a->moments[x / k][x % k * N + i] -= pull * a->bend_slope[x][2 * i + j] / q->tubes->kt[i];
            sway[x][j] = pull / stiffness;
        }
    }
    if (v >= 3) a->kicks[l->pieces][held] = -out->frame[last][3 * (v - 3) + 2] / q->tubes->kt[held];
    respond(q, state, h, none, a);
    tip_change(q, out, a, (const double(*)[2])sway, tip, NULL);
    for (int r = 0; r < 6; r++) {
        double twisted = r < 3 ? 0 : out->frame[last][3 * (r - 3) + 2] * a->change.rotation[l->pieces][held];
        slopes->compliance[r][v] = tip[r] + twisted;
    }
}

/* x <- H^-1 x beside a direction of unit length. */
typedef struct {
    Factored factor;
    const double *direction;
} Beside;

static void by_factor_beside(const void *of, double *x) {
    const Beside *b = of;
    by_factor(&b->factor, x);
    double along = dot(x, b->direction, b->factor.n);
    for (int r = 0; r < b->factor.n; r++) x[r] -= along * b->direction[r];
}

/* Whether two modes share the least eigenvalue of H, factorised, one of which is `mode`, of unit length. */
static int shared(const double *h, int n, const double *mode, double least) {
    double basis[LANCZOS + 1][MOST_UNKNOWNS], other[MOST_UNKNOWNS], along;
    Beside of = {{h, n, STRIDE}, mode};
    Lanczos lanczos = {by_factor_beside, &of, n, LANCZOS, MOST_UNKNOWNS, 0, MODE_ERROR, 0, basis[0]};
    anywhere(other, n);
    along = dot(other, mode, n);
    for (int r = 0; r < n; r++) other[r] -= along * mode[r];
    return least_of(&lanczos, other) - least < ONE_VALUE;
}

/* All slopes at a solved state, its arm and the mode of its margin. 0 where the second variation, for which `h` is room, is
   singular. Into `along`, where not NULL, those of the shape points. */
static int all_slopes(const Unknowns *q, const State *state, const Profile *arm, double *mode, const Answer *out,
                      const Asked *asked, double *h, Around *a, Slopes *slopes, Along *along) {
    const long long *carriage = asked->carriage;
    double sway[MOST_POINTS][2];
    second_variation(q, state, h);
    if (!cholesky(h, q->size, STRIDE)) return 0;
    memset(&a->mode, 0, sizeof a->mode);
    memset(&a->change, 0, sizeof a->change);
    look_around(q, arm, out, a);
    if (out->margin < FLAT) {
        /* From close by, Lanczos' method would have but rounding to go by. */
        double all[MOST_UNKNOWNS], part = 0.3 * sqrt(dot(mode, mode, q->size) / q->size);
        anywhere(all, q->size);
        for (int r = 0; r < q->size; r++) mode[r] += part * all[r];
        double least = least_eigenvalue(h, q->size, STRIDE, MODE_ERROR, mode);
        lean_of_margin(q, state, mode, 1 - out->margin, a);
        if (!asked->either && shared(h, q->size, mode, least)) a->form = NAN;
    }
    for (int i = 0; i < N; i++) {
        double base[N] = {0}, tip[6];
        int first = 1;
        base[i] = 1;
        memset(a->moments, 0, sizeof a->moments);
        memset(a->kicks, 0, sizeof a->kicks);
        respond(q, state, h, base, a);
        tip_change(q, out, a, NULL, tip, along ? a->shift : NULL);
        put_column(q, out, a, tip, 0, i, 1, slopes, along);
        /* The equilibrium is a minimum of the energy: only what a joint does at a fixed shape counts. */
        slopes->energy[i] = -q->tubes->kt[i] * arm->twist[0][i];
        for (int j = 0; j < i; j++) first &= carriage[j] != carriage[i];
        if (first) by_carriage(q, state, arm, out, h, carriage, carriage[i], asked->side[i], a, slopes, along);
    }
    for (int v = 0; v < 6 && asked->compliance; v++) by_wrench(q, state, out, h, v, a, sway, slopes);
    return 1;
}
