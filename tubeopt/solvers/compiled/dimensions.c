/* What the dimensions of tubes, each of one curvature, change at a solved equilibrium: after `differentiate`, which leaves
   the second variation factorised. Derivatives are by relative changes of curvatures and stiffnesses, and by lengths in m. */

enum { CURVATURE, STRAIGHT, CURVED, BENDING, TORSION, DIMENSIONS };

/* Relative growth of the moment m of a tube, and where it is `stiffer` of kb. */
static void bend_more(const Unknowns *q, int tube, int stiffer, const Varied *varied, Around *a, Change *c) {
    const Layout *l = q->layout;
    int k = q->tableau->degree, solved = 0;
    memset(a->sway, 0, l->pieces * k * sizeof a->sway[0]);
    for (int p = 0; p < l->pieces; solved += k * l->collocated[p++])
        for (int b = 0; b < k && l->across[p].present[tube]; b++) {
            double by[3 * N] = {0};
            by[N + tube] = stiffer ? a->at[p * k + b].stiffness[tube] : 0;
            by[2 * N + tube] = a->at[p * k + b].moment[tube];
            add_varied(q, p, b, solved, by, varied + p * k + b, a, c);
        }
}

/* Relative growth of kt of a tube: the twist is that of a torque smaller by the same fraction. */
static void harden(const Unknowns *q, int tube, Around *a, Change *c) {
    const Layout *l = q->layout;
    int k = q->tableau->degree;
    double torque = a->arm->torque[0][tube], swayed = a->mode.torque[0][tube];
    c->energy = l->held[tube] * torque * torque / 2;
    c->formed = l->held[tube] * swayed * swayed * a->released;
    for (int p = 0; p < l->pieces; p++)
        for (int b = 0; b < k && l->across[p].present[tube]; b++) {
            double softness = l->length[p] * q->tableau->weights[b] * a->at[p * k + b].rate[tube];
            torque = torque_at(q, a->arm, p, b, tube);
            swayed = torque_at(q, &a->mode, p, b, tube);
            a->change.moment[p][b * N + tube] -= a->arm->moment[p][b * N + tube];
            c->energy += softness * torque * torque / 2;
            c->formed += softness * swayed * swayed * a->released;
        }
}

CASADI_SYMBOL_EXPORT size_t varied_size(void) { return sizeof(Varied); }

/* A column for each tube, of each dimension in turn; ends of tubes move towards `side`. `varied` has room for all points. */
CASADI_SYMBOL_EXPORT void differentiate_dimensions(Workspace *w, const Answer *out, int side, Varied *varied, Column *columns) {
    const Unknowns *q = &w->fine;
    Around *a = &w->around;
    for (int x = 0; x < q->layout->pieces * q->tableau->degree; x++) find_varied(a, x, varied + x);
    for (int k = 0; k < DIMENSIONS * N; k++) {
        Change change = {.side = side};
        int kind = k / N, tube = k % N, mine[N] = {0};
        clear_gains(q, a);
        if (kind == CURVATURE || kind == BENDING) bend_more(q, tube, kind == BENDING, varied, a, &change);
        if (kind == TORSION) harden(q, tube, a, &change);
        if (kind == STRAIGHT) lengthen(q, a, tube, 1, &change);
        if (kind == CURVED) {
            mine[tube] = 1;
            add_jumps(q, mine, 1, a, &change);
            change.pushed = pushes(q, out, mine, side);
        }
        change_by(q, &w->state, out, &w->chain, &change, 0, a, columns + k);
    }
}
