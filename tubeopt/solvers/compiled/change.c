/* What a parameter changes at a solved equilibrium of concentric tubes: what equilibrium/linearised.py finds, on the condensed
   unknowns.

   At fixed arc lengths theta = alpha - C W M(theta), C the torsional compliance, W the weights. Where e is what changes on
   the right-hand side with theta held, d theta = L H^-1 L^-1 e, with C = L L' and H the second variation. A breakpoint
   that moves uncovers a stretch of another cross-section, which kicks the torque there and bends the arm. */

#define FLAT (1 - 1e-9) /* margin above which nothing softens */

/* The solved arm at the points of all pieces, and how the margin leans on them. */
typedef struct {
    double theta[MOST_POINTS][N], bend_slope[MOST_POINTS][2 * N]; /* u_theta by columns */
    double frame[MOST_POINTS][9], position[MOST_POINTS][3];
    double lean[MOST_POINTS][3 * N], form; /* y'V''y by theta, kb, m, weighted, at the collocated points; its integral */
    Profile mode, change;                  /* y times 1 - margin */
    double moments[MOST_PIECES][MOST_DEGREE * N], kicks[MOST_PIECES + 1][N];
    double shift[MOST_SHAPE][3]; /* of the shape points by a joint */
} Around;

/* A breakpoint that moves: the piece that begins there; tubes that are there, and those that bend, on the stretch that it
   uncovers and on what was there. */
typedef struct {
    int piece, present[2][N], curved[2][N];
} Jump;

/* What one parameter changes: breakpoints that move towards `side`, base rotations, and bends at the points at fixed theta,
   or NULL; what energy and y'V''y gain at fixed theta; and how far the end of the arm moves along. Beside it, what the torque
   gains at the points stands in Around. */
typedef struct {
    int count, side, pushed;
    Jump jumps[2 * N];
    double base[N], energy, formed;
    const double (*sway)[2];
} Change;

/* What one parameter makes of the arm, per unit of it. */
typedef struct {
    double position[3], turn[3], tip_rotations[N], margin, energy;
} Column;

static void add_cross(const double *a, const double *b, double *out) {
    for (int r = 0; r < 3; r++) out[r] += a[(r + 1) % 3] * b[(r + 2) % 3] - a[(r + 2) % 3] * b[(r + 1) % 3];
}

/* Tubes that are there, and those that bend, at arc length s, with `begins` and `ends` of curved parts moved on. */
static void tubes_at(const Unknowns *q, const int *begins, const int *ends, double moved, double s, int *present,
                     int *curved) {
    for (int i = 0; i < N; i++) {
        double begin = q->tubes->straight[i] - q->layout->transmission[i] + (begins[i] ? moved : 0);
        present[i] = s < q->layout->end[i] + (ends[i] ? moved : 0);
        curved[i] = present[i] && begin < s;
    }
}

/* The breakpoints in front of the plate, each place once, where `begins` and `ends` of curved parts move to c->side. */
static void add_jumps(const Unknowns *q, const int *begins, const int *ends, Change *c) {
    const Layout *l = q->layout;
    double places[2 * N], nudge = c->side * ROUND_OFF_LENGTH;
    int count = 0;
    for (int i = 0; i < N; i++) {
        double begin = q->tubes->straight[i] - l->transmission[i];
        if (ends[i]) places[count++] = l->end[i];
        if (begins[i] && l->end[i] - begin > ROUND_OFF_LENGTH) places[count++] = begin;
    }
    qsort(places, count, sizeof(double), compare);
    c->count = 0;
    for (int k = 0; k < count; k++) {
        Jump *jump = c->jumps + c->count;
        double s = places[k];
        if (!(s > -nudge) || (k && s - places[k - 1] <= ROUND_OFF_LENGTH)) continue;
        tubes_at(q, begins, ends, 2 * nudge, s + nudge, jump->present[0], jump->curved[0]);
        tubes_at(q, begins, ends, 0, s + nudge, jump->present[1], jump->curved[1]);
        if (!memcmp(jump->present[0], jump->present[1], sizeof jump->present[0]) &&
            !memcmp(jump->curved[0], jump->curved[1], sizeof jump->curved[0]))
            continue;
        jump->piece = 0;
        while (jump->piece < l->pieces && l->start[jump->piece] < s - 2 * ROUND_OFF_LENGTH) jump->piece++;
        c->count++;
    }
}

/* Cross-section on what a jump uncovers (0) or what was there (1); 0 where there is no tube. */
static int section_of_jump(const Tubes *t, const Jump *jump, int which, double *kb, double *m) {
    int any = 0;
    for (int i = 0; i < N; i++) {
        kb[i] = jump->present[which][i] ? t->kb[i] : 0;
        m[i] = jump->curved[which][i] ? t->kb[i] * t->curvature[i] : 0;
        any |= jump->present[which][i];
    }
    return any;
}

