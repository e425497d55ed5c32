/* Precurvature and stiffness along the tubes, as robots/lengthwise.py has them. */

#define CHANNELS 5 /* EI, GJ, u*_x or the signed bend in one plane, u*_y, integral of u*_z */

/* Four of them side by side, then the last alone: LANES numbers per degree. */
#define LANES 8

typedef struct {
    long long most, width, most_cuts;  /* panels and coefficients per tube, cuts per tube */
    const double *breaks;              /* (N, most + 1), from the held end, infinite behind the last */
    const double *coefficients;        /* (N, most, width, LANES) */
    const double *count;               /* (N, most, CHANNELS + 1) of coefficients that are not 0; of any of the first four */
    const double *direction;           /* (N, most) of the bend where it stays in one plane of the tube, else infinite */
    const double *bent, *detail, *twist; /* (N, most) */
    const double *compliance;          /* (N, most) int ds / GJ up to where a panel begins */
    const double *cuts;                /* (N, most_cuts), infinite behind the last */
    long long refinement;              /* how often the pieces of the mesh are halved */
} Pieces;

/* Four polynomials of n coefficients, LANES apart, by Clenshaw's recurrence. */
ALWAYS_INLINE void chebyshev_of_four(const double *c, int n, double x, double *out) {
    Four b = {0}, before = {0};
    for (int k = n - 1; k > 0; k--) {
        Four next;
        EACH(OF(next) = 2 * x * OF(b) - OF(before) + FOUR(c + k * LANES));
        EACH(OF(before) = OF(b), OF(b) = OF(next));
    }
    EACH(FOUR(out) = FOUR(c) + x * OF(b) - OF(before));
}

static int panel_of(const Pieces *t, int tube, double place) {
    const double *breaks = t->breaks + tube * (t->most + 1);
    int k = 0;
    while (k + 1 < t->most && isfinite(breaks[k + 2]) && place >= breaks[k + 1]) k++;
    return k;
}

/* The panel between two places of a tube; -1 where there are several. */
static int panel_between(const Pieces *t, int tube, double low, double high) {
    int panel = panel_of(t, tube, low + INWARDS * (high - low));
    return panel == panel_of(t, tube, high - INWARDS * (high - low)) ? panel : -1;
}

static const double *coefficients_of(const Pieces *t, int tube, int panel) {
    return t->coefficients + (tube * t->most + panel) * t->width * LANES;
}

/* How many coefficients a channel has on a panel; that of number CHANNELS is the most of the first four. */
static int count_of(const Pieces *t, int tube, int panel, int which) {
    return (int)t->count[(tube * t->most + panel) * (CHANNELS + 1) + which];
}

static double fraction(const Pieces *t, int tube, int panel, double place) {
    const double *breaks = t->breaks + tube * (t->most + 1) + panel;
    double x = (2 * place - breaks[0] - breaks[1]) / (breaks[1] - breaks[0]);
    return x < -1 ? -1 : x > 1 ? 1 : x;
}

/* A tube at x (-1 to 1) of a panel. */
static inline Section section_at(const Pieces *t, int tube, int panel, double x, int present) {
    double direction = t->direction[tube * t->most + panel];
    const double *c = coefficients_of(t, tube, panel);
    int count = count_of(t, tube, panel, CHANNELS), winding = count_of(t, tube, panel, 4);
    double here[4], turned[4];
    if (count == 1)
        memcpy(here, c, sizeof here);
    else
        chebyshev_of_four(c, count, x, here);
    if (winding <= 2 && t->width > 1)
        turned[0] = c[4] + x * c[4 + LANES];
    else
        chebyshev_of_four(c + 4, winding, x, turned);
    Section s = {present ? here[0] : 0, here[2], 0, 1 / here[1], turned[0]};
    if (isinf(direction)) {
        direction = atan2(here[3], here[2]);
        s.moment = sqrt(here[2] * here[2] + here[3] * here[3]);
    }
    s.moment *= s.stiffness;
    s.phase = s.twist_angle + direction;
    return s;
}

/* A tube at `place` from its held end, on a panel. */
static Section section_of(const Pieces *t, int tube, int panel, double place, int present) {
    return section_at(t, tube, panel, fraction(t, tube, panel, place), present);
}

/* int ds / GJ of a tube from its held end. */
static double compliant(const Pieces *t, int tube, double place) {
    int panel = panel_of(t, tube, place);
    const double *breaks = t->breaks + tube * (t->most + 1) + panel;
    const double *c = coefficients_of(t, tube, panel);
    double here[4], low = breaks[0], step = fmax(fmin(place, breaks[1]) - low, 0), sum = 0;
    int count = count_of(t, tube, panel, 1);
    for (int k = 0; k < QUADRATURE && count > 1; k++) {
        chebyshev_of_four(c, count, fraction(t, tube, panel, low + step * QUADRATURE_NODES[k]), here);
        sum += QUADRATURE_WEIGHTS[k] / here[1];
    }
    if (count == 1) sum = 1 / c[1];
    return t->compliance[tube * t->most + panel] + step * sum;
}

/* The slope of such a polynomial. */
static double chebyshev_slope(const double *c, int n, double x) {
    double sum = 0, one = 1, second = 2 * x;
    for (int k = 1; k < n; k++) { /* T_k' = k U_k-1 */
        sum += k * c[k * LANES] * one;
        double next = 2 * x * second - one;
        one = second;
        second = next;
    }
    return sum;
}

/* Slopes along a tube of what it is at `place` from its held end, on a panel; of `twist_angle`, u*_z. */
static Section passing_of(const Pieces *t, int tube, int panel, double place, int present) {
    const double *breaks = t->breaks + tube * (t->most + 1) + panel, *c = coefficients_of(t, tube, panel);
    double x = fraction(t, tube, panel, place), by = 2 / (breaks[1] - breaks[0]), here[4], slope[5];
    int count = count_of(t, tube, panel, CHANNELS);
    chebyshev_of_four(c, count, x, here);
    for (int j = 0; j < 5; j++)
        slope[j] = by * chebyshev_slope(c + j, j < 4 ? count : count_of(t, tube, panel, 4), x);
    double bend = here[2], growing = slope[2], turning = 0;
    if (isinf(t->direction[tube * t->most + panel])) {
        bend = sqrt(here[2] * here[2] + here[3] * here[3]);
        double solid = bend > 0 ? bend : 1;
        growing = (here[2] * slope[2] + here[3] * slope[3]) / solid;
        turning = (here[2] * slope[3] - here[3] * slope[2]) / (solid * solid);
    }
    Section s = {0, 0, slope[4] + turning, -slope[1] / (here[1] * here[1]), slope[4]};
    if (!present) return s;
    s.stiffness = slope[0];
    s.moment = slope[0] * bend + here[0] * growing;
    return s;
}

/* u*_z of a tube: the slope of the integral. */
static double twist_of(const Pieces *t, int tube, int panel, double place) {
    const double *breaks = t->breaks + tube * (t->most + 1) + panel, *c = coefficients_of(t, tube, panel) + 4;
    double x = fraction(t, tube, panel, place);
    return chebyshev_slope(c, count_of(t, tube, panel, 4), x) * 2 / (breaks[1] - breaks[0]);
}

/* The integral of u*_z of a tube up to `place`. */
static double twist_angle_at(const Pieces *t, int tube, double place) {
    return section_of(t, tube, panel_of(t, tube, place), place, 1).twist_angle;
}

/* Whether a tube has any u*_z. */
static int winds(const Pieces *t, int tube) {
    for (int k = 0; k < t->most; k++)
        if (t->twist[tube * t->most + k] > 0) return 1;
    return 0;
}
