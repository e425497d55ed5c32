/* Tubes made of pieces: precurvature and stiffness along them, as robots/lengthwise.py has them. */

#define CHANNELS 5 /* EI, GJ, u*_x or the signed bend in one plane, u*_y, integral of u*_z */

typedef struct {
    long long most, width, most_cuts;  /* panels and coefficients per tube, cuts per tube */
    const double *breaks;              /* (N, most + 1), from the held end, infinite behind the last */
    const double *coefficients;        /* (N, most, CHANNELS, width) */
    const double *count;               /* (N, most, CHANNELS) of coefficients that are not 0 */
    const double *direction;           /* (N, most) of the bend where it stays in one plane of the tube, else infinite */
    const double *bent, *detail, *twist; /* (N, most) */
    const double *compliance;          /* (N, most) int ds / GJ up to where a panel begins */
    const double *cuts;                /* (N, most_cuts), infinite behind the last */
} Pieces;

typedef struct {
    double stiffness, moment, phase, torsional, wound;
} Section;

static double chebyshev(const double *c, int n, double x) {
    double b = 0, before = 0;
    for (int k = n - 1; k > 0; k--) {
        double next = 2 * x * b - before + c[k];
        before = b;
        b = next;
    }
    return c[0] + x * b - before;
}

static int panel_of(const Pieces *t, int tube, double place) {
    const double *breaks = t->breaks + tube * (t->most + 1);
    int k = 0;
    while (k + 1 < t->most && isfinite(breaks[k + 2]) && place >= breaks[k + 1]) k++;
    return k;
}

/* One quantity of a tube at an arc length from its held end, on a panel. */
static double channel(const Pieces *t, int tube, int panel, int which, double x) {
    size_t at = (tube * t->most + panel) * CHANNELS + which;
    return chebyshev(t->coefficients + at * t->width, (int)t->count[at], x);
}

static double fraction(const Pieces *t, int tube, int panel, double place) {
    const double *breaks = t->breaks + tube * (t->most + 1) + panel;
    return fmin(fmax((2 * place - breaks[0] - breaks[1]) / (breaks[1] - breaks[0]), -1), 1);
}

/* A tube at `place` from its held end; `inside` tells on which side where it jumps. */
static Section section_of(const Pieces *t, int tube, double place, double inside, int present) {
    int panel = panel_of(t, tube, inside);
    double x = fraction(t, tube, panel, place), direction = t->direction[tube * t->most + panel];
    Section s;
    s.torsional = channel(t, tube, panel, 1, x);
    s.wound = channel(t, tube, panel, 4, x);
    s.stiffness = present ? channel(t, tube, panel, 0, x) : 0;
    s.moment = channel(t, tube, panel, 2, x);
    if (isinf(direction)) {
        double y = channel(t, tube, panel, 3, x);
        direction = atan2(y, s.moment);
        s.moment = sqrt(s.moment * s.moment + y * y);
    }
    s.moment *= s.stiffness;
    s.phase = s.wound + direction;
    return s;
}

/* int ds / GJ of a tube from its held end. */
static double compliant(const Pieces *t, int tube, double place) {
    int panel = panel_of(t, tube, place);
    const double *breaks = t->breaks + tube * (t->most + 1) + panel;
    double low = breaks[0], step = fmax(fmin(place, breaks[1]) - low, 0), sum = 0;
    for (int k = 0; k < QUADRATURE; k++)
        sum += QUADRATURE_WEIGHTS[k] / channel(t, tube, panel, 1, fraction(t, tube, panel, low + step * QUADRATURE_NODES[k]));
    return t->compliance[tube * t->most + panel] + step * sum;
}

/* u*_z of a tube: the slope of the integral. */
static double twist_of(const Pieces *t, int tube, double place, double inside) {
    int panel = panel_of(t, tube, inside);
    const double *breaks = t->breaks + tube * (t->most + 1) + panel;
    size_t at = (tube * t->most + panel) * CHANNELS + 4;
    const double *c = t->coefficients + at * t->width;
    double x = fraction(t, tube, panel, place), sum = 0, one = 1, second = 2 * x;
    for (int k = 1; k < (int)t->count[at]; k++) { /* T_k' = k U_k-1 */
        sum += k * c[k] * one;
        double next = 2 * x * second - one;
        one = second;
        second = next;
    }
    return sum * 2 / (breaks[1] - breaks[0]);
}
