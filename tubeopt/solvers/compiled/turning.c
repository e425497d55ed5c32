/* How far all tubes may turn from a solved equilibrium of concentric tubes before anything snaps: what
   stability/snap_distance.py proves, with its symbols. Boxes are (-low, high) of every coupling. */

#define MOST_COUPLINGS 192
#define SECTORS (N < 2 ? 0 : N < 3 ? 2 : N < 4 ? 6 : 24) /* n!, of up to four tubes */
#define MOST_CHANGE 3.  /* rad, of an angle in a box: below pi, h has one extremum beside 0 in it */
#define SPARE 1e-10     /* rad, of a box beyond its image */
#define ROUNDING 1e-12  /* rad, above that of an image */
#define LEAST_RISE 1e-9 /* of the least eigenvalue of H above 0: more than round-off */
#define SETTLED 1e-16   /* rad^2, of a step after which a box does not shrink */
#define SWEEPS 240      /* images of a box at most */
#define ROOM_LEFT 1.3   /* by how much more than the steps that are left a box takes */
#define HALF_TURN 3.141592653589793
#define FIRST_TURN 0.1 /* rad, that a search begins with */

typedef struct {
    const Unknowns *q;
    State *trial;
    double *h; /* room for a factorised H */
    int count, point[MOST_COUPLINGS], tube[MOST_COUPLINGS][2];
    double psi[MOST_COUPLINGS], sine[MOST_COUPLINGS], cosine[MOST_COUPLINGS], w[MOST_COUPLINGS];
    double extremum[MOST_COUPLINGS], at_extremum[MOST_COUPLINGS], spare[MOST_COUPLINGS];
    double G[MOST_COUPLINGS][MOST_COUPLINGS], J[N][MOST_COUPLINGS];
} Couplings;

typedef double Box[2][MOST_COUPLINGS];

static double h_at(const Couplings *c, int p, double x) { return c->sine[p] * (1 - cos(x)) + c->cosine[p] * (x - sin(x)); }

/* Entry (p, k) of D. */
static int incidence(const Couplings *c, int p, int k) { return (c->tube[p][0] == k) - (c->tube[p][1] == k); }

/* out <- A H^-1 g, with H factorised. */
static void answer_of(const Couplings *c, double *g, double *out) {
    double turned[MOST_UNKNOWNS];
    const Unknowns *q = c->q;
    cholesky_solve(c->h, q->size, STRIDE, g);
    times_factor(q, g, turned);
    for (int p = 0; p < c->count; p++) {
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        out[p] = turned[q->first[i] + q->place[x][i]] - turned[q->first[j] + q->place[x][j]];
    }
}

/* The couplings of a solved state; 0 where there are too many, or where it is not stable. */
static int find_couplings(const Unknowns *q, const State *state, State *trial, double *h, Couplings *c) {
    double g[MOST_UNKNOWNS];
    c->q = q, c->trial = trial, c->h = h, c->count = 0;
    if (N > 4) return 0; /* 120 sectors and more take long */
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++)
            for (int j = i + 1; j < N; j++) {
                const Sections *at = &q->at[x];
                double product = at->moment[i] * at->moment[j], stiffness = 0;
                int p = c->count;
                if (product == 0 || q->place[x][i] < 0 || q->place[x][j] < 0) continue;
                if (p == MOST_COUPLINGS) return 0;
                for (int k = 0; k < N; k++) stiffness += at->stiffness[k];
                c->point[p] = x, c->tube[p][0] = i, c->tube[p][1] = j;
                c->w[p] = q->weight[x] * fabs(product) / stiffness;
                /* A tube curved backwards is one turned by half. */
                c->psi[p] = state->theta[x][i] + at->phase[i] - state->theta[x][j] - at->phase[j] + (product < 0) * HALF_TURN;
                c->sine[p] = sin(c->psi[p]), c->cosine[p] = cos(c->psi[p]);
                c->extremum[p] = remainder(-2 * c->psi[p], 2 * HALF_TURN);
                c->at_extremum[p] = h_at(c, p, c->extremum[p]);
                c->count++;
            }
    if (!factor_variation(q, state, h)) return 0;
    memcpy(g, state->gradient, sizeof g);
    answer_of(c, g, c->spare);
    for (int p = 0; p < c->count; p++) c->spare[p] = fabs(c->spare[p]) + ROUNDING;
    for (int p = 0; p < c->count; p++) {
        double unit[MOST_UNKNOWNS] = {0};
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        unit[q->first[i] + q->place[x][i]] = 1;
        unit[q->first[j] + q->place[x][j]] = -1;
        memset(g, 0, sizeof g);
        add_by_factor(q, unit, g);
        answer_of(c, g, c->G[p]);
    }
    for (int p = 0; p < c->count; p++)
        for (int k = 0; k < N; k++) {
            c->J[k][p] = incidence(c, p, k);
            for (int r = 0; r < c->count; r++) c->J[k][p] -= c->G[p][r] * c->w[r] * c->cosine[r] * incidence(c, r, k);
        }
    return 1;
}

