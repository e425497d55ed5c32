
/* --- loads, which the other C file solves for ---------------------------------------------------------------------- */

tubeopt_status tubeopt_bear(tubeopt_memory *m, const tubeopt_load *load, tubeopt_pose *pose) {
    double size = 0;
    for (int r = 0; r < 3; r++) size += fabs(load->force[r]) + fabs(load->gravity[r]);
    if (!m->started) return TUBEOPT_NOT_STARTED;
    tubeopt_status pushed = bounded(load->force, 3, TUBEOPT_MOST_NUMBER);
    tubeopt_status weighed = bounded(load->gravity, 3, TUBEOPT_MOST_NUMBER);
    if (pushed || weighed) return pushed == TUBEOPT_BAD_INPUT || !weighed ? pushed : weighed;
    m->before = NULL;
    m->ball.turn = 0;
    if (m->moves && tubeopt_bear(stop_of(m), load, pose)) return TUBEOPT_SNAP; /* there it would not be borne */
    if (size > 0 && m->bears) {
        tubeopt_joints same = m->joints;
        m->next_load = *load;
        int ended = keep_branch(m, &same, 1);
        m->next_load = m->load;
        m->before = NULL;
        if (ended) return TUBEOPT_SNAP;
    } else if (size > 0) {
        const Answer *a = m->answers + m->here;
        if (tubeopt_bearing_grow(room_of(m), load, &m->joints, (int)a->pieces, a->arc_length, a->rotation, a->margin))
            return TUBEOPT_DECLINED;
        m->bears = 1;
        accept_loaded(m);
    }
    m->bears = size > 0;
    m->load = m->next_load = *load;
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}
