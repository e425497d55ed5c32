
static int look_ahead(tubeopt_memory *m, int exact) {
    int blocked[JOINTS];
    Slopes back;
    if (!m->fresh) {
        tubeopt_joints same = m->joints;
        if (step_to(m, &same)) return 1;
        accept(m, &same);
    }
    if (!slopes_of(CARRIAGES, 1, &m->work, m->answers + m->here, &m->slopes, NULL)) return 1;
    if (exact || !only_backward(m, blocked)) return 0;
    if (!slopes_of(CARRIAGES, -1, &m->work, m->answers + m->here, &back, NULL)) return 1;
    for (int k = N; k < 2 * N; k++) {
        if (!blocked[N + CARRIAGES[k - N]]) continue;
        for (int r = 0; r < 3; r++) {
            m->slopes.position[r][k] = back.position[r][k];
            m->slopes.turn[r][k] = back.turn[r][k];
        }
        for (int i = 0; i < N; i++) m->slopes.tip_rotations[i][k] = back.tip_rotations[i][k];
        m->slopes.margin[k] = back.margin[k];
    }
    return 0;
}
