/* What a parameter changes at a solved equilibrium of concentric tubes: what equilibrium/linearised.py finds, on the condensed
   unknowns.

   At fixed arc lengths theta = alpha - C W M(theta), C the torsional compliance, W the weights. Where e is what changes on
   the right-hand side with theta held, d theta = L H^-1 L^-1 e, with C = L L' and H the second variation. A breakpoint
   that moves uncovers a stretch of another cross-section, which kicks the torque there and bends the arm. */

/* A breakpoint that moves: the piece that begins there, and the tubes on the stretch that it uncovers and on what was
   there. */
typedef struct {
    int piece;
    Sections tubes[2];
} Jump;

/* The solved arm at the points of all pieces, and how the margin leans on them. */
typedef struct {
    const Profile *arm;
    double direction[MOST_POINTS][N], bend_slope[MOST_POINTS][2 * N]; /* theta + phase; u_theta by columns */
    Sections at[MOST_POINTS];
    double frame[MOST_POINTS][9], position[MOST_POINTS][3];
    double lean[MOST_POINTS][3 * N], form; /* y'V''y by theta, kb, m, weighted, at the collocated points; its integral */
    double released;                       /* 1 - margin, closer than the margin of the answer has it */
    Profile mode, change;                  /* y times that */
    double sway[MOST_POINTS][2]; /* what u gains at the points, as change.moment t' */
    Gains gains;
    Jump jumps[MOST_PIECES + 1];
    double shift[MOST_SHAPE][3]; /* of the shape points by a joint */
} Around;

/* What one parameter changes: so many breakpoints that move towards `side`, and base rotations; what energy and y'V''y gain
   at fixed theta; how far the end of the arm moves along; and whether bends do at fixed theta. Beside it stand in Around
   these breakpoints and what is gained at the points. */
typedef struct {
    int count, side, pushed, sways;
    double base[N], energy, formed;
} Change;

/* What one parameter makes of the arm, per unit of it. */
typedef struct {
    double position[3], turn[3], tip_rotations[N], margin, energy;
} Column;

static void add_cross(const double *a, const double *b, double *out) {
    for (int r = 0; r < 3; r++) out[r] += a[(r + 1) % 3] * b[(r + 2) % 3] - a[(r + 2) % 3] * b[(r + 1) % 3];
}

/* A tube at arc length s, as it is on the side of `near`; straight behind its held end. */
static Section beside(const Unknowns *q, int tube, double s, double near) {
    double held = q->layout->transmission[tube];
    int panel = panel_of(q->tubes->pieces, tube, near + held);
    Section here = section_of(q->tubes->pieces, tube, panel, s + held, near < q->layout->end[tube]);
    if (near + held < 0) here.moment = 0;
    return here;
}

/* The breakpoints of tubes in front of the plate, each place once, where these tubes move to c->side, or only their ends. */
static void add_jumps(const Unknowns *q, const int *mine, int ends, Around *a, Change *c) {
    const Layout *l = q->layout;
    const Pieces *t = q->tubes->pieces;
    double places[MOST_CUTS], nudge = c->side * ROUND_OFF_LENGTH;
    int count = 0;
    for (int i = 0; i < N; i++)
        for (int k = 0, first = count; mine[i] && k < t->most_cuts && isfinite(t->cuts[i * t->most_cuts + k]); k++) {
            if (ends) count = first;
            places[count++] = t->cuts[i * t->most_cuts + k] - l->transmission[i];
        }
    qsort(places, count, sizeof(double), compare);
    c->count = 0;
    for (int k = 0; k < count; k++) {
        Jump *jump = a->jumps + c->count;
        double s = places[k];
        if (!(s > -nudge) || (k && s - places[k - 1] <= ROUND_OFF_LENGTH)) continue;
        for (int i = 0; i < N; i++) {
            put_section(&jump->tubes[0], i, beside(q, i, s, s + (mine[i] ? -nudge : nudge)));
            put_section(&jump->tubes[1], i, beside(q, i, s, s + nudge));
        }
        if (!memcmp(&jump->tubes[0], &jump->tubes[1], sizeof jump->tubes[0])) continue;
        jump->piece = 0;
        while (jump->piece < l->pieces && l->start[jump->piece] < s - 2 * ROUND_OFF_LENGTH) jump->piece++;
        c->count++;
    }
}

/* What theta' and t' (n), u (2), energy per length and y'V''y, of the mode, gain at a jump where tubes are rotated by
   `rotation`. */
