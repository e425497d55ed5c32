
/* --- tip force and joint offsets from sensors: the filter of control/estimator.py, with its symbols ------------------ */

#define STATES TUBEOPT_STATES
#define MOST_READ 11       /* numbers of a reading */
#define MOST_UPDATES 128   /* which are filtered again where a reading comes late */
#define LINEARISATIONS 4   /* of an update at most */
#define FOUND 0.1          /* standard deviations by which the state moves where there is no further one */
#define GATE 25.           /* squared standard deviations for each number, beyond which a reading is left out */
#define NO_FORCE 1e-9      /* N, with which the model begins */

/* Readings of one time, linear in the state and over their noise, and the state after them. */
typedef struct {
    double time, slopes[MOST_READ][STATES], values[MOST_READ], x[STATES], root[STATES][STATES];
    int count;
} Update;

struct tubeopt_estimator {
    double sigma[STATES], tau[STATES];
    int count;
    Update updates[MOST_UPDATES]; /* the first, of a time in the far past, has none */
};

size_t tubeopt_estimator_size(void) { return sizeof(tubeopt_estimator); }

tubeopt_status tubeopt_estimator_start(tubeopt_estimator *e, tubeopt_memory *m, const tubeopt_prior *prior) {
    const tubeopt_load none = {{NO_FORCE, 0, 0}, {0, 0, 0}};
    tubeopt_pose pose;
    const double all[5] = {prior->force, prior->rotation, prior->translation, prior->force_time, prior->drift_time};
    for (int k = 0; k < 5; k++)
        if (!(all[k] > 0 && all[k] < TUBEOPT_MOST_NUMBER)) return TUBEOPT_BAD_INPUT;
    memset(e, 0, sizeof *e);
    e->count = 1;
    e->updates[0].time = -INFINITY;
    for (int k = 0; k < STATES; k++) {
        e->sigma[k] = e->updates[0].root[k][k] = k < 3 ? prior->force : k < 3 + N ? prior->rotation : prior->translation;
        e->tau[k] = k < 3 ? prior->force_time : prior->drift_time;
    }
    return m->bears ? TUBEOPT_DONE : tubeopt_bear(m, &none, &pose);
}

/* State and root of its covariance at a time after an update: R' of (phi S, noise)' = Q R, by reflections. */
static void predict(const tubeopt_estimator *e, const Update *from, double time, double *x, double root[][STATES]) {
    double a[2 * STATES][STATES] = {{0}};
    for (int j = 0; j < STATES; j++) {
        double dt = (time - from->time) / e->tau[j], phi = exp(-dt);
        x[j] = phi * from->x[j];
        for (int i = 0; i < STATES; i++) a[i][j] = phi * from->root[j][i];
        a[STATES + j][j] = e->sigma[j] * sqrt(-expm1(-2 * dt));
    }
    for (int c = 0; c < STATES; c++) {
        double size = 0, v[2 * STATES], square = 0;
        for (int i = c; i < 2 * STATES; i++) size += a[i][c] * a[i][c];
        size = a[c][c] > 0 ? -sqrt(size) : sqrt(size);
        for (int i = c; i < 2 * STATES; i++) v[i] = a[i][c] - (i == c ? size : 0), square += v[i] * v[i];
        for (int j = c; j < STATES && square > 0; j++) {
            double along = 0;
            for (int i = c; i < 2 * STATES; i++) along += v[i] * a[i][j];
            for (int i = c; i < 2 * STATES; i++) a[i][j] -= 2 * along / square * v[i];
        }
    }
    for (int j = 0; j < STATES; j++)
        for (int i = 0; i < STATES; i++) root[j][i] = i <= j ? a[i][j] : 0;
}

/* Potter's update by numbers of unit variance; returns the sum of squared innovations over their variances. */
static double potter(const Update *read, int from, int to, double *x, double root[][STATES]) {
    double surprise = 0;
    for (int r = from; r < to; r++) {
        const double *h = read->slopes[r];
        double f[STATES] = {0}, gap = read->values[r] - dot(h, x, STATES);
        for (int i = 0; i < STATES; i++)
            for (int j = 0; j < STATES; j++) f[j] += root[i][j] * h[i];
        double a = 1 / (dot(f, f, STATES) + 1);
        surprise += a * gap * gap;
        for (int i = 0; i < STATES; i++) {
            double along = dot(root[i], f, STATES);
            x[i] += a * gap * along;
            for (int j = 0; j < STATES; j++) root[i][j] -= a / (1 + sqrt(a)) * along * f[j];
        }
    }
    return surprise;
}

