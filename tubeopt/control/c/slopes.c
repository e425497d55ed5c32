
/* The derivatives of the last equilibrium into m->slopes, those of the kernel: `exact` or not is the same. */
static int look_ahead(tubeopt_memory *m, int exact) {
    (void)exact;
    if (!m->fresh) {
        tubeopt_joints same = m->joints;
        if (step_to(m, &same)) return 1;
        accept(m, &same);
    }
    return !slopes_of(CARRIAGES, 1, &m->work, m->answers + m->here, &m->slopes, NULL);
}

