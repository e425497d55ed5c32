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

#define SHORTEST_PART (1 / 300.) /* of a step of ordinary length */

/* Many robots, each from the last of its equilibria along a straight joint path to other values, or where `cold` from tubes
   without torsion. `lost` (count): 1 where there is none, as at a snap; the arm then stays as it was. */
CASADI_SYMBOL_EXPORT void follow_many(const Tubes *const *tubes, long long count, double *alpha, double *shift, const double *to_alpha,
                                      const double *to_shift, const unsigned char *cold, Answer *arms, unsigned char *lost, Workspace *w,
                                      Answer *spare) {
    for (long long k = 0; k < count; k++, alpha += N, shift += N, to_alpha += N, to_shift += N) {
        const Answer *last = cold[k] ? spare : arms + k;
        Answer *next = spare + 1;
        double done = 0, from_alpha[N], from_shift[N], at_alpha[N], at_shift[N], length, longest, step;
        lost[k] = cold[k] && solve(tubes[k], to_alpha, to_shift, NULL, w, spare);
        if (!cold[k] && !memcmp(alpha, to_alpha, sizeof at_alpha) && !memcmp(shift, to_shift, sizeof at_shift)) continue; /* at rest */
        if (!cold[k]) {
            length = fmax(last->arc_length[last->pieces * STEPS], tubes[k]->whole[0] / 10);
            longest = step = 1 / parts_of(alpha, shift, to_alpha, to_shift, length);
            memcpy(from_alpha, alpha, sizeof from_alpha);
            memcpy(from_shift, shift, sizeof from_shift);
            while (done < 1 && !lost[k]) {
                double t = done + step >= 1 - 1e-12 ? 1 : done + step;
                for (int i = 0; i < N; i++) {
                    at_alpha[i] = to_alpha[i] - (1 - t) * (to_alpha[i] - alpha[i]);
                    at_shift[i] = to_shift[i] - (1 - t) * (to_shift[i] - shift[i]);
                }
                if (small_step(tubes[k], last, from_alpha, from_shift, at_alpha, at_shift, w, next)) {
                    step /= 4;
                    lost[k] = step < longest * SHORTEST_PART;
                    continue;
                }
                last = next, next = next == spare ? spare + 1 : spare;
                memcpy(from_alpha, at_alpha, sizeof from_alpha);
                memcpy(from_shift, at_shift, sizeof from_shift);
                done = t;
                step = fmin(2 * step, longest);
            }
        }
        if (lost[k]) continue;
        copy_answer(last, arms + k);
        memcpy(alpha, to_alpha, sizeof from_alpha);
        memcpy(shift, to_shift, sizeof from_shift);
    }
}

#if SLOPES
/* The largest turn up to `most` of all tubes that is proved to cause no snap at what `solve` has just left, to a relative
   precision; INFINITY where nothing can snap, -1 where it is not known. Into `couplings` goes their number. */
CASADI_SYMBOL_EXPORT double snap_distance(Workspace *w, double most, double precision, long long *couplings) {
    int known = find_couplings(&w->fine, &w->state, &w->trial, &w->chain, &w->couplings);
    *couplings = w->couplings.count;
    return known ? largest_turn(&w->couplings, most, precision) : -1;
}

/* The largest factor up to `most` at which turns by `turn` and slides by `slide` of all tubes are proved to cause no snap at `at`,
   the equilibrium at these joint values; -1 where it is not known. */
CASADI_SYMBOL_EXPORT double motion_distance(Workspace *w, const Answer *at, const Tubes *tubes, const double *alpha, const double *shift,
                                            double turn, double slide, double most, double precision) {
    Guess guess = guess_of(at, NULL, shift);
    int lacked = 0;
    double proved = largest_motion(tubes, alpha, shift, turn, slide, most, precision, &guess, &w->slides, &w->trial, &w->chain,
                                   &w->couplings, &lacked);
    return lacked ? -1 : proved;
}
#endif
