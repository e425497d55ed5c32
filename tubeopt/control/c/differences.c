
/* The derivatives of the last equilibrium by differences of what lies beside it. */

#define TURNED 1e-4  /* rad */
#define SHIFTED 1e-5 /* of the longest tube */
#define FLAT (1 - 1e-9) /* margin above which nothing softens */
#define NUMBERS (13 + N) /* position, frame, tip rotations and margin */

/* The joints with an independent one moved by `by`; 0 where that cannot be. */
static int moved(const tubeopt_memory *m, int joint, double by, tubeopt_joints *there) {
    *there = m->joints;
    if (joint < N) there->rotations[joint] += by;
    for (int i = 0; i < N; i++)
        if (CARRIAGES[i] == joint - N) there->translations[i] += by;
    return sensible(there);
}

/* Of an answer. */
static void numbers_of(const Answer *a, double *out) {
    int tip = (int)a->pieces * STEPS;
    memcpy(out, a->position[tip], 3 * sizeof(double));
    memcpy(out + 3, a->frame[tip], 9 * sizeof(double));
    memcpy(out + 12, a->tip_rotations, N * sizeof(double));
    out[12 + N] = a->margin;
}

/* What an equilibrium close by, solved to round-off in `w`, has more; 1 where there is none. */
static int solved_beside(tubeopt_memory *m, const tubeopt_joints *there, Workspace *w, double *out) {
    double here[NUMBERS];
    if (step_in(m, there, w)) return 1;
    numbers_of(m->answers + m->here, here);
    numbers_of(m->answers + !m->here, out);
    for (int k = 0; k < NUMBERS; k++) out[k] -= here[k];
    return 0;
}

#if GENERAL
#include "chords.c"
#else
static int prepare_sides(tubeopt_memory *m) {
    m->fresh = 0;
    return 0;
}

/* What lies beside the last equilibrium has more. */
static int beside(tubeopt_memory *m, const tubeopt_joints *there, double *out) {
    return solved_beside(m, there, &m->work, out);
}
#endif

/* Derivatives by a joint towards a side: of second order where `exact`, else of first. 1 where that fails. */
static int differ(tubeopt_memory *m, int joint, int side, int exact, double *slope) {
    double by = side * (joint < N ? TURNED : SHIFTED * LONGEST_TUBE), one[NUMBERS], two[NUMBERS];
    int turns = joint < N;
    tubeopt_joints there;
    if (!moved(m, joint, by, &there) || beside(m, &there, one)) return 1;
    if (exact && (!moved(m, joint, turns ? -by : 2 * by, &there) || beside(m, &there, two))) return 1;
    for (int k = 0; k < NUMBERS; k++)
        slope[k] = !exact ? one[k] / by : turns ? (one[k] - two[k]) / (2 * by) : (4 * one[k] - two[k]) / (2 * by);
    return 0;
}

static void put_slope(const double *frame, const double *slope, double share, int column, Slopes *slopes) {
    for (int r = 0; r < 3; r++) { /* the change of the frame R is turn x R */
        const double *across = slope + 3 + 3 * ((r + 2) % 3), *along = frame + 3 * ((r + 1) % 3);
        slopes->position[r][column] = share * slope[r];
        slopes->turn[r][column] = share * dot(across, along, 3);
    }
    for (int i = 0; i < N; i++) slopes->tip_rotations[i][column] = share * slope[12 + i];
    slopes->margin[column] = share * slope[12 + N];
}

/* Second order where `exact`. */
static int look_ahead(tubeopt_memory *m, int exact) {
    double slope[NUMBERS];
    int blocked[JOINTS];
    only_backward(m, blocked);
    if (prepare_sides(m)) return 1;
    for (int c = 0; c < JOINTS; c++) {
        int size = 0, side = !exact && blocked[c] ? -1 : 1;
        if (differ(m, c, side, exact, slope) && differ(m, c, -side, exact, slope)) return 1;
        const Answer *a = m->answers + m->here;
        const double *frame = a->frame[a->pieces * STEPS];
        if (a->margin >= FLAT) slope[12 + N] = 0;
        if (c < N) put_slope(frame, slope, 1, c, &m->slopes);
        for (int i = 0; i < N; i++) size += CARRIAGES[i] == c - N;
        for (int i = 0; i < N; i++)
            if (CARRIAGES[i] == c - N) put_slope(frame, slope, 1.0 / size, N + i, &m->slopes);
    }
    return 0;
}