static void add_gains(const Unknowns *q, const Jump *jump, int side, const double *rotation, Around *a, double *bend,
                      double *stored, double *formed) {
    int p = jump->piece, ends = p == q->layout->pieces;
    bend[0] = bend[1] = 0;
    for (int which = 0; which < 2; which++) {
        const Sections *tubes = &jump->tubes[which];
        double theta[N], moment[N], slope[N * N], gradient[3 * N], energy, u[2], stretch[N], part, all = 0;
        double sign = which ? -side : side;
        for (int i = 0; i < N; i++) {
            double torque = ends ? 0 : a->arm->torque[p][i], swayed = ends ? 0 : a->mode.torque[p][i];
            theta[i] = rotation[i] + tubes->phase[i] - tubes->twist_angle[i];
            all += tubes->stiffness[i];
            a->gains.jolts[p][i] += sign * tubes->rate[i] * torque;
            *stored -= sign * tubes->rate[i] * torque * torque / 2;
            *formed -= sign * tubes->rate[i] * swayed * swayed * a->released;
        }
        if (!(all > 0)) continue; /* no tube */
        const double *in[4] = {theta, tubes->stiffness, tubes->moment, a->mode.rotation[p]};
        double *balanced[3] = {moment, slope, &energy}, *bent[2] = {u, stretch}, *varied[2] = {&part, gradient};
        balance(in, balanced, 0, 0, 0);
        section_curvature(in, bent, 0, 0, 0);
        variation(in, varied, 0, 0, 0);
        for (int i = 0; i < N; i++) a->gains.kicks[p][i] += sign * moment[i];
        for (int j = 0; j < 2; j++) bend[j] += sign * u[j];
        *stored += sign * energy;
        *formed += sign * part;
    }
}

/* theta of a tube at point b of piece p. */
static double inside(const Unknowns *q, const Profile *arm, int p, int b, int i) {
    int k = q->tableau->degree;
    return rotation_at(q, arm, p, i, q->tableau->nodes[b], q->tableau->matrix + b * k, TWICE_INSIDE + b * k);
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

/* Nothing is gained yet. */
static void clear_gains(const Unknowns *q, Around *a) {
    int pieces = q->layout->pieces;
    memset(a->change.moment, 0, pieces * sizeof a->change.moment[0]);
    memset(a->gains.kicks, 0, (pieces + 1) * sizeof a->gains.kicks[0]);
    memset(a->gains.jolts, 0, (pieces + 1) * sizeof a->gains.jolts[0]);
    memset(a->gains.twists, 0, pieces * sizeof a->gains.twists[0]);
}

/* The arm at the points of all pieces. */
static void look_around(const Unknowns *q, const Profile *arm, const Answer *out, Around *a) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    a->arm = arm;
    for (int p = 0; p < l->pieces; p++)
        for (int b = 0; b < k; b++) {
            int x = p * k + b;
            sections_on(q->tubes, l, p, q->tableau->nodes[b], &a->at[x]);
            for (int i = 0; i < N; i++) a->direction[x][i] = inside(q, arm, p, b, i) + a->at[x].phase[i];
            const double *in[3] = {a->direction[x], a->at[x].stiffness, a->at[x].moment};
            double *res[1] = {a->bend_slope[x]};
            curvature_slope(in, res, 0, 0, 0);
            pose_inside(out, l->length[p], p, b, a->frame[x], a->position[x]);
        }
}

/* V''y at the collocated points, from y of the unknowns, added to t' there. */
static void add_stiffness(const Unknowns *q, const State *state, const double *y, Profile *to) {
    int k = q->tableau->degree;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int j = 0; j < N; j++)
                if (q->place[x][j] >= 0) sum += state->slope[x][j * N + i] * y[q->first[j] + q->place[x][j]];
            to->moment[q->piece[x]][x % k * N + i] += sum;
        }
}

/* a->change by base rotations and what is in a->change.moment and a->gains, and by what theta answers to these; H factorised. */
static void respond(const Unknowns *q, const State *state, const Chain *h, const double *base, Around *a) {
    static const double none[N];
    double theta[MOST_POINTS][N], e[MOST_UNKNOWNS], change[MOST_UNKNOWNS];
    int k = q->tableau->degree;
    turn_along(q, base, &a->gains, &a->change);
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) theta[x][i] = inside(q, &a->change, q->piece[x], x % k, i);
    to_unknowns(q, none, theta, e);
    solve_variation(q, h, e);
    times_factor(q, e, change);
    add_stiffness(q, state, change, &a->change);
    turn_along(q, base, &a->gains, &a->change);
}

