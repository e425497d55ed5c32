
/* --- loads, which the other C file solves for ---------------------------------------------------------------------- */

#define SHORTEST_LOAD 1e-3 /* part of a change of the load */
#define LOAD_TURN 1e-4     /* rad, of differences */
#define LOAD_SHIFT 2e-5    /* of the longest tube */

static void accept_loaded(tubeopt_memory *m, const tubeopt_joints *joints) {
    if (!m->bears) return;
    tubeopt_bearing_accept(room_of(m), joints);
    m->loaded = m->next_loaded;
}

/* The loaded equilibrium at other joint values, from the unloaded one there. */
static int grow_anew(tubeopt_memory *m, const tubeopt_load *load) {
    const Answer *a = m->answers + m->here;
    return tubeopt_bearing_grow(room_of(m), load, &m->joints, (int)a->pieces, a->arc_length, m->rotation, a->margin,
                                &m->next_loaded);
}

/* From the load that is borne to another one, in parts that keep the branch. */
static int change_load(tubeopt_memory *m, const tubeopt_load *to) {
    tubeopt_load from = m->load, at;
    tubeopt_pose first = m->loaded;
    tubeopt_bearing_keep(room_of(m));
    for (double done = 0, part = 1; done < 1;) {
        double t = done + part >= 1 - 1e-12 ? 1 : done + part;
        for (int r = 0; r < 3; r++) {
            at.force[r] = (1 - t) * from.force[r] + t * to->force[r];
            at.gravity[r] = (1 - t) * from.gravity[r] + t * to->gravity[r];
        }
        if (!tubeopt_bearing_step(room_of(m), &at, &m->joints, &m->next_loaded)) {
            accept_loaded(m, &m->joints);
            done = t;
            part *= 2;
        } else if ((part /= 4) < SHORTEST_LOAD) {
            tubeopt_bearing_return(room_of(m));
            m->loaded = first;
            return 1;
        }
    }
    return 0;
}

tubeopt_status tubeopt_bear(tubeopt_memory *m, const tubeopt_load *load, tubeopt_pose *pose) {
    double size = 0;
    for (int r = 0; r < 3; r++) size += fabs(load->force[r]) + fabs(load->gravity[r]);
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (!isfinite(size)) return TUBEOPT_BAD_INPUT;
    m->before = NULL;
    if (size > 0 && m->bears && change_load(m, load)) return TUBEOPT_SNAP;
    if (size > 0 && !m->bears) {
        if (grow_anew(m, load)) return TUBEOPT_DECLINED;
        m->bears = 1;
        accept_loaded(m, &m->joints);
    }
    m->bears = size > 0;
    m->load = *load;
    tell(m, pose);
    return TUBEOPT_DONE;
}

/* What the loaded equilibrium with an independent joint moved by `by` has more: position, frame, tip rotations, margin; 1
   where there is none. */
static int loaded_beside(tubeopt_memory *m, int joint, double by, double *more) {
    tubeopt_joints there = m->joints;
    tubeopt_pose side;
    for (int i = 0; i < N; i++) {
        if (i == joint) there.rotations[i] += by;
        if (CARRIAGES[i] == joint - N) there.translations[i] += by;
    }
    if (!sensible(&there) || tubeopt_bearing_step(room_of(m), &m->load, &there, &side)) return 1;
    for (int r = 0; r < 3; r++) more[r] = side.position[r] - m->loaded.position[r];
    for (int r = 0; r < 9; r++) more[3 + r] = side.frame[r] - m->loaded.frame[r];
    for (int i = 0; i < N; i++) more[12 + i] = side.tip_rotations[i] - m->loaded.tip_rotations[i];
    more[12 + N] = side.margin - m->loaded.margin;
    return 0;
}

/* Derivatives by a joint: of a rotation by differences to both sides, of a translation to the given one alone, since
   breakpoints may coincide. 1 where that fails. */
static int differ_loaded(tubeopt_memory *m, int joint, int side, double *slope) {
    int turns = joint < N;
    double by = side * (turns ? LOAD_TURN : LOAD_SHIFT * LONGEST_TUBE), one[13 + N], two[13 + N];
    if (loaded_beside(m, joint, by, one)) return 1;
    int both = !loaded_beside(m, joint, turns ? -by : 2 * by, two);
    for (int k = 0; k < 13 + N; k++)
        slope[k] = !both ? one[k] / by : turns ? (one[k] - two[k]) / (2 * by) : (4 * one[k] - two[k]) / (2 * by);
    return 0;
}

static int loaded_slopes(tubeopt_memory *m, tubeopt_slopes *out) {
    for (int c = 0; c < JOINTS; c++) {
        double slope[13 + N], turn[3] = {0};
        int size = 0;
        if (differ_loaded(m, c, 1, slope) && differ_loaded(m, c, -1, slope)) return 1;
        for (int i = 0; i < N; i++) size += CARRIAGES[i] == c - N;
        for (int r = 0; r < 3; r++) { /* the change of the frame R is turn x R */
            int one = 3 * ((r + 1) % 3), two = 3 * ((r + 2) % 3);
            turn[r] = (dot(slope + 3 + two, m->loaded.frame + one, 3) - dot(slope + 3 + one, m->loaded.frame + two, 3)) / 2;
        }
        for (int k = 0; k < 2 * N; k++) {
            if (k < N ? k != c : CARRIAGES[k - N] != c - N) continue;
            double share = 1. / (k < N ? 1 : size);
            for (int r = 0; r < 3; r++) {
                out->position[r][k] = share * slope[r];
                out->turn[r][k] = share * turn[r];
            }
            for (int i = 0; i < N; i++) out->tip_rotations[i][k] = share * slope[12 + i];
            out->margin[k] = share * slope[12 + N];
        }
    }
    tubeopt_bearing_compliance(room_of(m), 0, out->compliance[0]);
    return 0;
}
