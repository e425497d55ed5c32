/* Energy descent, and Newton's method: what solvers/newton.py does. */

enum { SOLVED = 0, DECLINED = 1 };

/* Newton step; where the energy is not convex, of the Hessian with a shift that makes it so. 1 where no shift was. */
static int downhill(const Unknowns *q, const State *state, double *h, double *step) {
    for (double shift = 0; shift < 1e6; shift = shift ? 4 * shift : 0.1) {
        second_variation(q, state, h);
        for (int r = 0; r < q->size; r++) h[(size_t)r * STRIDE + r] += shift;
        if (!cholesky(h, q->size, STRIDE)) continue;
        for (int r = 0; r < q->size; r++) step[r] = -state->gradient[r];
        cholesky_solve(h, q->size, STRIDE, step);
        return shift == 0;
    }
    memset(step, 0, q->size * sizeof(double));
    return 0;
}

/* Newton on the energy, steps shortened until it falls, until they turn no point by more than `small`, rad. Returns
   where it ends, `state` or `trial`; NULL where it is declined. */
static State *descend(const Unknowns *q, const double *alpha, State *state, State *trial, double *h, double small,
                      int *iterations) {
    double step[MOST_UNKNOWNS];
    evaluate(q, alpha, state);
    for (int k = 0; k < MOST_ITERATIONS; k++) {
        ++*iterations;
        int convex = downhill(q, state, h, step);
        double size = turn_of(q, step), scale = size > LONGEST_STEP ? LONGEST_STEP / size : 1;
        double slope = dot(state->gradient, step, q->size);
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

/* Full Newton steps at a place close to a minimum; `contraction` is the largest ratio of successive steps. A step
   smaller than CHORD_STEP is followed by steps with the same factors, as good as Newton's there. */
static int newton(const Unknowns *q, const double *alpha, State *state, double *h, int most, int *iterations,
                  double *contraction) {
    double step[MOST_UNKNOWNS], last = INFINITY;
    int fresh = 1;
    *contraction = 0;
    evaluate(q, alpha, state);
    for (int k = 0; k < most; k++) {
        ++*iterations;
        if (fresh && !factor_variation(q, state, h)) return DECLINED;
        for (int r = 0; r < q->size; r++) step[r] = -state->gradient[r];
        cholesky_solve(h, q->size, STRIDE, step);
        double size = turn_of(q, step);
        /* A step of half a turn that grows leads to another branch. */
        if (!isfinite(size) || (size > 2 * last && size > 3.2)) return DECLINED;
        for (int r = 0; r < q->size; r++) state->z[r] += step[r];
        evaluate(q, alpha, state);
        if (size > LAST_STEP) *contraction = fmax(*contraction, size / last);
        if (size <= LAST_STEP && (size <= ROUND_OFF || residual_of(q, state) <= ROUND_OFF)) return SOLVED;
        fresh = size > CHORD_STEP;
        last = size;
    }
    return DECLINED;
}

