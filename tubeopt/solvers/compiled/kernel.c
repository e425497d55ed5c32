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
#if ABREAST /* four numbers of each robot one after the other */
typedef Real FourAbreast[4];
#undef FOUR
#undef OF
#undef EACH
#define Four FourAbreast
#define FOUR(place) ((place)[lane])
#define OF(x) ((x)[lane])
#define EACH(...) for (int lane = 0; lane < 4; lane++) { __VA_ARGS__; }
#endif
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
    Layout layout[ROBOTS];
    Unknowns coarse, fine; /* off the centreline fine ones are of all tubes present, curved or not */
#if ECCENTRIC
    Stretch stretch;
#endif
    State state, trial;
    Profile arm;
    Chain chain;
#if ECCENTRIC
    double matrix[MOST_UNKNOWNS * STRIDE];
#endif
#if ABREAST
    Answers answers;
#endif
#if SLOPES
    Around around;
    Couplings couplings;
    Slides slides;
#endif
} Workspace;

/* Newton on the fine points from rotations `theta` there. */
static Truth newton_from(Real theta[][N], const Real *alpha, Workspace *w, int most, int *iterations, Real *ratio) {
    to_unknowns(&w->fine, alpha, theta, w->state.z);
#if ECCENTRIC
    return newton_stretched(&w->fine, alpha, &w->state, &w->stretch, w->matrix, most, iterations, ratio);
#else
    return newton(&w->fine, alpha, &w->state, &w->chain, most, iterations, ratio);
#endif
}

#define COARSE_STEP 1e-3        /* rad, with which a descent on the coarse points ends */
#define MOST_WARM_ITERATIONS 12 /* from a guess: more than Newton's method needs close by, since chords count too */

/* Descent on the coarse points from tubes without torsion (on the centreline), then Newton on the fine ones. Returns where
   it is declined. */
static Truth from_untwisted(const Real *alpha, Workspace *w, int *iterations, Real *ratio) {
    Real theta[MOST_POINTS][N];
    State *state = &w->state;
    memset(w->state.z, 0, sizeof w->state.z);
#if ECCENTRIC
    memset(w->state.extra, 0, sizeof w->state.extra); /* of the solve before */
#endif
    Truth declined = descend(&w->coarse, alpha, &state, &w->trial, &w->chain, COARSE_STEP, iterations);
    if (ALL(declined)) return declined;
    integrate(&w->coarse, alpha, state, &w->arm);
    interpolate(&w->coarse, &w->arm, &w->fine, TO_FINE, theta);
    return declined | newton_from(theta, alpha, w, MOST_ITERATIONS, iterations, ratio);
}

/* Newton from a guess, with the largest change of an unknown rotation from it. Returns where it is declined. */
static Truth from_guess(const Guess *guess, const Real *alpha, Workspace *w, int *iterations, Answers *out) {
    Real theta[MOST_POINTS][N];
    const Unknowns *q = &w->fine;
    for (int which = 0; which < ROBOTS; which++) sample(q, guess + which, which, theta);
    Truth declined = newton_from(theta, alpha, w, MOST_WARM_ITERATIONS, iterations, &out->contraction);
    for (int i = 0; i < N; i++)
        for (int a = q->first[i]; a < q->first[i] + q->count[i]; a++) {
            int x = q->point[a];
            out->largest_change = fmax(out->largest_change, fabs(w->state.theta[x][i] - theta[x][i]));
        }
    return declined;
}

/* Profile, residual, energy and margin of the solved state. */
static void judge(const Real *alpha, Workspace *w, Answers *out) {
    State *state = &w->state;
    integrate(&w->fine, alpha, state, &w->arm);
#if ECCENTRIC
    out->residual = largest(w->stretch.residual, w->fine.size);
    out->energy = state->energy + stretched_torsion(&w->fine, state, &w->stretch, &w->arm);
    out->margin = 1;
    if (!w->fine.size || never_stretched(&w->fine, state, &w->stretch)) return;
    double most = most_softening(&w->fine, &w->coarse, alpha, &w->arm, &w->trial, &w->chain);
    out->margin = most < 0 ? -1 : stretched_margin(&w->fine, state, &w->stretch, most, w->matrix);
#else
    out->residual = residual_of(&w->fine, state);
    out->energy = state->energy;
    out->margin = margin_of(&w->fine, state, &w->chain);
#endif
}

/* The stable equilibrium on the mesh that is laid out, at base rotations `alpha`, from a guess or, where that is NULL, from
   tubes without torsion. Returns where it is declined. */
static Truth solve_on(const Tubes *tubes, const Real *alpha, const Guess *guess, Workspace *w, Answers *out) {
    int iterations = 0;
    if (!pose_unknowns(&w->fine, w->layout, tubes, &FINE, ECCENTRIC)) return YES;
    int rough = !guess || ECCENTRIC; /* where coarse points are asked: for the descent, and for that margin */
    if (rough && !pose_unknowns(&w->coarse, w->layout, tubes, &COARSE, 0)) return YES;
    out->contraction = out->largest_change = REAL(0.0);
    Truth declined = guess ? from_guess(guess, alpha, w, &iterations, out)
                           : from_untwisted(alpha, w, &iterations, &out->contraction);
    if (ALL(declined)) return declined;
    judge(alpha, w, out);
    declined |= NOT(out->margin > 0);
    if (ALL(declined)) return declined;
    out->iterations = iterations;
    finish(&w->fine, &w->state, &w->arm, out);
    return declined;
}

#if !ABREAST
/* The stable equilibrium at base rotations `alpha` and translations `shift`. */
CASADI_SYMBOL_EXPORT int solve(const Tubes *tubes, const double *alpha, const double *shift, const Guess *guess,
                               Workspace *w, Answer *out) {
    if (!lay_out(tubes, shift, NULL, w->layout)) return DECLINED;
    return solve_on(tubes, alpha, guess, w, out) ? DECLINED : SOLVED;
}
#endif

#include "branch.c"
#if ABREAST
#include "abreast.c"
#endif

#if SLOPES
#include "slopes.c"
#endif
