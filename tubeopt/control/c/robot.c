
/* --- the robot in the hands of a program ------------------------------------------------------------------------- */

#define MOST_PARTS 64
#define MOST_SOLVES 256        /* of one call */
#define SHORTEST_PART (1 / 300.) /* of a step of ordinary length */
#define LONGEST_TWIST(margin) fmin(fmax(2 * fabs(margin) * LARGEST_TWIST, SOFT_TWIST), LARGEST_TWIST)

#if !SLOPES
typedef tubeopt_slopes Slopes;
#endif

struct tubeopt_memory {
    Workspace work;
#if GENERAL
    Workspace side; /* beside the last equilibrium */
    double numbers[13 + N];
#endif
    Answer answers[2], first;                           /* the last equilibrium, room for the next; where a way began */
    int here, started, fresh;                           /* fresh: the workspace has the last equilibrium */
    tubeopt_joints joints;                              /* of the last one */
    double rotation[N * MOST_SHAPE], torsion[N * MOST_SHAPE]; /* of the last one, by tubes */
    Slopes slopes;
    Quadratic quadratic;
};

size_t tubeopt_memory_size(void) { return sizeof(tubeopt_memory); }

tubeopt_memory *tubeopt_start(void *memory) {
    memset(memory, 0, sizeof(tubeopt_memory));
    return memory;
}

static int sensible(const tubeopt_joints *joints) {
    for (int i = 0; i < N; i++) {
        if (!isfinite(joints->rotations[i]) || !isfinite(joints->translations[i])) return 0;
        if (joints->translations[i] - ROBOT.straight[i] > ROUND_OFF_LENGTH) return 0;
        for (int j = 0; j < i; j++)
            if (CARRIAGES[j] == CARRIAGES[i] && fabs(joints->translations[j] - joints->translations[i]) > ROUND_OFF_LENGTH)
                return 0;
    }
    return 1;
}

static void tell(const tubeopt_memory *m, tubeopt_pose *pose) {
    const Answer *a = m->answers + m->here;
    long long tip = a->pieces * STEPS;
    pose->joints = m->joints;
    memcpy(pose->position, a->position[tip], sizeof pose->position);
    memcpy(pose->frame, a->frame[tip], sizeof pose->frame);
    memcpy(pose->tip_rotations, a->tip_rotations, sizeof pose->tip_rotations);
    pose->margin = a->margin;
    pose->energy = a->energy;
    pose->error = a->tip_error;
    pose->residual = a->residual;
}

/* The last equilibrium, at `joints`: as a guess of the next one, its samples by tubes. */
static void take(tubeopt_memory *m, const tubeopt_joints *joints) {
    const Answer *a = m->answers + m->here;
    long long count = a->pieces * STEPS + 1;
    for (int i = 0; i < N; i++)
        for (long long k = 0; k < count; k++) {
            m->rotation[i * count + k] = a->rotation[k][i];
            m->torsion[i * count + k] = a->torsion[k][i];
        }
    m->joints = *joints;
    m->started = 1;
}

/* The other answer, which was solved just now, becomes the last one. */
static void accept(tubeopt_memory *m, const tubeopt_joints *joints) {
    m->here = !m->here;
    m->fresh = 1;
    take(m, joints);
}

/* One step along the branch, without accepting it: 0, or 1 where it is not small or Newton's method is not at ease. */
static int step_in(tubeopt_memory *m, const tubeopt_joints *joints, Workspace *w) {
    const Answer *last = m->answers + m->here;
    Answer *next = m->answers + !m->here;
    double turn[N];
    for (int i = 0; i < N; i++) turn[i] = joints->rotations[i] - m->joints.rotations[i];
    Guess guess = {last->pieces * STEPS + 1, last->points, last->arc_length, m->rotation, m->torsion, last->point,
                   last->point_rotation[0], turn, m->joints.translations};
    if (solve_one(&ROBOT, &METHOD, joints->rotations, joints->translations, &guess, w, next)) return 1;
    return next->contraction > LARGEST_RATIO || next->largest_change > LONGEST_TWIST(last->margin);
}

static int step_to(tubeopt_memory *m, const tubeopt_joints *joints) {
    m->fresh = 0;
    return step_in(m, joints, &m->work);
}