/* The box to which a box u is mapped, with room for round-off, where y is that of J d; whether u holds it. */
static int map_box(const Couplings *c, Box y, Box u, Box out) {
    Box range; /* of w h, as boxes are */
    int holds = 1;
    for (int p = 0; p < c->count; p++) {
        double low = -u[0][p], high = u[1][p], first = h_at(c, p, low), last = h_at(c, p, high);
        double other = low <= c->extremum[p] && c->extremum[p] <= high ? c->at_extremum[p] : 0;
        range[0][p] = -c->w[p] * fmin(fmin(0, other), fmin(first, last));
        range[1][p] = c->w[p] * fmax(fmax(0, other), fmax(first, last));
    }
    for (int p = 0; p < c->count; p++) {
        double down = y[0][p] + c->spare[p], up = y[1][p] + c->spare[p];
        for (int r = 0; r < c->count; r++) {
            double positive = fmax(c->G[p][r], 0), negative = positive - c->G[p][r];
            down += positive * range[0][r] + negative * range[1][r];
            up += positive * range[1][r] + negative * range[0][r];
        }
        out[0][p] = down, out[1][p] = up;
        holds &= down <= u[0][p] && up <= u[1][p];
    }
    return holds;
}

/* Whether H is positive at the smallest cosines of the angles in a box; at -1 where it is NULL: then nothing can snap. */
static int convex_in(const Couplings *c, Box u) {
    State *trial = c->trial;
    memset(trial->slope, 0, c->q->points * sizeof trial->slope[0]);
    for (int p = 0; p < c->count; p++) {
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        double least = -1;
        if (u) {
            double low = c->psi[p] - u[0][p] - HALF_TURN, high = c->psi[p] + u[1][p] - HALF_TURN;
            if (u[0][p] > MOST_CHANGE || u[1][p] > MOST_CHANGE) return 0;
            if (floor(high / (2 * HALF_TURN)) == floor(low / (2 * HALF_TURN))) least = -fmax(cos(low), cos(high));
        }
        double part = c->w[p] / c->q->weight[x] * least, *slope = trial->slope[x];
        slope[i * N + i] += part, slope[j * N + j] += part;
        slope[i * N + j] -= part, slope[j * N + i] -= part;
    }
    second_variation(c->q, trial, c->h);
    for (int r = 0; r < c->q->size; r++) c->h[(size_t)r * STRIDE + r] -= LEAST_RISE;
    return cholesky(c->h, c->q->size, STRIDE);
}

/* Whether a box is found that is mapped into itself, and in which H is positive: by images from y on. Their steps come to
   shrink by a ratio; after some sweeps the box takes the rest of them (Aitken) and a little more, since images from above
   are mapped into themselves. */
static int proves_sector(const Couplings *c, Box y) {
    Box u, image, step = {{0}};
    double size = 0;
    memcpy(u, y, sizeof u);
    for (int sweep = 1, since = 1; sweep < SWEEPS; sweep++, since++) {
        double along = 0, before = size;
        int holds = map_box(c, y, u, image), settles = since >= 3 + sweep / 12; /* longer where a second ratio is close */
        if (holds && convex_in(c, u)) return 1;
        size = 0;
        for (int side = 0; side < 2; side++)
            for (int p = 0; p < c->count; p++) {
                double by = image[side][p] - u[side][p];
                along += by * step[side][p];
                size += by * by;
                step[side][p] = by;
                u[side][p] = image[side][p];
                if (u[side][p] > MOST_CHANGE && by > 0 && since > 1) return 0;
            }
        if (holds && size < SETTLED) return 0;
        if (!settles) continue;
        double left = along < before ? fmax(0, ROOM_LEFT * along / (before - along)) : 0;
        for (int side = 0; side < 2; side++)
            for (int p = 0; p < c->count; p++)
                u[side][p] = fmin(fmax(0, u[side][p] + left * step[side][p]) + SPARE, MOST_CHANGE);
        since = 0;
    }
    return 0;
}

/* Whether turns of all tubes by at most r each are proved to cause no snap: sector by sector, conv(0, 2 r 1_T along a
   chain of sets T), numbered by orders of the tubes. */
static int proves_turn(const Couplings *c, double r) {
    for (int sector = 0; sector < SECTORS; sector++) {
        Box y = {{0}};
        double at[MOST_COUPLINGS] = {0};
        int left[N], order = sector;
        for (int k = 0; k < N; k++) left[k] = k;
        for (int k = N; k > 1; order /= k--) { /* the set of all tubes turns nothing */
            const double *J = c->J[left[order % k]];
            left[order % k] = left[k - 1];
            for (int p = 0; p < c->count; p++) {
                at[p] += 2 * r * J[p];
                y[0][p] = fmax(y[0][p], -at[p]), y[1][p] = fmax(y[1][p], at[p]);
            }
        }
        if (!proves_sector(c, y)) return 0;
    }
    return 1;
}

/* The largest such r up to `most`, to a relative precision; INFINITY where nothing can snap at these translations. */
static double largest_turn(const Couplings *c, double most, double precision) {
    double proved = 0, refused = fmin(most, HALF_TURN), r = fmin(FIRST_TURN, refused / 2);
    if (!c->count || convex_in(c, NULL)) return INFINITY;
    if (most < HALF_TURN && proves_turn(c, most)) return most;
    while (refused - proved > precision * refused) {
        *(proves_turn(c, r) ? &proved : &refused) = r;
        r = refused < HALF_TURN ? (proved + refused) / 2 : fmin((proved + refused) / 2, 2 * proved);
    }
    return proved;
}
