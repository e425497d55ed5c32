/* Energy descent, and Newton's method: what solvers/newton.py does. */

enum { SOLVED = 0, DECLINED = 1 };

#if !ABREAST
/* Newton step; where the energy is not convex, of the Hessian with a shift that makes it so. 1 where no shift was. */
static int downhill(const Unknowns *q, const State *state, Chain *h, Real *step) {
    for (double shift = 0; shift < 1e6; shift = shift ? 4 * shift : 0.1) {
        if (!factor_variation(q, state, 1 + shift, h)) continue;
        for (int r = 0; r < q->size; r++) step[r] = -state->gradient[r];
        solve_variation(q, h, step);
        return shift == 0;
    }
    memset(step, 0, q->size * sizeof(Real));
    return 0;
}

/* Newton on the energy, steps shortened until it falls, until they turn no point by more than `small`, rad. Returns
   where it ends, `state` or `trial`; NULL where it is declined. */
static State *descend(const Unknowns *q, const Real *alpha, State *state, State *trial, Chain *h, double small,
                      int *iterations) {
    Real step[MOST_UNKNOWNS];
    evaluate(q, alpha, state);
    for (int k = 0; k < MOST_ITERATIONS; k++) {
        ++*iterations;
        int convex = downhill(q, state, h, step);
        Real size = turn_of(q, step), scale = size > LONGEST_STEP ? LONGEST_STEP / size : 1;
        Real slope = dot(state->gradient, step, q->size);
        if (!isfinite(size)) return NULL;
        for (int half = 0;; half++, scale /= 2) {
            for (int r = 0; r < q->size; r++) trial->z[r] = state->z[r] + scale * step[r];
            evaluate(q, alpha, trial);
            /* Armijo's condition (Nocedal and Wright, 3.4), as far as the energy is not rounding. */
            if (trial->energy <= state->energy + 1e-4 * scale * slope + 1e-13 * fabs(state->energy)) break;
            if (half == 40) return NULL;
        }
        State *left = state;
        state = trial;
        trial = left;
        if (size <= small) return convex ? state : NULL;
    }
    return NULL;
}

#endif

/* Full Newton steps at a place close to a minimum; `contraction` is the largest ratio of successive steps. A step
   smaller than CHORD_STEP is followed by steps with the same factors, as good as Newton's there. Returns where it is
   declined. */
static Truth newton(const Unknowns *q, const Real *alpha, State *state, Chain *h, int most, int *iterations,
                  Real *contraction) {
    Real step[MOST_UNKNOWNS], last = REAL(INFINITY);
    Truth fresh = YES, open = YES, declined = NOT(YES);
    *contraction = REAL(0.0);
    evaluate(q, alpha, state);
    for (int k = 0; k < most; k++) {
        ++*iterations;
        if (ANY(fresh & open)) declined |= open & NOT(factor_variation(q, state, 1, h));
        for (int r = 0; r < q->size; r++) step[r] = -state->gradient[r];
        solve_variation(q, h, step);
        Real size = turn_of(q, step);
        /* A step of half a turn that grows leads to another branch. */
        declined |= open & (NOT(FINITE(size)) | ((size > 2 * last) & (size > 3.2)));
        open &= NOT(declined);
        if (!ANY(open)) break;
        for (int r = 0; r < q->size; r++) state->z[r] += CHOOSE(open, step[r], 0.0);
        evaluate(q, alpha, state);
        *contraction = CHOOSE(open & (size > LAST_STEP), fmax(*contraction, size / last), *contraction);
        Truth small = open & (size <= LAST_STEP);
        if (ANY(small)) open &= NOT(small & ((size <= ROUND_OFF) | (residual_of(q, state) <= ROUND_OFF)));
        if (!ANY(open)) break;
        fresh = size > CHORD_STEP;
        last = size;
    }
    return declined | open;
}

