/* The whole arm of tubes made of pieces: what block/transcription/whole_arm.py does. */

#define CHECK_DEGREE (MOST_DEGREE + EXTRA_POINTS)

/* The cross-section of all tubes at fraction x of piece p: directions of their pulls, kb, m, and more; `basis` (2, K) is
   the Lagrange basis there integrated once and twice. */
static void look(const Unknowns *q, const Profile *arm, int p, double x, const double *basis, double *phi,
                 double *direction, double *kb, double *m, Section *all) {
    for (int i = 0; i < N; i++) {
        all[i] = section_on(q->tubes, q->layout, p, i, x);
        phi[i] = rotation_at(q, arm, p, i, x, basis, basis + MOST_DEGREE);
        direction[i] = phi[i] + all[i].phase;
        kb[i] = all[i].stiffness;
        m[i] = all[i].moment;
    }
}

/* A pose, R by columns and p, carried over a step of a length with u at its three points. */
static void carry_step(const double *u, double length, double *pose) {
    double turn[9], shift[3], next[12];
    const double *in[2] = {u, &length};
    double *out[2] = {turn, shift};
    step_of_shape(in, out, 0, 0, 0);
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++) {
            next[3 * c + r] = 0;
            for (int j = 0; j < 3; j++) next[3 * c + r] += pose[3 * j + r] * turn[3 * c + j];
        }
    for (int r = 0; r < 3; r++) {
        next[9 + r] = pose[9 + r];
        for (int j = 0; j < 3; j++) next[9 + r] += pose[3 * j + r] * shift[j];
    }
    memcpy(pose, next, sizeof next);
}

/* Two poses carried over a piece: the first by SUBSTEPS steps between its shape points, where `each` gets it, the other
   by one, whose curvature lies on the polynomial through that of the others. */
static void carry_poses(const Unknowns *q, const Profile *arm, int p, double *poses, double *each) {
    double phi[N], direction[N], kb[N], m[N], u[3 * SUBSTEPS * 2], rougher[6], length = q->layout->length[p] / STEPS;
    Section all[N];
    for (int k = 0; k < STEPS; k++, each += 12) {
        memset(rougher, 0, sizeof rougher);
        for (int g = 0; g < 3 * SUBSTEPS; g++) {
            const double *in[3] = {direction, kb, m};
            double *out[1] = {u + 2 * g};
            int at = 3 * SUBSTEPS * k + g;
            look(q, arm, p, FINE_POINTS[at], FINE_BASIS + at * 2 * MOST_DEGREE, phi, direction, kb, m, all);
            section_curvature(in, out, 0, 0, 0);
            for (int j = 0; j < 6; j++) rougher[j] += ROUGHER[j / 2 * 3 * SUBSTEPS + g] * u[2 * g + j % 2];
        }
        for (int j = 0; j < SUBSTEPS; j++) carry_step(u + 6 * j, length / SUBSTEPS, poses);
        carry_step(rougher, length, poses + 12);
        memcpy(each, poses, 12 * sizeof(double));
    }
}

/* What a quadrature with more points says is wrong in phi, and the bending energy of the piece where none is known. */
static double check_piece(const Unknowns *q, const Profile *arm, int p, double *wrong) {
    const Layout *l = q->layout;
    double h = l->length[p], bending = 0, energy = 0, slope[N * N], kb[N], m[N], direction[N];
    double phi[CHECK_DEGREE][N], moment[CHECK_DEGREE][N], rate[CHECK_DEGREE][N];
    for (int k = 0; k < CHECK_DEGREE; k++) {
        Section all[N];
        const double *in[3] = {direction, kb, m};
        look(q, arm, p, CHECK_NODES[k], CHECK_BASIS + k * 2 * MOST_DEGREE, phi[k], direction, kb, m, all);
        if (l->collocated[p]) {
            double *out[1] = {moment[k]};
            section_moment(in, out, 0, 0, 0);
        } else {
            double *out[3] = {moment[k], slope, &bending};
            balance(in, out, 0, 0, 0);
            energy += h * CHECK_WEIGHTS[k] * bending;
        }
        for (int i = 0; i < N; i++) rate[k][i] = 1 / all[i].torsional;
    }
    for (int i = 0; i < N; i++) {
        double torque[CHECK_DEGREE], worst = 0, gained = 0;
        for (int k = 0; k < CHECK_DEGREE; k++) {
            torque[k] = arm->twist[p][i];
            for (int j = 0; j < CHECK_DEGREE; j++) torque[k] += h * CHECK_MATRIX[k * CHECK_DEGREE + j] * moment[j][i];
            gained += h * CHECK_WEIGHTS[k] * moment[k][i];
        }
        for (int k = 0; k < CHECK_DEGREE; k++) {
            double turned = arm->rotation[p][i];
            for (int j = 0; j < CHECK_DEGREE; j++)
                turned += h * CHECK_MATRIX[k * CHECK_DEGREE + j] * torque[j] * rate[j][i];
            worst = fmax(worst, fabs(turned - phi[k][i]));
        }
        for (int k = 0; k < MOST_DEGREE; k++) gained -= h * q->tableau->weights[k] * arm->moment[p][k * N + i];
        wrong[i] += worst + fabs(gained) * q->reach[p + 1][i];
    }
    return energy;
}

/* One piece: its shape points into the answer. Returns the largest sum of |m| over that of kb at them. */
static double add_general(const Unknowns *q, const Profile *arm, int p, double *poses, Answer *out) {
    const Layout *l = q->layout;
    double each[STEPS * 12], pull = 0, phi[N], direction[N], kb[N], m[N];
    carry_poses(q, arm, p, poses, each);
    for (int k = 0; k <= STEPS; k++) {
        Section all[N];
        int at = p * STEPS + k;
        double total = 0, stiff = 0, x = (double)k / STEPS;
        look(q, arm, p, x, ENDS_BASIS + k * 2 * MOST_DEGREE, phi, direction, kb, m, all);
        for (int i = 0; i < N; i++) {
            total += fabs(m[i]);
            stiff += kb[i];
        }
        pull = fmax(pull, total / stiff);
        if (p && !k) continue;
        const double *in[3] = {direction, kb, m};
        double *res[1] = {out->curvature[at]};
        section_curvature(in, res, 0, 0, 0);
        out->arc_length[at] = l->start[p] + l->length[p] * k / STEPS;
        for (int i = 0; i < N; i++) {
            double torque = arm->twist[p][i], place = out->arc_length[at] + l->transmission[i];
            double inwards = x + INWARDS * (0.5 - x);
            for (int j = 0; j < MOST_DEGREE; j++)
                torque += l->length[p] * ENDS_BASIS[k * 2 * MOST_DEGREE + j] * arm->moment[p][j * N + i];
            out->rotation[at][i] = phi[i] + all[i].wound;
            out->torsion[at][i] = torque / all[i].torsional;
            int panel = panel_at(q->tubes, l, p, i, l->start[p] + inwards * l->length[p] + l->transmission[i]);
            if (l->present[p][i]) out->torsion[at][i] += twist_of(q->tubes->pieces, i, panel, place);
        }
        if (!k) continue;
        const double *here = each + (k - 1) * 12;
        for (int r = 0; r < 9; r++) out->frame[at][r] = here[3 * (r % 3) + r / 3];
        memcpy(out->position[at], here + 9, sizeof out->position[at]);
    }
    return pull;
}
