
static int look_ahead(tubeopt_memory *m, int exact) {
    int blocked[JOINTS];
    Asked asked = {.compliance = exact};
    if (!m->fresh) {
        tubeopt_joints same = m->joints;
        if (step_to(m, &same)) return 1;
        accept(m, &same);
    }
    only_backward(m, blocked);
    for (int i = 0; i < N; i++) {
        asked.carriage[i] = CARRIAGES[i];
        asked.side[i] = !exact && blocked[N + CARRIAGES[i]] ? -1 : 1;
    }
    return !slopes_of(&asked, &m->work, m->answers + m->here, &m->slopes, exact ? NULL : m->along);
}
