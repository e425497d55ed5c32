/* Steps along a branch of equilibria: what a small one is, and whether it stays on the branch. */

#include "parts.c"
/* An equilibrium as a guess after turns (n) of the bases, or NULL without, from translations (n) there. */
static Guess guess_of(const Answer *at, const double *turn, const double *shift) {
    static const double none[N];
    return (Guess){at->pieces * STEPS + 1, at->points, 1, N, at->arc_length, at->rotation[0], at->torsion[0],
                   at->point, at->point_rotation[0], turn ? turn : none, shift};
}

#if !ABREAST
/* The equilibrium at joint values a small step from those of the last one: 0, or 1 where it is not small or Newton's method is
   not at ease. */
static int small_step(const Tubes *tubes, const Answer *last, const double *alpha, const double *shift, const double *to_alpha,
                      const double *to_shift, Workspace *w, Answer *next) {
    double turn[N];
    for (int i = 0; i < N; i++) turn[i] = to_alpha[i] - alpha[i];
    Guess guess = guess_of(last, turn, shift);
    if (solve(tubes, to_alpha, to_shift, &guess, w, next)) return 1;
    /* Where a branch ends and another one begins close by, only the margin shows a step across the gap. */
    if (next->margin < last->margin / 2) return 1;
    return next->contraction > LARGEST_RATIO || next->largest_change > LONGEST_TWIST(last->margin);
}
#endif

/* An answer without the unused room of its tables, which is most of it. */
static void copy_answer(const Answer *from, Answer *to) {
    size_t points = from->points, shape = from->pieces * STEPS + 1;
    memcpy(to, from, offsetof(Answer, point));
    memcpy(to->point, from->point, points * sizeof to->point[0]);
    memcpy(to->point_rotation, from->point_rotation, points * sizeof to->point_rotation[0]);
    memcpy(to->arc_length, from->arc_length, shape * sizeof to->arc_length[0]);
    memcpy(to->rotation, from->rotation, shape * sizeof to->rotation[0]);
    memcpy(to->torsion, from->torsion, shape * sizeof to->torsion[0]);
    memcpy(to->curvature, from->curvature, shape * sizeof to->curvature[0]);
    memcpy(to->position, from->position, shape * sizeof to->position[0]);
    memcpy(to->frame, from->frame, shape * sizeof to->frame[0]);
}
