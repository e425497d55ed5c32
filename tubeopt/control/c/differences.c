
/* --- derivatives by differences of what lies beside the last equilibrium ------------------------------------------- */

#define TURNED 1e-4                    /* rad */
#define SHIFTED (SLOPES ? 2e-5 : 1e-5) /* of the longest tube; answers under load are less exact */
#define NUMBERS (13 + N)               /* of a pose behind its joints: position, frame, tip rotations and margin */

/* What the equilibrium has more where an independent joint is moved by `by`, than `here`; 1 where there is none. Arms on
   the centreline have differences under load alone. */
static int differ(tubeopt_memory *m, const tubeopt_pose *here, int joint, double by, double *more) {
    tubeopt_joints there = m->joints;
    tubeopt_pose beside;
    if (joint < N) there.rotations[joint] += by;
    for (int i = 0; i < N; i++)
        if (CARRIAGES[i] == joint - N) there.translations[i] += by;
    if (refused(&there) || (SLOPES ? bear_to(m, &there, 1) : step_to(m, &there))) return 1;
    tell(m, 1, &beside);
    for (int k = 0; k < NUMBERS; k++) more[k] = ((double *)&beside)[2 * N + k] - ((const double *)here)[2 * N + k];
    return 0;
}

/* Derivatives by a joint that is moved by `by`: of second order where `exact`, else of first. 1 where that fails. */
static int slope_by(tubeopt_memory *m, const tubeopt_pose *here, int joint, double by, int exact, double *slope) {
    double one[NUMBERS], two[NUMBERS];
    int turns = joint < N;
    if (differ(m, here, joint, by, one)) return 1;
    if (exact && differ(m, here, joint, turns ? -by : 2 * by, two)) return 1;
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

/* All derivatives: of second order where `exact` and that can be had; else by every translation towards a side to which it
   can move. 1 where that fails. */
static int differences(tubeopt_memory *m, int exact, tubeopt_slopes *out) {
    double slope[NUMBERS];
    int blocked[JOINTS];
    tubeopt_pose here;
    tell(m, 0, &here);
    only_backward(m, blocked);
    for (int c = 0; c < JOINTS; c++) {
        double by = (!exact && blocked[c] ? -1 : 1) * (c < N ? TURNED : SHIFTED * LONGEST_TUBE);
        int failed = 1;
        for (int order = exact; order >= 0 && failed; order--)
            failed = slope_by(m, &here, c, by, order, slope) && slope_by(m, &here, c, -by, order, slope);
        if (failed) return 1;
        if (here.margin >= FLAT) slope[12 + N] = 0;
        put_slope(here.frame, slope, c, out);
    }
    return 0;
}