/* The mode of the margin along the arm, and how y'V''y leans on the cross-sections. */
static void lean_of_margin(const Unknowns *q, const State *state, const double *z, Around *a) {
    static const double none[N];
    double y[MOST_UNKNOWNS];
    times_factor(q, z, y);
    add_stiffness(q, state, y, &a->mode);
    turn_along(q, none, NULL, &a->mode);
    a->form = 0;
    for (int x = 0; x < q->points; x++) {
        double at[N] = {0}, direction[N], form, gradient[3 * N], *res[2] = {&form, gradient};
        const double *in[4] = {direction, q->at[x].stiffness, q->at[x].moment, at};
        for (int j = 0; j < N; j++) {
            direction[j] = state->theta[x][j] + q->at[x].phase[j];
            if (q->place[x][j] >= 0) at[j] = a->released * y[q->first[j] + q->place[x][j]];
        }
        variation(in, res, 0, 0, 0);
        a->form += q->weight[x] * form;
        for (int c = 0; c < 3 * N; c++) a->lean[x][c] = q->weight[x] * gradient[c];
    }
}

/* How far the tip turns by a->change and, where it `sways`, by bends a->sway beside it; into a->shift what that shifts it by,
   and where `whole` the other shape points, at fixed arc lengths. Up to s the arm turns by int R du, and a point there moves
   by that turn x p(s) less int R du x p. */
static void move_arm(const Unknowns *q, const Answer *out, int sways, int whole, Around *a, double *turn) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    double turned[6] = {0}; /* int R du x p, int R du */
    memset(a->shift[0], 0, sizeof a->shift[0]);
    for (int p = 0; p < l->pieces; p++) {
        double rate[MOST_DEGREE][6] = {{0}}, begun[6];
        memcpy(begun, turned, sizeof begun);
        for (int b = 0; b < k; b++) {
            int x = p * k + b;
            double u[2] = {sways ? a->sway[x][0] : 0, sways ? a->sway[x][1] : 0};
            for (int i = 0; i < N; i++) {
                double by = inside(q, &a->change, p, b, i);
                for (int j = 0; j < 2; j++) u[j] += a->bend_slope[x][2 * i + j] * by;
            }
            for (int r = 0; r < 3; r++)
                rate[b][3 + r] = l->length[p] * (a->frame[x][3 * r] * u[0] + a->frame[x][3 * r + 1] * u[1]);
            add_cross(rate[b] + 3, a->position[x], rate[b]);
            for (int r = 0; r < 6; r++) turned[r] += q->tableau->weights[b] * rate[b][r];
        }
        for (int e = whole ? 1 : STEPS; e <= STEPS; e++) {
            int at = p * STEPS + e;
            double up_to[6];
            memcpy(up_to, begun, sizeof begun);
            for (int b = 0; b < k; b++)
                for (int r = 0; r < 6; r++) up_to[r] += ONCE_UP_TO[e * k + b] * rate[b][r];
            for (int r = 0; r < 3; r++) a->shift[at][r] = -up_to[r];
            add_cross(up_to + 3, out->position[at], a->shift[at]);
        }
    }
    memcpy(turn, turned + 3, 3 * sizeof(double));
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

/* What a turn of the arm beyond shape point `from` shifts the point `at` by, added to `shift`. */
static void swing(const Answer *out, const double *turn, int from, int at, double *shift) {
    double lever[3];
    for (int r = 0; r < 3; r++) lever[r] = out->position[at][r] - out->position[from][r];
    add_cross(turn, lever, shift);
}

/* What a change makes of the arm, with what is gained at the points in Around, and H factorised. The shape points
   go to a->shift where `whole`. */
