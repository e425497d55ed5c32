
/* --- loads, which the other C file solves for ---------------------------------------------------------------------- */

#define SHORTEST_LOAD 1e-3 /* part of a change of the load */
#define LOAD_TURN 1e-4     /* rad, of differences */
#define LOAD_SHIFT 1e-4    /* of the longest tube */

static void accept_loaded(tubeopt_memory *m, const tubeopt_joints *joints) {
    if (!m->bears) return;
    tubeopt_bearing_accept(room_of(m), joints);
    m->loaded = m->next_loaded;
}

/* The loaded equilibrium at other joint values, from the unloaded one there. */
static int grow_anew(tubeopt_memory *m, const tubeopt_load *load) {
    const Answer *a = m->answers + m->here;
    return tubeopt_bearing_grow(room_of(m), load, &m->joints, (int)a->pieces * STEPS + 1, a->arc_length, m->rotation,
                                m->torsion, a->margin, &m->next_loaded);
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

/* Derivatives of the loaded equilibrium by differences of those on both sides, or on one where a tube cannot move. */
static int loaded_slopes(tubeopt_memory *m, tubeopt_slopes *out) {
    for (int c = 0; c < JOINTS; c++) {
        tubeopt_pose side[2];
        double by = c < N ? LOAD_TURN : LOAD_SHIFT * LONGEST_TUBE, gap = 0;
        int size = 0;
        for (int s = 0; s < 2; s++) {
            tubeopt_joints there = m->joints;
            side[s] = m->loaded;
            for (int i = 0; i < N; i++) {
                if (i == c) there.rotations[i] += s ? -by : by;
                if (CARRIAGES[i] == c - N) there.translations[i] += s ? -by : by;
            }
            if (sensible(&there) && !tubeopt_bearing_step(room_of(m), &m->load, &there, side + s)) gap += by;
        }
        if (!(gap > 0)) return 1;
        for (int i = 0; i < N; i++) size += CARRIAGES[i] == c - N;
        for (int k = 0; k < 2 * N; k++) {
            if (k < N ? k != c : CARRIAGES[k - N] != c - N) continue;
            double share = 1 / (gap * (k < N ? 1 : size)), turn[3] = {0};
            for (int r = 0; r < 3; r++) {
                out->position[r][k] = share * (side[0].position[r] - side[1].position[r]);
                for (int j = 0; j < 3; j++) { /* the change of the frame R is turn x R */
                    double by_one = side[0].frame[3 * ((r + 2) % 3) + j] - side[1].frame[3 * ((r + 2) % 3) + j];
                    double by_two = side[0].frame[3 * ((r + 1) % 3) + j] - side[1].frame[3 * ((r + 1) % 3) + j];
                    turn[r] += (by_one * m->loaded.frame[3 * ((r + 1) % 3) + j] - by_two * m->loaded.frame[3 * ((r + 2) % 3) + j]) / 2;
                }
                out->turn[r][k] = share * turn[r];
            }
            for (int i = 0; i < N; i++)
                out->tip_rotations[i][k] = share * (side[0].tip_rotations[i] - side[1].tip_rotations[i]);
            out->margin[k] = share * (side[0].margin - side[1].margin);
        }
    }
    tubeopt_bearing_compliance(room_of(m), out->compliance[0]);
    return 0;
}
