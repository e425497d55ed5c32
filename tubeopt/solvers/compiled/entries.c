/* What Python calls beside `solve` and `differentiate` of the kernel. It is marked for Windows as what CasADi generates. */

CASADI_SYMBOL_EXPORT size_t workspace_size(void) { return sizeof(Workspace); }
CASADI_SYMBOL_EXPORT size_t answer_size(void) { return sizeof(Answer); }

/* Many configurations, each from tubes without torsion; `summary` (count, SUMMARY) gets tip position (3), tip frame by
   rows (9), tip rotations (n), margin, residual, mesh error, tip error, energy; `declined` (count) what is left over.
   `arms`, where not NULL, (count, 2, points, N) gets rotations and torsion at the shape points, as many as all have. */
CASADI_SYMBOL_EXPORT void solve_many(const Tubes *tubes, long long count, const double *alpha, const double *shift,
                                     double *summary, unsigned char *declined, long long points, double *arms,
                                     Workspace *w, Answer *one) {
    for (long long k = 0; k < count; k++, summary += 17 + N) {
        declined[k] = solve(tubes, alpha + k * N, shift + k * N, NULL, w, one) != SOLVED;
        long long tip = one->pieces * STEPS, size = points * N;
        declined[k] |= arms && tip + 1 != points;
        if (declined[k]) continue;
        if (arms) memcpy(arms + 2 * k * size, one->rotation, size * sizeof(double));
        if (arms) memcpy(arms + (2 * k + 1) * size, one->torsion, size * sizeof(double));
        memcpy(summary, one->position[tip], 3 * sizeof(double));
        memcpy(summary + 3, one->frame[tip], 9 * sizeof(double));
        memcpy(summary + 12, one->tip_rotations, N * sizeof(double));
        double rest[5] = {one->margin, one->residual, one->mesh_error, one->tip_error, one->energy};
        memcpy(summary + 12 + N, rest, sizeof rest);
    }
}
