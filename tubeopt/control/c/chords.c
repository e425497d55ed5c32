/* Beside an equilibrium of tubes made of pieces: Newton's steps with the factors that it has, on the same mesh. */

#define CHORDS 2 /* steps, each of which leaves of the error as much as the motion is small */

/* Position and frame of the tip, phi of every tube at its own end, and the margin by the softest direction. */
static void numbers_along(const Unknowns *q, const double *alpha, const State *state, const double *mode, Profile *arm,
                          double *out) {
    double poses[24] = {0}, each[STEPS * 12], turned[MOST_UNKNOWNS], form = 0;
    Place places[MOST_LOOKS];
    const Layout *l = q->layout;
    integrate(q, alpha, state, arm);
    for (int k = 0; k < 24; k += 12) poses[k] = poses[k + 4] = poses[k + 8] = 1;
    for (int i = 0; i < N; i++) out[12 + i] = arm->rotation[0][i];
    for (int p = 0; p < l->pieces; p++) {
        const Looks *looks = looks_of(l, p);
        find_places(q, arm, p, looks, places);
        carry_poses(q, looks, places, l->length[p], poses, each);
        for (int i = 0; i < N; i++)
            if (l->start[p] < l->end[i] - ROUND_OFF_LENGTH) out[12 + i] = places[3 * looks->steps + STEPS].phi[i];
    }
    memcpy(out, poses + 9, 3 * sizeof(double));
    for (int r = 0; r < 9; r++) out[3 + r] = poses[3 * (r % 3) + r / 3];
    times_factor(q, mode, turned);
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N && q->place[x][i] >= 0; j++)
                if (q->place[x][j] >= 0)
                    form += q->weight[x] * state->slope[x][j * N + i] * turned[q->first[i] + q->place[x][i]] *
                            turned[q->first[j] + q->place[x][j]];
    out[12 + N] = q->size ? form / dot(mode, mode, q->size) : 0;
}

/* Second variation at the last equilibrium, factorised, and the numbers there; 1 where that fails. */
static int prepare_sides(tubeopt_memory *m) {
    Workspace *w = &m->work;
    if (refresh(m)) return 1;
    if (m->answers[m->here].margin >= FLAT) anywhere(w->mode, w->fine.size);
    numbers_along(&w->fine, m->joints.rotations, &w->state, w->mode, &w->spare, m->numbers);
    second_variation(&w->fine, &w->state, w->matrix);
    return !cholesky(w->matrix, w->fine.size, STRIDE);
}

/* What lies beside the last equilibrium has more; solved anew where the mesh is another one. */
static int beside(tubeopt_memory *m, const tubeopt_joints *there, double *out) {
    Workspace *w = &m->work, *side = &m->side;
    const Unknowns *q = &w->fine;
    double step[MOST_UNKNOWNS];
    if (memcmp(there->translations, m->joints.translations, sizeof there->translations)) {
        q = &side->fine;
        if (!lay_out(&ROBOT, there->translations, &side->layout) || side->layout.pieces != w->layout.pieces ||
            !pose_unknowns(&side->fine, &side->layout, &ROBOT, &FINE, 0) ||
            memcmp(q->count, w->fine.count, sizeof q->count))
            return solved_beside(m, there, side, out);
    }
    memcpy(side->state.z, w->state.z, sizeof side->state.z);
    for (int k = 0; k < CHORDS; k++) {
        evaluate(q, there->rotations, &side->state);
        for (int r = 0; r < q->size; r++) step[r] = -side->state.gradient[r];
        cholesky_solve(w->matrix, q->size, STRIDE, step);
        for (int r = 0; r < q->size; r++) side->state.z[r] += step[r];
    }
    evaluate(q, there->rotations, &side->state);
    numbers_along(q, there->rotations, &side->state, w->mode, &side->arm, out);
    for (int k = 0; k < NUMBERS; k++) out[k] -= m->numbers[k];
    return 0;
}
