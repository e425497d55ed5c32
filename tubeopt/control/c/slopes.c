
static int look_ahead(tubeopt_memory *m, int exact) {
    int blocked[JOINTS];
    Asked asked = {.compliance = exact};
    if (refresh(m)) return 1;
    only_backward(m, blocked);
    for (int i = 0; i < N; i++) {
        asked.carriage[i] = CARRIAGES[i];
        asked.side[i] = !exact && blocked[N + CARRIAGES[i]] ? -1 : 1;
    }
    return !slopes_of(&asked, &m->work, m->answers + m->here, &m->slopes, exact ? NULL : m->along);
}