static void change_by(const Unknowns *q, const State *state, const Answer *out, const Chain *h, const Change *c, int whole,
                      Around *a, Column *column) {
    double turn[MOST_PIECES + 1][3], energy = c->energy, formed = c->formed;
    int k = q->tableau->degree, last = q->layout->pieces * STEPS;
    for (int j = 0; j < c->count; j++) {
        double u[2];
        int at = a->jumps[j].piece * STEPS;
        add_gains(q, a->jumps + j, c->side, out->rotation[at], a, u, &energy, &formed);
        for (int r = 0; r < 3; r++) turn[j][r] = out->frame[at][3 * r] * u[0] + out->frame[at][3 * r + 1] * u[1];
    }
    respond(q, state, h, c->base, a);
    move_arm(q, out, c->sways, whole, a, column->turn);
    for (int j = 0; j < c->count; j++) {
        int from = a->jumps[j].piece * STEPS;
        for (int r = 0; r < 3; r++) column->turn[r] += turn[j][r];
        for (int at = whole ? from : last; at <= last; at++) swing(out, turn[j], from, at, a->shift[at]);
    }
    for (int r = 0; r < 3; r++) column->position[r] = a->shift[last][r] + (c->pushed ? out->frame[last][3 * r + 2] : 0);
    for (int i = 0; i < N; i++) column->tip_rotations[i] = a->change.rotation[ending(q->layout, i)][i];
    column->energy = energy;
    column->margin = 0;
    if (out->margin >= FLAT) return;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) formed += a->lean[x][i] * inside(q, &a->change, q->piece[x], x % k, i);
    column->margin = -a->released / a->form * formed;
}

/* Growth of the transmission of a tube by `length`. Its compliance is that at the plate, on the side from which the tube
   moves. The base turns more; at a fixed shape the transmission is a softer spring. */
static void lengthen(const Unknowns *q, const Around *a, int tube, double length, Change *c) {
    double torque = a->arm->torque[0][tube], swayed = a->mode.torque[0][tube];
    double rate = length * beside(q, tube, 0, -c->side * ROUND_OFF_LENGTH).rate;
    c->base[tube] = rate * torque;
    c->energy -= rate * torque * torque / 2;
    c->formed -= rate * swayed * swayed * a->released;
}

/* Slopes at a point by theta, kb and m of all tubes: of t' and u by columns, and of the energy per length. */
typedef struct {
    double torque[3 * N * N], bend[3 * N * 2], energy[3 * N];
} Varied;

static void find_varied(const Around *a, int point, Varied *v) {
    const double *in[3] = {a->direction[point], a->at[point].stiffness, a->at[point].moment};
    double *out[8] = {0, 0, 0, 0, v->torque, 0, v->bend, v->energy};
    linear(in, out, 0, 0, 0);
}

/* What changes `by` of theta, kb and m make of t', bends, energy and y'V''y at a point. */
static void add_varied(const Unknowns *q, int p, int b, int solved, const double *by, const Varied *v, Around *a, Change *c) {
    double weight = q->layout->length[p] * q->tableau->weights[b];
    int at = p * q->tableau->degree + b;
    for (int r = 0; r < 3 * N; r++) {
        if (by[r] == 0) continue;
        for (int i = 0; i < N; i++) a->change.moment[p][b * N + i] += by[r] * v->torque[r * N + i];
        for (int j = 0; j < 2; j++) a->sway[at][j] += by[r] * v->bend[r * 2 + j];
        c->energy += weight * by[r] * v->energy[r];
        if (q->layout->collocated[p]) c->formed += by[r] * a->lean[solved + b][r];
    }
    c->sways = 1;
}

/* Tubes that move forward carry what varies along them past the points. */
static void carry_along(const Unknowns *q, const int *mine, Around *a, Change *c) {
    const Layout *l = q->layout;
    int k = q->tableau->degree, solved = 0;
    memset(a->sway, 0, l->pieces * k * sizeof a->sway[0]);
    for (int p = 0; p < l->pieces; solved += k * l->collocated[p++])
        for (int b = 0, varies = 0; b < k; b++) {
            double by[3 * N] = {0};
            double weight = l->length[p] * q->tableau->weights[b], x = q->tableau->nodes[b];
            for (int i = 0; i < N; i++) {
                if (!mine[i] || l->across[p].even[i]) continue;
                double place = l->start[p] + l->transmission[i] + x * l->length[p];
                double torque = torque_at(q, a->arm, p, b, i), swayed = torque_at(q, &a->mode, p, b, i);
                Section rate = passing_of(q->tubes->pieces, i, panel_on(q->tubes, l, p, i, x), place, l->across[p].present[i]);
                varies = 1;
                by[i] = -rate.phase;
                by[N + i] = -rate.stiffness;
                by[2 * N + i] = -rate.moment;
                a->gains.twists[p][b * N + i] = -rate.rate * torque;
                c->energy += weight * rate.rate * torque * torque / 2;
                c->formed += weight * rate.rate * swayed * swayed * a->released;
            }
            if (!varies) break;
            Varied v;
            find_varied(a, p * k + b, &v);
            add_varied(q, p, b, solved, by, &v, a, c);
        }
}