/* The model to a state, on its branch. */
static tubeopt_status to_state(tubeopt_memory *m, const tubeopt_joints *measured, const double *x) {
    tubeopt_joints at = *measured;
    const Answer *last = m->answers + m->here;
    for (int i = 0; i < N; i++) at.rotations[i] += x[3 + i], at.translations[i] += x[3 + N + i];
    tubeopt_status not_taken = refused(&at);
    if (not_taken) return not_taken;
    double length = fmax(last->arc_length[last->pieces * STEPS], LONGEST_TUBE / 10);
    double parts = parts_of(m->joints.rotations, m->joints.translations, at.rotations, at.translations, length);
    memcpy(m->next_load.force, x, sizeof m->next_load.force);
    int ended = parts > MOST_PARTS || keep_branch(m, &at, 1 / parts);
    m->moves = m->ball.turn = 0;
    if (ended) m->next_load = m->load;
    m->load = m->next_load;
    return ended ? TUBEOPT_SNAP : TUBEOPT_DONE;
}

/* A number of a reading over its noise: what the model has less at state x, and by how much that changes. */
static void add_number(Update *read, double gap, double noise, const double *x, const double *slope) {
    double *h = read->slopes[read->count];
    for (int k = 0; k < STATES; k++) h[k] = slope[k] / noise;
    read->values[read->count++] = gap / noise + dot(h, x, STATES);
}

/* A reading compared with the model at state x, to which it was led; returns how many numbers are of the tip, or -1. */
static int compare_reading(tubeopt_memory *m, const tubeopt_reading *reading, const double *x, Update *read) {
    tubeopt_slopes by;
    tubeopt_pose pose;
    double tip[3][STATES], turn[3][STATES], size = sqrt(dot(reading->direction, reading->direction, 3));
    if (differences(m, 0, &by)) return -1;
    tubeopt_bearing_compliance(room_of(m), by.compliance[0]);
    tell(m, 0, &pose);
    for (int r = 0; r < 3; r++) {
        memcpy(tip[r], by.compliance[r], 3 * sizeof(double));
        memcpy(turn[r], by.compliance[3 + r], 3 * sizeof(double));
        memcpy(tip[r] + 3, by.position[r], 2 * N * sizeof(double));
        memcpy(turn[r] + 3, by.turn[r], 2 * N * sizeof(double));
    }
    read->count = 0;
    for (int r = 0; r < 3 && reading->position_noise > 0; r++)
        add_number(read, reading->position[r] - pose.position[r], reading->position_noise, x, tip[r]);
    for (int a = 0; a < 2 && reading->direction_noise > 0; a++) { /* across the tip: e turns by psi x e, e1 . psi x e = psi_2 */
        double gap = 0, slope[STATES] = {0};
        for (int r = 0; r < 3; r++) {
            gap += pose.frame[3 * r + a] * reading->direction[r] / size;
            for (int k = 0; k < STATES; k++) slope[k] += (a ? -pose.frame[3 * r] : pose.frame[3 * r + 1]) * turn[r][k];
        }
        add_number(read, gap, reading->direction_noise, x, slope);
    }
    int of_tip = read->count;
    for (int r = 0; r < 3 && reading->force_noise > 0; r++) {
        double slope[STATES] = {0};
        slope[r] = 1;
        add_number(read, reading->force[r] - m->load.force[r], reading->force_noise, x, slope);
    }
    for (int r = 0; r < 3 && reading->moment_noise > 0; r++) { /* p x F */
        int one = (r + 1) % 3, two = (r + 2) % 3;
        const double *p = pose.position, *F = m->load.force;
        double slope[STATES];
        for (int k = 0; k < STATES; k++) slope[k] = tip[one][k] * F[two] - tip[two][k] * F[one] + p[one] * (k == two) - p[two] * (k == one);
        add_number(read, reading->moment[r] - p[one] * F[two] + p[two] * F[one], reading->moment_noise, x, slope);
    }
    return of_tip;
}

