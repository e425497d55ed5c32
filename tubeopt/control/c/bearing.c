
/* --- loads, which the other C file solves for ---------------------------------------------------------------------- */

#define SHORTEST_LOAD 1e-3 /* part of a change of the load */
#define LOAD_TURN 1e-4     /* rad, of differences */
#define LOAD_SHIFT 2e-5    /* of the longest tube */

static void keep_loaded(tubeopt_memory *m) {
    m->first_loaded = m->loaded;
    if (m->bears) tubeopt_bearing_keep(room_of(m));
}

static void return_loaded(tubeopt_memory *m) {
    m->loaded = m->first_loaded;
    if (m->bears) tubeopt_bearing_return(room_of(m));
}

static void accept_loaded(tubeopt_memory *m) {
    if (!m->bears) return;
    tubeopt_bearing_accept(room_of(m));
    m->loaded = m->next_loaded;
}

/* The loaded equilibrium at other joint values, from the unloaded one there. */
static int grow_anew(tubeopt_memory *m, const tubeopt_load *load) {
    const Answer *a = m->answers + m->here;
    return tubeopt_bearing_grow(room_of(m), load, &m->joints, (int)a->pieces, a->arc_length, a->rotation, a->margin,
                                &m->next_loaded);
}

/* From the load that is borne to another one, in parts that keep the branch. */
static int change_load(tubeopt_memory *m, const tubeopt_load *to) {
    tubeopt_load from = m->load, at;
    keep_loaded(m);
    for (double done = 0, part = 1; done < 1;) {
        double t = done + part >= 1 - 1e-12 ? 1 : done + part;
        for (int r = 0; r < 3; r++) {
            at.force[r] = (1 - t) * from.force[r] + t * to->force[r];
            at.gravity[r] = (1 - t) * from.gravity[r] + t * to->gravity[r];
        }
        if (!tubeopt_bearing_step(room_of(m), &at, &m->joints, &m->next_loaded)) {
            accept_loaded(m);
            done = t;
            part *= 2;
        } else if ((part /= 4) < SHORTEST_LOAD) {
            return_loaded(m);
            return 1;
        }
    }
    return 0;
}

tubeopt_status tubeopt_bear(tubeopt_memory *m, const tubeopt_load *load, tubeopt_pose *pose) {
    double size = 0;
    for (int r = 0; r < 3; r++) size += fabs(load->force[r]) + fabs(load->gravity[r]);
    if (!m->started) return TUBEOPT_NOT_STARTED;
    tubeopt_status pushed = bounded(load->force, 3, TUBEOPT_MOST_NUMBER);
    tubeopt_status weighed = bounded(load->gravity, 3, TUBEOPT_MOST_NUMBER);
    if (pushed || weighed) return pushed == TUBEOPT_BAD_INPUT || !weighed ? pushed : weighed;
    m->before = NULL;
    if (size > 0 && m->bears && change_load(m, load)) return TUBEOPT_SNAP;
    if (size > 0 && !m->bears) {
        if (grow_anew(m, load)) return TUBEOPT_DECLINED;
        m->bears = 1;
        accept_loaded(m);
    }
    m->bears = size > 0;
    m->load = *load;
    tell(m, pose);
    return TUBEOPT_DONE;
}

/* What the loaded equilibrium at joint values close by has more; 1 where there is none. */
static int loaded_beside(tubeopt_memory *m, const tubeopt_joints *there, double *more) {
    tubeopt_pose side;
    if (tubeopt_bearing_step(room_of(m), &m->load, there, &side)) return 1;
    for (int r = 0; r < 3; r++) more[r] = side.position[r] - m->loaded.position[r];
    for (int r = 0; r < 9; r++) more[3 + r] = side.frame[r] - m->loaded.frame[r];
    for (int i = 0; i < N; i++) more[12 + i] = side.tip_rotations[i] - m->loaded.tip_rotations[i];
    more[12 + N] = side.margin - m->loaded.margin;
    return 0;
}

/* By translations that grow, where these can, since breakpoints may coincide; of first order where no second is had. */
static int loaded_slopes(tubeopt_memory *m, tubeopt_slopes *out) {
    double slope[NUMBERS];
    for (int c = 0; c < JOINTS; c++) {
        double by = c < N ? LOAD_TURN : LOAD_SHIFT * LONGEST_TUBE;
        int failed = 1;
        for (int exact = 1; exact >= 0 && failed; exact--)
            failed = differ(m, loaded_beside, c, by, exact, slope) && differ(m, loaded_beside, c, -by, exact, slope);
        if (failed) return 1;
        put_slope(m->loaded.frame, slope, c, out);
    }
    tubeopt_bearing_compliance(room_of(m), 0, out->compliance[0]);
    return 0;
}
