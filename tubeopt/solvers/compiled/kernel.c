/* Forward kinematics of concentric tubes in one call: sections, energy descent, Newton, margin, shape.

   Included after it: the functions `balance` and `piece` that CasADi generates from the mechanics. What is not plain
   sailing (an arm of very many pieces, a saddle, a fold, Newton that does not converge) is declined, and left to the
   general solver. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST_POINTS (MOST_PIECES * MOST_DEGREE)
#define MOST_SHAPE (MOST_PIECES * STEPS + 1)
#define STRIDE MOST_UNKNOWNS
#define FACTOR_SIZE (MOST_UNKNOWNS * MOST_UNKNOWNS)

#include "layout.c"
#include "linear.c"
#include "energy.c"
#include "minimise.c"
#include "arm.c"

typedef struct {
    Layout layout;
    Unknowns coarse, fine;
    State state, trial;
    Profile arm;
    double matrix[MOST_UNKNOWNS * STRIDE];
} Workspace;

size_t workspace_size(void) { return sizeof(Workspace); }
size_t answer_size(void) { return sizeof(Answer); }
size_t tubes_size(void) { return sizeof(Tubes); }

/* Descent on the coarse points from tubes without torsion, then Newton on the fine ones. */
static int from_untwisted(const Method *method, const double *alpha, Workspace *w, int *iterations, double *ratio) {
    State *state = &w->state;
    memset(state->z, 0, sizeof state->z);
    if (descend(&w->coarse, alpha, state, &w->trial, w->matrix, COARSE_STEP, iterations)) return DECLINED;
    integrate(&w->coarse, alpha, state, &w->arm);
    double theta[MOST_POINTS][N];
    interpolate(&w->coarse, &w->arm, &w->fine, method->twice, theta);
    to_unknowns(&w->fine, alpha, theta, state->z);
    return newton(&w->fine, alpha, state, w->matrix, MOST_ITERATIONS, iterations, ratio);
}

/* Newton from a guess, with the largest change of an unknown rotation from it. */
static int from_guess(const Guess *guess, const double *alpha, Workspace *w, int *iterations, Answer *out) {
    double theta[MOST_POINTS][N];
    const Unknowns *q = &w->fine;
    sample(q, guess, theta);
    to_unknowns(q, alpha, theta, w->state.z);
    if (newton(q, alpha, &w->state, w->matrix, MOST_WARM_ITERATIONS, iterations, &out->contraction)) return DECLINED;
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) {
            int x = q->point[a];
            out->largest_change = fmax(out->largest_change, fabs(w->state.theta[x][i] - theta[x][i]));
        }
    return SOLVED;
}

/* The stable equilibrium at base rotations `alpha` and translations `shift`, from a guess or, where that is NULL, from
   tubes without torsion. */
int solve(const Tubes *tubes, const Method *method, const double *alpha, const double *shift, const Guess *guess,
          Workspace *w, Answer *out) {
    int iterations = 0, failed;
    if (!lay_out(tubes, shift, &w->layout)) return DECLINED;
    if (!pose_unknowns(&w->fine, &w->layout, tubes, &method->fine)) return DECLINED;
    if (!pose_unknowns(&w->coarse, &w->layout, tubes, &method->coarse)) return DECLINED;
    out->contraction = out->largest_change = 0;
    failed = guess ? from_guess(guess, alpha, w, &iterations, out)
                   : from_untwisted(method, alpha, w, &iterations, &out->contraction);
    if (failed) return DECLINED;
    out->margin = margin_of(method, &w->fine, &w->coarse, alpha, &w->state, &w->trial, &w->arm, w->matrix);
    if (!(out->margin > 0)) return DECLINED;
    out->iterations = iterations;
    finish(&w->fine, alpha, &w->state, &w->arm, out);
    return SOLVED;
}

/* Many configurations, each from tubes without torsion; `summary` (count, SUMMARY) gets tip position (3), tip frame by
   rows (9), tip rotations (n), margin, residual, mesh error, tip error, energy; `declined` (count) what is left over. */
void solve_many(const Tubes *tubes, const Method *method, long long count, const double *alpha, const double *shift,
                double *summary, unsigned char *declined, Workspace *w, Answer *one) {
    for (long long k = 0; k < count; k++, summary += 17 + N) {
        declined[k] = solve(tubes, method, alpha + k * N, shift + k * N, NULL, w, one) != SOLVED;
        if (declined[k]) continue;
        long long tip = one->pieces * STEPS;
        memcpy(summary, one->position[tip], 3 * sizeof(double));
        memcpy(summary + 3, one->frame[tip], 9 * sizeof(double));
        memcpy(summary + 12, one->tip_rotations, N * sizeof(double));
        double rest[5] = {one->margin, one->residual, one->mesh_error, one->tip_error, one->energy};
        memcpy(summary + 12 + N, rest, sizeof rest);
    }
}