/* Steps of ordinary length that a motion takes. */
static double parts_of(const tubeopt_joints *from, const tubeopt_joints *to, double length) {
    double most = 1;
    for (int i = 0; i < N; i++) {
        most = fmax(most, fabs(to->rotations[i] - from->rotations[i]) / LARGEST_TURN);
        most = fmax(most, fabs(to->translations[i] - from->translations[i]) / (LARGEST_SHIFT * length));
    }
    return ceil(most - 1e-9);
}

/* The place at fraction t of a straight motion, its end exactly. */
static tubeopt_joints between(const tubeopt_joints *from, const tubeopt_joints *to, double t) {
    tubeopt_joints at;
    for (int i = 0; i < N; i++) {
        at.rotations[i] = to->rotations[i] - (1 - t) * (to->rotations[i] - from->rotations[i]);
        at.translations[i] = to->translations[i] - (1 - t) * (to->translations[i] - from->translations[i]);
    }
    return at;
}

tubeopt_status tubeopt_solve(tubeopt_memory *m, const tubeopt_joints *joints, tubeopt_pose *pose) {
    if (!sensible(joints)) return TUBEOPT_BAD_INPUT;
    m->fresh = 0;
    if (solve_one(&ROBOT, &METHOD, joints->rotations, joints->translations, NULL, &m->work, m->answers + !m->here))
        return TUBEOPT_DECLINED;
    accept(m, joints);
    tell(m, pose);
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_follow(tubeopt_memory *m, const tubeopt_joints *joints, tubeopt_pose *pose) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (!sensible(joints)) return TUBEOPT_BAD_INPUT;
    const Answer *last = m->answers + m->here;
    tubeopt_joints from = m->joints;
    double length = fmax(last->arc_length[last->pieces * STEPS], LONGEST_TUBE / 10), parts = parts_of(&from, joints, length);
    double longest = 1 / parts, step = longest, done = 0;
    if (parts > MOST_PARTS) return TUBEOPT_TOO_FAR;
    m->first = *last;
    for (int solves = 0; done < 1; solves++) {
        double t = done + step >= 1 - 1e-12 ? 1 : done + step;
        tubeopt_joints at = between(&from, joints, t);
        if (solves < MOST_SOLVES && step >= longest * SHORTEST_PART && !step_to(m, &at)) {
            accept(m, &at);
            done = t;
            step = fmin(2 * step, longest);
        } else if (solves < MOST_SOLVES && step >= longest * SHORTEST_PART) {
            step /= 4;
        } else { /* the branch has ended, or nearly so */
            if (done > 0) {
                m->answers[m->here] = m->first;
                take(m, &from);
            }
            return TUBEOPT_SNAP;
        }
    }
    tell(m, pose);
    return TUBEOPT_DONE;
}

static int look_ahead(tubeopt_memory *m, int exact);

tubeopt_status tubeopt_slopes_at(tubeopt_memory *m, tubeopt_slopes *slopes) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (look_ahead(m, 1)) return TUBEOPT_DECLINED;
    memcpy(slopes->position, m->slopes.position, sizeof slopes->position);
    memcpy(slopes->turn, m->slopes.turn, sizeof slopes->turn);
    memcpy(slopes->tip_rotations, m->slopes.tip_rotations, sizeof slopes->tip_rotations);
    memcpy(slopes->margin, m->slopes.margin, sizeof slopes->margin);
#if TUBEOPT_COMPLIANCE
    memcpy(slopes->compliance, m->slopes.compliance, sizeof slopes->compliance);
#endif
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_shape(const tubeopt_memory *m, int count, double *arc_length, double (*position)[3]) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (count < 2) return TUBEOPT_BAD_INPUT;
    const Answer *a = m->answers + m->here;
    int last = (int)a->pieces * STEPS, k = 0;
    for (int c = 0; c < count; c++) {
        double s = a->arc_length[last] * c / (count - 1);
        while (k + 1 < last && a->arc_length[k + 1] < s) k++;
        double h = a->arc_length[k + 1] - a->arc_length[k], t = (s - a->arc_length[k]) / h, u = 1 - t;
        arc_length[c] = s;
        for (int r = 0; r < 3; r++) /* cubic, with the tangents */
            position[c][r] = a->position[k][r] * (1 + 2 * t) * u * u + a->position[k + 1][r] * t * t * (3 - 2 * t) +
                             h * t * u * (a->frame[k][3 * r + 2] * u - a->frame[k + 1][3 * r + 2] * t);
    }
    return TUBEOPT_DONE;
}
