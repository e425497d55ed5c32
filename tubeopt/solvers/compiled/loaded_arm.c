/* From a solved state to the tip, its compliance, and the whole arm: what block/transcription/loaded.py does. */

/* out (3) += scale times the tangent of a quaternion, which need not be normalised. */
static void add_tangent(double scale, const double *q, double *out) {
    for (int i = 0; i < 3; i++)
        for (int r = 0; r < 4; r++) out[i] += scale * q[r] * dot(TANGENT[i][r], q, 4);
}

static void tip_of(const Stage *s, const State *state, double *out) {
    memset(out, 0, 3 * sizeof(double));
    for (int x = 0; x < s->points; x++) add_tangent(s->weight[x], state->stage[x], out);
}

/* The first change of the tip by a step. */
static void tip_moved(const Stage *s, const State *state, const Step *step, double *out) {
    memset(out, 0, 3 * sizeof(double));
    for (int x = 0; x < s->points; x++)
        for (int i = 0; i < 3; i++)
            for (int r = 0; r < 4; r++)
                out[i] += 2 * s->weight[x] * step->orientation[x][r] * dot(TANGENT[i][r], state->stage[x], 4);
}

static void frame_of(const double *quaternion, double *columns) {
    const double *in[1] = {quaternion};
    double *out[1] = {columns};
    rotation_matrix(in, out, 0, 0, 0);
}

/* (6, 6) translation and rotation of the tip by a dead force and moment there: P' H^-1 P, of which a sweep from the tip
   to the plate makes the root. */
static void tip_compliance(const Stage *s, const State *state, Step *step, double *room, double *out) {
    const double *tip = state->begin[s->pieces];
    Functional *by = &step->by;
    double frame[9], *root[6];
    int size = s->pieces * WIDTH + N;
    frame_of(tip, frame);
    memset(by->theta, 0, s->points * sizeof by->theta[0]);
    memset(by->bend, 0, s->points * sizeof by->bend[0]);
    by->has_twist = 0;
    for (int v = 0; v < 6; v++) {
        memset(by->end, 0, sizeof by->end);
        by->has_orientation = v < 3;
        for (int x = 0; x < s->points && v < 3; x++)
            for (int r = 0; r < 4; r++)
                by->orientation[x][r] = 2 * s->weight[x] * dot(TANGENT[v][r], state->stage[x], 4);
        for (int r = 0; r < 4 && v >= 3; r++) by->end[N + r] = 2 * dot(TURN[v - 3][r], tip, 4);
        if (v >= 3) by->end[s->problem->tip_tube] = frame[6 + v - 3];
        sweep_back(s, by, step);
        root[v] = room + (size_t)v * size;
        for (int e = 0; e < s->pieces; e++) {
            double *part = root[v] + e * WIDTH;
            memset(part, 0, WIDTH * sizeof(double));
            memcpy(part, step->local[e], s->piece[e].rows * sizeof(double));
        }
        memcpy(root[v] + s->pieces * WIDTH, step->root, sizeof step->root);
        for (int u = 0; u <= v; u++) out[6 * u + v] = out[6 * v + u] = dot(root[u], root[v], size);
    }
}

/* Quaternions, tangents and curvature inside piece e, at its shape point k, into the answer at `at`. */
static void lay_point(const Stage *s, const State *state, const Torsion *torsion, int e, int k, const double *begun,
                      Answer *out, int at) {
    const Problem *p = s->problem;
    int degree = s->degree, end = e * (STEPS + 1) + k;
    double h = p->length[e], fraction = (double)k / STEPS, turned[N], natural[2], quaternion[4], columns[9];
    const Rule *rule = s->rule;
    const double *basis = rule->basis + k * degree, *once = rule->once + k * degree, *twice = rule->twice + k * degree;
    out->arc_length[at] = p->start[e] + h * fraction;
    for (int i = 0; i < N; i++) {
        double mean = 0, torque = torsion->twist[e][i], even = fraction * torque, uneven = 0;
        for (int b = 0; b < degree; b++) mean += rule->weights[b] * p->at[e * degree + b].rate[i];
        for (int b = 0; b < degree; b++) {
            int x = e * degree + b;
            torque += h * once[b] * torsion->per_length[x][i];
            even += h * twice[b] * torsion->per_length[x][i];
            uneven += once[b] * (p->at[x].rate[i] - mean) * torsion->torque[x][i];
        }
        turned[i] = torsion->theta[e][i] + h * (mean * even + uneven);
        out->rotation[at][i] = turned[i] + p->ends[end].twist_angle[i];
        out->torsion[at][i] = torque * p->ends[end].rate[i] + p->ends_twist[end * N + i];
    }
    bend_freely(&p->ends[end], turned, natural);
    memcpy(quaternion, state->begin[e], sizeof quaternion);
    memcpy(out->bent[at], natural, sizeof natural);
    memcpy(out->position[at], begun, sizeof out->position[at]);
    for (int b = 0; b < degree; b++) {
        int x = e * degree + b;
        double rate[4] = {0, state->curvature[x][0], state->curvature[x][1], 0};
        for (int j = 0; j < 2; j++) out->bent[at][j] += basis[b] * s->soft[x] * state->q[x][j];
        add_product(h * once[b] / 2, state->stage[x], rate, quaternion);
        add_tangent(h * once[b], state->stage[x], out->position[at]);
    }
    if (k == STEPS) memcpy(quaternion, state->begin[e + 1], sizeof quaternion);
    double norm = sqrt(dot(quaternion, quaternion, 4));
    for (int r = 0; r < 4; r++) quaternion[r] /= norm;
    frame_of(quaternion, columns);
    for (int r = 0; r < 9; r++) out->frame[at][r] = columns[3 * (r % 3) + r / 3];
}

/* Everything along the arm, energy, work and the wrench at the plate. */
static void lay_arm(const Stage *s, const State *state, const double *alpha, Answer *out) {
    Torsion torsion;
    const Problem *p = s->problem;
    double begun[3] = {0};
    out->residual = residual_of(s, state, alpha, 1, &torsion);
    out->energy = state->bending;
    out->work = state->work;
    memcpy(out->theta, state->theta, s->points * sizeof state->theta[0]);
    memcpy(out->curvature, state->curvature, s->points * sizeof state->curvature[0]);
    memset(out->base_wrench, 0, sizeof out->base_wrench);
    memcpy(out->base_wrench, p->base_force, 3 * sizeof(double));
    for (int j = 0; j < 2; j++)
        for (int r = 0; r < 4; r++)
            out->base_wrench[3 + j] += state->base[r] * dot(TURN[j][r], state->begin[0], 4) / 2;
    for (int x = 0; x < s->points; x++) {
        out->energy += dot(state->q[x], state->q[x], 2) / 2;
        for (int i = 0; i < N; i++) {
            out->energy += s->weight[x] * p->at[x].rate[i] * torsion.torque[x][i] * torsion.torque[x][i] / 2;
            out->base_wrench[5] -= s->weight[x] * torsion.per_length[x][i];
        }
    }
    for (int i = 0; i < N; i++) out->energy += p->held[i] * torsion.twist[0][i] * torsion.twist[0][i] / 2;
    for (int e = 0; e < s->pieces; e++) {
        for (int k = e ? 1 : 0; k <= STEPS; k++) lay_point(s, state, &torsion, e, k, begun, out, e * STEPS + k);
        memcpy(begun, out->position[(e + 1) * STEPS], sizeof begun);
    }
}
