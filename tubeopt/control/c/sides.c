
/* --- derivatives by differences of what lies beside the last equilibrium ------------------------------------------- */

#define NUMBERS (13 + N) /* position, frame, tip rotations and margin */

/* What the equilibrium at joint values close by has more; 1 where there is none. */
typedef int Difference(tubeopt_memory *m, const tubeopt_joints *there, double *out);

/* The joints with an independent one moved by `by`; 0 where that cannot be. */
static int moved(const tubeopt_memory *m, int joint, double by, tubeopt_joints *there) {
    *there = m->joints;
    if (joint < N) there->rotations[joint] += by;
    for (int i = 0; i < N; i++)
        if (CARRIAGES[i] == joint - N) there->translations[i] += by;
    return !refused(there);
}

/* Derivatives by a joint that is moved by `by`: of second order where `exact`, else of first. 1 where that fails. */
static int differ(tubeopt_memory *m, Difference *beside, int joint, double by, int exact, double *slope) {
    double one[NUMBERS], two[NUMBERS];
    int turns = joint < N;
    tubeopt_joints there;
    if (!moved(m, joint, by, &there) || beside(m, &there, one)) return 1;
    if (exact && (!moved(m, joint, turns ? -by : 2 * by, &there) || beside(m, &there, two))) return 1;
    for (int k = 0; k < NUMBERS; k++)
        slope[k] = !exact ? one[k] / by : turns ? (one[k] - two[k]) / (2 * by) : (4 * one[k] - two[k]) / (2 * by);
    return 0;
}

/* Derivatives by a joint into its columns; `frame`: of the tip. */
static void put_slope(const double *frame, const double *slope, int joint, tubeopt_slopes *out) {
    double turn[3], size = 0;
    for (int i = 0; i < N; i++) size += CARRIAGES[i] == joint - N;
    for (int r = 0; r < 3; r++) { /* the change of the frame R is turn x R */
        int one = 3 * ((r + 1) % 3), two = 3 * ((r + 2) % 3);
        turn[r] = (dot(slope + 3 + two, frame + one, 3) - dot(slope + 3 + one, frame + two, 3)) / 2;
    }
    for (int k = 0; k < 2 * N; k++) {
        if (k < N ? k != joint : CARRIAGES[k - N] != joint - N) continue;
        double share = k < N ? 1 : 1 / size;
        for (int r = 0; r < 3; r++) {
            out->position[r][k] = share * slope[r];
            out->turn[r][k] = share * turn[r];
        }
        for (int i = 0; i < N; i++) out->tip_rotations[i][k] = share * slope[12 + i];
        out->margin[k] = share * slope[12 + N];
    }
}
