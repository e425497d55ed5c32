/* Forward kinematics in one call: sections, energy descent, Newton, margin, shape.

   Before it stand the functions `balance`, `coupling_rate`, `stretched`, `section_curvature`, `section_moment` and
   `carry` that CasADi generates from the
   mechanics. What is not plain sailing (an arm of very many pieces, a saddle, a fold, Newton that does not converge) is
   declined, and left to the general solver. `entries.c` has what else Python calls; `control/c` what a program in C does. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define MOST_POINTS (MOST_PIECES * MOST_DEGREE)
#define MOST_SHAPE (MOST_PIECES * STEPS + 1)
#define STRIDE MOST_UNKNOWNS

#include "four.c"
#include "sections.c"
#include "pieces.c"
#include "layout.c"
#include "linear.c"
#include "energy.c"
#include "minimise.c"
#include "arm.c"
#if ECCENTRIC
#include "stretch.c"
#endif
#if SLOPES
#include "change.c"
#include "turning.c"
#endif

typedef struct {
    Layout layout;
    Unknowns coarse, fine; /* off the centreline fine ones are of all tubes present, curved or not */
#if ECCENTRIC
    Stretch stretch;
#endif
    State state, trial;
    Profile arm;
    double matrix[MOST_UNKNOWNS * STRIDE];
#if SLOPES
    Around around;
    Couplings couplings;
    Slides slides;
#endif
} Workspace;

/* Newton on the fine points from rotations `theta` there. */
static int newton_from(double theta[][N], const double *alpha, Workspace *w, int most, int *iterations, double *ratio) {
    to_unknowns(&w->fine, alpha, theta, w->state.z);
#if ECCENTRIC
    return newton_stretched(&w->fine, alpha, &w->state, &w->stretch, w->matrix, most, iterations, ratio);
#else
    return newton(&w->fine, alpha, &w->state, w->matrix, most, iterations, ratio);
#endif
}

#define COARSE_STEP 1e-3        /* rad, with which a descent on the coarse points ends */
#define MOST_WARM_ITERATIONS 12 /* from a guess: more than Newton's method needs close by, since chords count too */

/* Descent on the coarse points from tubes without torsion (on the centreline), then Newton on the fine ones. */
static int from_untwisted(const double *alpha, Workspace *w, int *iterations, double *ratio) {
    double theta[MOST_POINTS][N];
    memset(w->state.z, 0, sizeof w->state.z);
#if ECCENTRIC
    memset(w->state.extra, 0, sizeof w->state.extra); /* of the solve before */
#endif
    const State *state = descend(&w->coarse, alpha, &w->state, &w->trial, w->matrix, COARSE_STEP, iterations);
    if (!state) return DECLINED;
    integrate(&w->coarse, alpha, state, &w->arm);
    interpolate(&w->coarse, &w->arm, &w->fine, TO_FINE, theta);
    return newton_from(theta, alpha, w, MOST_ITERATIONS, iterations, ratio);
}

/* Newton from a guess, with the largest change of an unknown rotation from it. */
static int from_guess(const Guess *guess, const double *alpha, Workspace *w, int *iterations, Answer *out) {
    double theta[MOST_POINTS][N];
    const Unknowns *q = &w->fine;
    sample(q, guess, theta);
    if (newton_from(theta, alpha, w, MOST_WARM_ITERATIONS, iterations, &out->contraction)) return DECLINED;
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) {
            int x = q->point[a];
            out->largest_change = fmax(out->largest_change, fabs(w->state.theta[x][i] - theta[x][i]));
        }
    return SOLVED;
}

/* Profile, residual, energy and margin of the solved state. */
static void judge(const double *alpha, Workspace *w, Answer *out) {
    State *state = &w->state;
    integrate(&w->fine, alpha, state, &w->arm);
#if ECCENTRIC
    out->residual = largest(w->stretch.residual, w->fine.size);
    out->energy = state->energy + stretched_torsion(&w->fine, state, &w->stretch, &w->arm);
    out->margin = 1;
    if (!w->fine.size || never_stretched(&w->fine, state, &w->stretch)) return;
    double most = most_softening(&w->fine, &w->coarse, alpha, &w->arm, &w->trial, w->matrix);
    out->margin = most < 0 ? -1 : stretched_margin(&w->fine, state, &w->stretch, most, w->matrix);
#else
    out->residual = residual_of(&w->fine, state);
    out->energy = state->energy;
    out->margin = margin_of(&w->fine, state, w->matrix);
#endif
}

/* The stable equilibrium at base rotations `alpha` and translations `shift`, from a guess or, where that is NULL, from
   tubes without torsion. */
CASADI_SYMBOL_EXPORT int solve(const Tubes *tubes, const double *alpha, const double *shift, const Guess *guess,
                               Workspace *w, Answer *out) {
    int iterations = 0, failed;
    if (!lay_out(tubes, shift, NULL, &w->layout)) return DECLINED;
    if (!pose_unknowns(&w->fine, &w->layout, tubes, &FINE, ECCENTRIC)) return DECLINED;
    int rough = !guess || ECCENTRIC; /* where coarse points are asked: for the descent, and for that margin */
    if (rough && !pose_unknowns(&w->coarse, &w->layout, tubes, &COARSE, 0)) return DECLINED;
    out->contraction = out->largest_change = 0;
    failed = guess ? from_guess(guess, alpha, w, &iterations, out)
                   : from_untwisted(alpha, w, &iterations, &out->contraction);
    if (failed) return DECLINED;
    judge(alpha, w, out);
    if (!(out->margin > 0)) return DECLINED;
    out->iterations = iterations;
    finish(&w->fine, &w->state, &w->arm, out);
    return SOLVED;
}

#include "branch.c"

#if SLOPES
#include "slopes.c"
#endif
