
/* The derivatives of the last equilibrium by differences of what lies beside it. */

#define TURNED 1e-4  /* rad */
#define SHIFTED 1e-5 /* of the longest tube */
#define FLAT (1 - 1e-9) /* margin above which nothing softens */

/* Of an answer. */
static void numbers_of(const Answer *a, double *out) {
    int tip = (int)a->pieces * STEPS;
    memcpy(out, a->position[tip], 3 * sizeof(double));
    memcpy(out + 3, a->frame[tip], 9 * sizeof(double));
    memcpy(out + 12, a->tip_rotations, N * sizeof(double));
    out[12 + N] = a->margin;
}

/* What the equilibrium at joint values close by has more; 1 where there is none. */
static int beside_last(tubeopt_memory *m, const tubeopt_joints *there, double *out) {
    double here[NUMBERS];
    if (step_in(m, there, &m->work)) return 1;
    numbers_of(m->answers + m->here, here);
    numbers_of(m->answers + !m->here, out);
    for (int k = 0; k < NUMBERS; k++) out[k] -= here[k];
    return 0;
}

/* Second order where `exact`. */
static int look_ahead(tubeopt_memory *m, int exact) {
    double slope[NUMBERS];
    int blocked[JOINTS];
    only_backward(m, blocked);
    m->fresh = 0;
    const Answer *a = m->answers + m->here;
    for (int c = 0; c < JOINTS; c++) {
        double by = (!exact && blocked[c] ? -1 : 1) * (c < N ? TURNED : SHIFTED * LONGEST_TUBE);
        if (differ(m, beside_last, c, by, exact, slope) && differ(m, beside_last, c, -by, exact, slope)) return 1;
        if (a->margin >= FLAT) slope[12 + N] = 0;
        put_slope(a->frame[a->pieces * STEPS], slope, c, &m->slopes);
    }
    return 0;
}
