/* Energy descent, and Newton's method: what solvers/newton.py does. */

enum { SOLVED = 0, DECLINED = 1 };

#define MOST_SHIFTS 14 /* the last is above 1e6 */

/* Newton step; where the energy is not convex, of the Hessian with a shift that makes it so. Returns where no shift was. */
static Truth downhill(const Unknowns *q, const State *state, Truth open, Chain *h, Real *step) {
    Real shift = {0}, found[MOST_UNKNOWNS];
    Truth convex = NOT(YES);
    memset(step, 0, q->size * sizeof(Real));
    for (int tries = 0; ANY(open) && tries < MOST_SHIFTS; tries++) {
        Truth positive = open & factor_variation(q, state, 1 + shift, h);
        if (!tries) convex = positive;
        for (int r = 0; r < q->size; r++) found[r] = -state->gradient[r];
        if (ANY(positive)) solve_variation(q, h, found);
        for (int r = 0; r < q->size; r++) step[r] = CHOOSE(positive, found[r], step[r]);
        open &= NOT(positive);
        shift = CHOOSE(shift > 0, 4 * shift, 0.1);
    }
    return convex;
}

/* Newton on the energy, steps shortened until it falls, until they turn no point by more than `small`, rad. It ends in `*at`,
   which may be the spare state. Returns where it is declined. */
static Truth descend(const Unknowns *q, const Real *alpha, State **at, State *spare, Chain *h, double small, int *iterations) {
    Real step[MOST_UNKNOWNS];
    State *state = *at, *trial = spare;
    Truth open = YES, declined = NOT(YES);
    evaluate(q, alpha, state);
    for (int k = 0; k < MOST_ITERATIONS && ANY(open); k++) {
        ++*iterations;
        Truth convex = downhill(q, state, open, h, step), falling;
        Real size = turn_of(q, step), scale = CHOOSE(size > LONGEST_STEP, LONGEST_STEP / size, 1.0);
        Real slope = dot(state->gradient, step, q->size);
        declined |= open & NOT(FINITE(size));
        open &= FINITE(size);
        memcpy(trial->z, state->z, q->size * sizeof(Real));
        falling = NOT(open);
        for (int half = 0; !ALL(falling); half++) {
            for (int r = 0; r < q->size; r++) trial->z[r] = CHOOSE(falling, trial->z[r], state->z[r] + scale * step[r]);
            evaluate(q, alpha, trial);
            /* Armijo's condition (Nocedal and Wright, 3.4), as far as the energy is not rounding. */
            falling |= trial->energy <= state->energy + 1e-4 * scale * slope + 1e-13 * fabs(state->energy);
            if (half == 40) {
                declined |= NOT(falling);
                open &= falling;
                break;
            }
            scale = CHOOSE(falling, scale, scale / 2);
        }
        *at = trial;
        trial = state;
        state = *at;
        Truth ends = open & (size <= small);
        declined |= ends & NOT(convex);
        open &= NOT(ends);
    }
    return declined | open;
}

/* Full Newton steps at a place close to a minimum; `contraction` is the largest ratio of successive steps. A step
   smaller than CHORD_STEP is followed by steps with the same factors, as good as Newton's there. Side by side, where factors
   are of all robots, they are always new: what one robot does must not depend on the others. Returns where it is
   declined. */
static Truth newton(const Unknowns *q, const Real *alpha, State *state, Chain *h, int most, int *iterations,
                  Real *contraction) {
    Real step[MOST_UNKNOWNS], last = REAL(INFINITY);
    Truth fresh = YES, open = YES, declined = NOT(YES);
    *contraction = REAL(0.0);
    evaluate(q, alpha, state);
    for (int k = 0; k < most; k++) {
        ++*iterations;
        if (ABREAST || ANY(fresh)) declined |= open & NOT(factor_variation(q, state, REAL(1.0), h));
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