static void write_estimate(double time, const double *x, const double root[][STATES], tubeopt_estimate *out) {
    out->time = time;
    memcpy(out->state, x, sizeof out->state);
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++) out->covariance[i][j] = dot(root[i], root[j], STATES);
}

tubeopt_status tubeopt_estimate_at(const tubeopt_estimator *e, double time, tubeopt_estimate *out) {
    double x[STATES], root[STATES][STATES];
    const Update *last = e->updates + e->count - 1;
    if (!(time >= last->time)) return TUBEOPT_BAD_INPUT;
    predict(e, last, time, x, root);
    write_estimate(time, x, (const double(*)[STATES])root, out);
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_measure(tubeopt_estimator *e, tubeopt_memory *m, const tubeopt_reading *reading, tubeopt_estimate *out) {
    Update read = {.time = reading->time};
    double x0[STATES], root0[STATES][STATES], last[STATES];
    int at = e->count, weighed = fabs(m->load.gravity[0]) + fabs(m->load.gravity[1]) + fabs(m->load.gravity[2]) > 0;
    tubeopt_status status = bounded((const double *)reading, sizeof *reading / sizeof(double), TUBEOPT_MOST_NUMBER);
    if (!m->bears) return TUBEOPT_NOT_STARTED;
    if (status) return status;
    if (reading->direction_noise > 0 && !(dot(reading->direction, reading->direction, 3) > 0)) return TUBEOPT_BAD_INPUT;
    if (weighed && (reading->force_noise > 0 || reading->moment_noise > 0)) return TUBEOPT_BAD_INPUT;
    while (at > 0 && e->updates[at - 1].time > reading->time) at--;
    if (!at) return TUBEOPT_TOO_FAR; /* back */
    out->surprise = out->expected = out->left_out = 0;
    predict(e, e->updates + at - 1, reading->time, x0, root0);
    memcpy(read.x, x0, sizeof x0);
    for (int k = 0, keep[2] = {1, 1}; k < LINEARISATIONS; k++) {
        double moved = 0, surprise[2] = {0};
        if ((status = to_state(m, &reading->joints, read.x))) return status;
        int of_tip = compare_reading(m, reading, read.x, &read), ends[3] = {0, of_tip, read.count};
        if (of_tip < 0) return TUBEOPT_DECLINED;
        for (int part = 0; part < 2 && !k; part++) {
            double x[STATES], root[STATES][STATES];
            int count = ends[part + 1] - ends[part];
            memcpy(x, x0, sizeof x), memcpy(root, root0, sizeof root);
            surprise[part] = potter(&read, ends[part], ends[part + 1], x, root);
            keep[part] = surprise[part] <= GATE * count;
            out->left_out += !keep[part];
            if (keep[part]) out->surprise += surprise[part], out->expected += count;
        }
        if (!keep[0]) memmove(read.slopes, read.slopes[of_tip], (read.count - of_tip) * sizeof read.slopes[0]);
        if (!keep[0]) memmove(read.values, read.values + of_tip, (read.count - of_tip) * sizeof(double));
        read.count = keep[0] * of_tip + keep[1] * (ends[2] - of_tip);
        memcpy(last, read.x, sizeof last);
        memcpy(read.x, x0, sizeof x0), memcpy(read.root, root0, sizeof root0);
        potter(&read, 0, read.count, read.x, read.root);
        for (int i = 0; i < STATES; i++) moved = fmax(moved, fabs(read.x[i] - last[i]) / sqrt(dot(read.root[i], read.root[i], STATES)));
        if (moved < FOUND) break;
    }
    if (e->count == MOST_UPDATES) { /* the first one is of the far past no more */
        memmove(e->updates, e->updates + 1, (MOST_UPDATES - 1) * sizeof(Update));
        e->count--, at--;
    }
    memmove(e->updates + at + 1, e->updates + at, (e->count++ - at) * sizeof(Update));
    e->updates[at] = read;
    for (int k = at + 1; k < e->count; k++) { /* later ones once more */
        Update *next = e->updates + k;
        predict(e, next - 1, next->time, next->x, next->root);
        potter(next, 0, next->count, next->x, next->root);
    }
    const Update *now = e->updates + e->count - 1;
    write_estimate(now->time, now->x, (const double(*)[STATES])now->root, out);
    return TUBEOPT_DONE;
}
