/* What dimensions and stiffnesses of the tubes change at a solved equilibrium of concentric tubes of one arc each. Those of the
   cross-sections change moments, bends, energy and y'V''y at fixed rotations, by `linear` and `variation`. */

/* Slopes of the cross-sections at the points of all pieces, by columns theta, kb, m; that of y'V''y weighted. */
typedef struct {
    double moment[MOST_POINTS][N], moment_slope[MOST_POINTS][3 * N * N], bend_slope[MOST_POINTS][3 * N * 2];
    double energy_slope[MOST_POINTS][3 * N], form_slope[MOST_POINTS][3 * N];
    double sway[MOST_POINTS][2];
} Sections;

/* By each tube: curvature, lengths of the straight and of the curved part, stiffness in bending and in torsion. */
typedef struct {
    Column curvature[N], straight[N], curved[N], bending[N], torsion[N];
} Dimensions;

static void look_at_sections(const Unknowns *q, const Answer *out, const Around *a, Sections *s) {
    const Layout *l = q->layout;
    int k = q->tableau->degree, softens = out->margin < FLAT, collocated = 0;
    memset(s->form_slope, 0, sizeof s->form_slope);
    for (int x = 0; x < l->pieces * k; x++) {
        int p = x / k;
        double y[N], form;
        const double *in[4] = {a->theta[x], l->stiffness[p], l->moment[p], y};
        double *linear_parts[8] = {s->moment[x], 0, 0, 0, s->moment_slope[x], 0, s->bend_slope[x], s->energy_slope[x]};
        double *varied[2] = {&form, s->form_slope[x]};
        linear(in, linear_parts, 0, 0, 0);
        if (!softens) continue;
        if (l->collocated[p]) {
            memcpy(s->form_slope[x], a->lean[collocated++], sizeof s->form_slope[x]);
            continue;
        }
        for (int i = 0; i < N; i++) y[i] = inside(q, &a->mode, p, x % k, i);
        variation(in, varied, 0, 0, 0);
        for (int c = 0; c < 3 * N; c++) s->form_slope[x][c] *= l->length[p] * q->tableau->weights[x % k];
    }
}

/* A tube whose kb changes by `stiffer` where it is, and m by `bent` where it is on its curved part. */
static void reshape(const Unknowns *q, int tube, double stiffer, double bent, Sections *s, Around *a, Change *c) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    memset(s->sway, 0, sizeof s->sway);
    for (int p = 0; p < l->pieces; p++) {
        int beyond = l->start[p] + l->length[p] / 2 > q->tubes->straight[tube] - l->transmission[tube];
        double by[2] = {stiffer, beyond ? bent : 0};
        for (int b = 0; b < k && l->present[p][tube]; b++)
            for (int part = 0, x = p * k + b; part < 2; part++) {
                int column = (1 + part) * N + tube;
                double weight = l->length[p] * q->tableau->weights[b] * by[part];
                for (int i = 0; i < N; i++)
                    a->moments[p][b * N + i] += by[part] * s->moment_slope[x][column * N + i];
                for (int j = 0; j < 2; j++) s->sway[x][j] += by[part] * s->bend_slope[x][column * 2 + j];
                c->energy += weight * s->energy_slope[x][column];
                c->formed += by[part] * s->form_slope[x][column];
            }
    }
    c->sway = (const double(*)[2])s->sway;
}

/* Twist squared of a tube along a profile, the transmission included. */
static double twisted(const Unknowns *q, const Profile *arm, int tube) {
    const Layout *l = q->layout;
    const Tableau *t = q->tableau;
    double kt = q->tubes->kt[tube], sum = l->transmission[tube] * arm->torque[0][tube] * arm->torque[0][tube];
    for (int p = 0; p < l->pieces; p++)
        for (int b = 0; b < t->degree; b++) {
            double torque = arm->torque[p][tube];
            for (int o = 0; o < t->degree; o++)
                torque += l->length[p] * t->matrix[b * t->degree + o] * arm->moment[p][o * N + tube];
            sum += l->length[p] * t->weights[b] * torque * torque;
        }
    return sum / (kt * kt);
}

/* A tube whose kt grows by 1: it twists less under the same moment. */
static void harden(const Unknowns *q, const Profile *arm, double released, int tube, const Sections *s, Around *a,
                   Change *c) {
    int k = q->tableau->degree;
    for (int x = 0; x < q->layout->pieces * k; x++)
        a->moments[x / k][x % k * N + tube] = -s->moment[x][tube] / q->tubes->kt[tube];
    c->energy = twisted(q, arm, tube) / 2;
    c->formed = released * twisted(q, &a->mode, tube);
}

/* All of them after `all_slopes`, which leaves H factorised in `h`; breakpoints of ends move towards `side`. */
static void all_dimensions(const Unknowns *q, const State *state, const Profile *arm, const Answer *out, const double *h,
                           int side, Around *a, Sections *s, Dimensions *d) {
    static const int none[N];
    const Tubes *t = q->tubes;
    double released = 1 - out->margin;
    look_at_sections(q, out, a, s);
    for (int i = 0; i < N; i++) {
        Column *columns[] = {d->curvature + i, d->straight + i, d->curved + i, d->bending + i, d->torsion + i};
        for (int which = 0; which < 5; which++) {
            Change change = {.side = side};
            int ends[N] = {0};
            ends[i] = which == 2;
            memset(a->moments, 0, sizeof a->moments);
            if (which == 0) reshape(q, i, 0, t->kb[i], s, a, &change);
            if (which == 1) lengthen(q, arm, a, released, i, 1, &change);
            if (which == 2) add_jumps(q, none, ends, &change);
            if (which == 3) reshape(q, i, 1, t->curvature[i], s, a, &change);
            if (which == 4) harden(q, arm, released, i, s, a, &change);
            change.pushed = pushes(q, out, ends, side);
            change_by(q, state, out, h, &change, 0, a, columns[which]);
        }
    }
}