/* What t' (n), u (2), the energy per length and, with a mode y, y'V''y gain at a jump with rotations theta. */
static double gains_of(const Tubes *t, const Jump *jump, int side, const double *theta, const double *y, double *kick,
                       double *bend, double *stored) {
    double form = 0;
    memset(kick, 0, N * sizeof(double));
    bend[0] = bend[1] = *stored = 0;
    for (int which = 0; which < 2; which++) {
        double kb[N], m[N], moment[N], slope[N * N], gradient[3 * N], energy, u[2], stretch[N], part, sign = which ? -side : side;
        if (!section_of_jump(t, jump, which, kb, m)) continue;
        const double *in[4] = {theta, kb, m, y};
        double *balanced[3] = {moment, slope, &energy}, *bent[2] = {u, stretch}, *varied[2] = {&part, gradient};
        balance(in, balanced, 0, 0, 0);
        section_curvature(in, bent, 0, 0, 0);
        variation(in, varied, 0, 0, 0);
        for (int i = 0; i < N; i++) kick[i] += sign * moment[i];
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
    return arm->rotation[p][i] + h * arm->compliance[p][i] * (q->tableau->nodes[b] * arm->torque[p][i] + h * bent);
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

/* V''y at the collocated points, from y of the unknowns, added to a->moments. */
static void add_stiffness(const Unknowns *q, const State *state, const double *y, Around *a) {
    int k = q->tableau->degree;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int j = 0; j < N; j++)
                if (q->place[x][j] >= 0) sum += state->slope[x][j * N + i] * y[q->first[j] + q->place[x][j]];
            a->moments[q->piece[x]][x % k * N + i] += sum;
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

/* The mode of the margin along the arm, and how y'V''y leans on the cross-sections. */
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
        for (int c = 0; c < 3 * N; c++) a->lean[x][c] = q->weight[x] * gradient[c];
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

/* Whether `ends` that move towards `side` take the end of the arm along. */
static int pushes(const Unknowns *q, const Answer *out, const int *ends, int side) {
    int mine = 0, others = 0;
    for (int i = 0; i < N; i++) {
        if (fabs(q->layout->end[i] - out->arc_length[q->layout->pieces * STEPS]) > ROUND_OFF_LENGTH) continue;
        if (ends[i])
            mine = 1;
        else
            others = 1;
    }
    return mine && (side > 0 || (!others && q->layout->pieces));
}

/* Where a tube ends: the piece that begins there. */
static int ending(const Layout *l, int tube) {
    int p = 0;
    while (p < l->pieces && l->start[p] < fmax(l->end[tube], 0) - ROUND_OFF_LENGTH) p++;
    return p;
}

/* What a turn of the arm beyond shape point `from` shifts the point `at` by, added to `shift`. */
static void swing(const Answer *out, const double *turn, int from, int at, double *shift) {
    double lever[3];
    for (int r = 0; r < 3; r++) lever[r] = out->position[at][r] - out->position[from][r];
    add_cross(turn, lever, shift);
}

/* What a change makes of the arm, with what the torque gains at the points in a->moments, and H factorised. The shape points
   go to a->shift where `whole`. */
static void change_by(const Unknowns *q, const State *state, const Answer *out, const double *h, const Change *c, int whole,
                      Around *a, Column *column) {
    double tip[6], turn[2 * N][3], energy = c->energy, formed = c->formed;
    int k = q->tableau->degree, last = q->layout->pieces * STEPS;
    memset(a->kicks, 0, sizeof a->kicks);
    for (int j = 0; j < c->count; j++) {
        double kick[N], u[2], stored;
        int p = c->jumps[j].piece, at = p * STEPS;
        formed += gains_of(q->tubes, c->jumps + j, c->side, out->rotation[at], a->mode.rotation[p], kick, u, &stored);
        energy += stored;
        for (int i = 0; i < N; i++) a->kicks[p][i] += kick[i];
        for (int r = 0; r < 3; r++) turn[j][r] = out->frame[at][3 * r] * u[0] + out->frame[at][3 * r + 1] * u[1];
    }
    respond(q, state, h, c->base, a);
    tip_change(q, out, a, c->sway, tip, whole ? a->shift : NULL);
    for (int j = 0; j < c->count; j++) {
        int from = c->jumps[j].piece * STEPS;
        for (int r = 0; r < 3; r++) tip[3 + r] += turn[j][r];
        swing(out, turn[j], from, last, tip);
        for (int at = from; at < last && whole; at++) swing(out, turn[j], from, at, a->shift[at]);
    }
    for (int r = 0; r < 3; r++) {
        column->position[r] = tip[r] + (c->pushed ? out->frame[last][3 * r + 2] : 0);
        column->turn[r] = tip[3 + r];
    }
    for (int i = 0; i < N; i++) column->tip_rotations[i] = a->change.rotation[ending(q->layout, i)][i];
    column->energy = energy;
    column->margin = 0;
    if (out->margin >= FLAT) return;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) formed += a->lean[x][i] * inside(q, &a->change, q->piece[x], x % k, i);
    column->margin = -(1 - out->margin) / a->form * formed;
}

/* A transmission that grows by `by`: it turns the base on, and at a fixed shape is a softer spring, kt / |beta|. */
static void lengthen(const Unknowns *q, const Profile *arm, const Around *a, double released, int tube, double by, Change *c) {
    double kt = q->tubes->kt[tube], twist = arm->torque[0][tube] / kt, swayed = a->mode.torque[0][tube] / kt;
    c->base[tube] = by * twist;
    c->energy -= by * kt * twist * twist / 2;
    c->formed -= by * kt * swayed * swayed * released;
}
